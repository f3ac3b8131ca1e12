"""Report sections of parking: definition of success, map of the lot, sampled trajectories."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from parking_exp.tasks.parking.geometry import N_SLOTS
from parking_exp.tasks.parking.lot_figures import draw_scene_map, draw_trajectories
from parking_exp.tasks.parking.lot_map import Recording, Runs, sample, sampled_rows, slot_rates
from parking_exp.tasks.task import TaskFigure, TaskReport, TaskSection


def rates(runs: Sequence[pd.DataFrame]) -> dict[str, Any]:
    """Return the rates of outcomes by goal slot."""
    return {"slots": slot_rates(runs)}


def recordings(
    runs: Runs, recording: Recording, final: Mapping[str, pd.DataFrame], config: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str]]:
    """Return sampled trajectories, where failed episodes ended, and sentences on unreadable recordings."""
    vehicles = config.get("env.vehicles_count")
    parked = vehicles if type(vehicles) is int and 0 < vehicles < N_SLOTS else 0
    paths, failures, unreadable = sample(runs, recording, final, parked)
    return {"paths": paths, "failures": failures}, unreadable


PARKING_REPORT = TaskReport(
    methods=[
        "Success of parking is highway-env's: close to the goal slot, at any speed. Parked is stricter: all corners "
        "inside the slot's lines, heading within 10°, slower than 0.5 m/s. Crash and timeout are the other ways to end."
    ],
    sections=[
        TaskSection(
            "scenes",
            "Where episodes fail",
            [TaskFigure("scene_map", "Where on the lot episodes fail", draw_scene_map)],
            table="slots",
        ),
        TaskSection(
            "trajectories",
            "Seen from above",
            [TaskFigure("trajectories", "Sampled episodes from above", draw_trajectories)],
        ),
    ],
    rates=rates,
    recordings=recordings,
    exported=sampled_rows,
)
