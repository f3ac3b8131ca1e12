"""Report section of parking: definition of success, map of the lot."""

from collections.abc import Sequence
from typing import Any

import pandas as pd

from parking_exp.tasks.parking.lot_figures import draw_scene_map
from parking_exp.tasks.parking.lot_map import slot_rates
from parking_exp.tasks.task import TaskFigure, TaskReport, TaskSection


def rates(runs: Sequence[pd.DataFrame]) -> dict[str, Any]:
    """Return the rates of outcomes by goal slot."""
    return {"slots": slot_rates(runs)}


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
    ],
    rates=rates,
)
