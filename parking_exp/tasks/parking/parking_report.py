"""Report sections of parking: map of the lot, rates by number of parked cars."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from parking_exp.tasks.parking.lot_figures import draw_scene_map, draw_vehicle_rates
from parking_exp.tasks.parking.outcome_rates import slot_rates, vehicle_rates
from parking_exp.tasks.task import TaskFigure, TaskReport, TaskSection


def rates(runs: Sequence[pd.DataFrame], config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the rates of outcomes by goal slot, and by number of parked cars where that varies."""
    by_vehicles = vehicle_rates(runs, config)
    return {"slots": slot_rates(runs)} | ({"vehicles": by_vehicles} if by_vehicles else {})


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
            "vehicles",
            "How many cars are parked",
            [TaskFigure("vehicles", "Success and crashes by number of parked cars", draw_vehicle_rates)],
            table="vehicles",
        ),
    ],
    rates=rates,
)
