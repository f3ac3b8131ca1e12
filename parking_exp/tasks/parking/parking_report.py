"""Report sections of parking: map of the lot, rates of outcomes by goal slot and by number of
parked cars.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.figure_style import SectionFigure
from parking_exp.tasks.parking.lot_figures import draw_scene_map, draw_vehicle_rates
from parking_exp.tasks.parking.parking_metrics import METRICS
from parking_exp.tasks.parking.scenes import Scenes, drawn_number
from parking_exp.tasks.task import TaskReport, TaskSection

OUTCOMES = [metric.name for metric in METRICS if metric.is_outcome]


def outcome_rates(
    runs: Sequence[pd.DataFrame], key: str, of_scene: Callable[[int], int]
) -> list[dict[str, Any]]:
    """Return the rates of outcomes over the final episodes (scene, outcome) of several runs, by a
    number of the scene.

    Args:
        runs: a frame of episodes for each run.
        key: the name of that number.
        of_scene: returns it for a scene.

    Returns:
        A row for each number, ascending: the number by its name, `n` episodes, and a rate for each
            outcome.
    """
    if not runs:
        return []
    episodes = pd.concat(runs)
    numbers = {scene: of_scene(scene) for scene in episodes["scene"].unique().tolist()}
    counts = pd.crosstab(
        episodes["scene"].map(numbers).rename(key), episodes["outcome"].astype(object)
    )
    n = counts.sum(axis=1)
    rates = counts.reindex(columns=OUTCOMES, fill_value=0).div(n, axis=0)
    rates.insert(0, "n", n)
    return rates.reset_index().to_dict("records")  # type: ignore[return-value]  # its columns are str


def vehicle_rates(runs: Sequence[pd.DataFrame], config: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rates of outcomes by number of parked cars.

    There are none where `env.vehicles_count` of the config, by dotted keys, is not a range.
    """
    bounds = re.fullmatch(r"\[(\d+), ?(\d+)\]", str(config.get("env.vehicles_count")))
    if not bounds:
        return []
    low, high = map(int, bounds.groups())
    return outcome_rates(
        runs,
        "vehicles",
        lambda scene: drawn_number(np.random.PCG64(np.random.SeedSequence(scene)), low, high),
    )


@cache
def _goal(scene: int) -> int:
    return int(Scenes.from_seeds([scene]).goal[0])


def rates(runs: Sequence[pd.DataFrame], config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the rates of outcomes by goal slot, and by number of parked cars where that varies."""
    by_vehicles = vehicle_rates(runs, config)
    by_section = {"slots": outcome_rates(runs, "slot", _goal)}
    if by_vehicles:
        by_section["vehicles"] = by_vehicles
    return by_section


PARKING_REPORT = TaskReport(
    methods=[
        "Success of parking is highway-env's: close to the goal slot, at any speed. Parked is "
        "stricter: all corners "
        "inside the slot's lines, heading within 10°, slower than 0.5 m/s. Crash and timeout are "
        "the other ways to end."
    ],
    sections=[
        TaskSection(
            "scenes",
            "Where episodes fail",
            [SectionFigure("scene_map", "Where on the lot episodes fail", draw_scene_map)],
            table="slots",
        ),
        TaskSection(
            "vehicles",
            "How many cars are parked",
            [
                SectionFigure(
                    "vehicles", "Success and crashes by number of parked cars", draw_vehicle_rates
                )
            ],
            table="vehicles",
        ),
    ],
    rates=rates,
)
