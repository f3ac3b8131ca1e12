"""Report sections: paths on the lot, rates of outcomes by goal slot and number of parked cars."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from typing import Any

import pandas as pd

from parking_exp.report_section import Section, SectionFigure, Table, cell_row
from parking_exp.tasks.metrics import EPISODE_SEED
from parking_exp.tasks.parking.lot import Lot, SeveralLots
from parking_exp.tasks.parking.lot_figures import (
    DrawnLot,
    draw_paths,
    draw_scene_map,
    draw_vehicle_rates,
)
from parking_exp.tasks.parking.parking_metrics import METRICS, PATH_COLUMNS
from parking_exp.tasks.parking.scenes import NO_SLOT, Scenes
from parking_exp.tasks.parking.stored_lot import stored_lot
from parking_exp.tasks.task import TaskReport

PARKING_OUTCOMES = [metric.name for metric in METRICS if metric.is_outcome]


@cache
def _scenes(lot: Lot, seeds: tuple[int, ...]) -> Scenes:
    return lot.from_seeds(seeds)


def outcome_rates(
    episodes: pd.DataFrame, key: str, numbers_of_scenes: Mapping[int, int]
) -> list[dict[str, Any]]:
    """Return the rates of outcomes of final episodes, grouped by a number of their scene.

    Args:
        episodes: the final episodes of all runs (scene, outcome).
        key: the name of the number, such as `slot`.
        numbers_of_scenes: the number of each scene, such as its goal slot.

    Returns:
        A row for each number, ascending: the number by its name, `n` episodes, and a rate for each
            outcome.
    """
    numbers = episodes[EPISODE_SEED].map(numbers_of_scenes).rename(key)
    counts = pd.crosstab(numbers, episodes["outcome"].astype(object))
    n = counts.sum(axis=1)
    rates = counts.reindex(columns=PARKING_OUTCOMES, fill_value=0).div(n, axis=0)
    rates.insert(0, "n", n)
    return rates.reset_index().to_dict("records")  # type: ignore[return-value]  # its columns are str


def cell_data(runs: Sequence[pd.DataFrame], config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the rates of outcomes by goal slot, and by number of parked cars where that varies.

    Args:
        runs: a frame of final episodes (scene, outcome) for each run.
        config: the cell's config, by dotted keys.
    """
    if not runs:
        return {}
    episodes = pd.concat(runs)
    lot = stored_lot(config)
    seeds = tuple(episodes[EPISODE_SEED].unique().tolist())
    scenes = _scenes(lot, seeds)
    goals = dict(zip(seeds, scenes.goal.tolist(), strict=True))
    by_section: dict[str, Any] = {}
    if not isinstance(lot, SeveralLots):  # each of them numbers its own slots
        by_section["slots"] = outcome_rates(episodes, "slot", goals)
    low, high = lot.vehicles_range
    if low < high:
        numbers = (scenes.vehicles != NO_SLOT).sum(axis=1)
        vehicles = dict(zip(seeds, numbers.tolist(), strict=True))
        by_section["vehicles"] = outcome_rates(episodes, "vehicles", vehicles)
    return by_section


def figure_data(paths: pd.DataFrame, config: Mapping[str, Any]) -> DrawnLot | None:
    """Return what figures show of a cell's lot; None if it has several, which no picture shows.

    Where slots differ from scene to scene, each path is moved, but not turned, so that its goal is
    where that slot is drawn.

    Args:
        paths: paths of the final episodes of one run (scene, step, outcome, and PATH_COLUMNS if
            there are any).
        config: the cell's config, by dotted keys.
    """
    lot = stored_lot(config)
    if isinstance(lot, SeveralLots):
        return None
    typical = lot.typical()
    columns = [EPISODE_SEED, "step", "outcome", *PATH_COLUMNS]
    paths_on_lot = paths.reindex(columns=columns).dropna(ignore_index=True)
    numbers, seeds = pd.factorize(paths_on_lot[EPISODE_SEED])
    scenes = lot.from_seeds(seeds.tolist())
    offsets = typical.slots[0, scenes.goal] - scenes.goal_pose
    paths_on_lot[["x_m", "y_m"]] += offsets[numbers, :2]
    return DrawnLot(typical, config.get("env.add_walls", True), paths_on_lot)


def _list_rates(name: str, report: Any) -> Iterator[Table]:
    """Yield the CSV of the rates that cells have by this name."""
    rows = []
    for cell in report.cells:
        rows += [cell_row(cell) | row for row in cell.task_data.get(name, ())]
    yield Table(name, rows)


PARKING_REPORT = TaskReport(
    methods=[
        "Success of parking is highway-env's: the weighted distance to the goal is small. With the "
        "weights of parking-v0, it counts at any speed. Parked: all corners are inside the slot's "
        "lines, the heading is within 10°, and the car is slower than 0.5 m/s. On other lots than "
        "highway-env's, success is parked. Crash and timeout are the other ways to end.",
        "The planner (algorithm=planner) knows the map of each scene: slots, cars, walls and "
        "obstacles. Other agents know what env.observation shows them.",
    ],
    sections=[
        Section(
            "scenes",
            "Where episodes fail",
            figures=[
                SectionFigure("paths", "Where cars drive", draw_paths),
                SectionFigure("scene_map", "Where on the lot episodes fail", draw_scene_map),
            ],
            tables=[partial(_list_rates, "slots")],
        ),
        Section(
            "vehicles",
            "How many cars are parked",
            figures=[
                SectionFigure(
                    "vehicles", "Success and crashes by number of parked cars", draw_vehicle_rates
                )
            ],
            tables=[partial(_list_rates, "vehicles")],
        ),
    ],
    cell_data=cell_data,
    figure_data=figure_data,
)
