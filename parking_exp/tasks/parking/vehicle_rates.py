"""Report data and figure: outcomes by number of parked cars, where scenes draw it from a range."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator

from parking_exp.figure_style import Drawing, cell_style, new_figure, percentages, wrapped_labels
from parking_exp.tasks.parking.lot_map import OUTCOMES
from parking_exp.tasks.parking.scenes import drawn_number


@dataclass(frozen=True)
class VehicleRate:
    """Rates of the `n` episodes of all seeds that have `vehicles` parked cars."""

    vehicles: int
    n: int
    success: float
    crash: float
    timeout: float


def vehicle_rates(runs: Sequence[pd.DataFrame], config: Mapping[str, Any]) -> list[VehicleRate]:
    """Return rates by number of parked cars, over the final episodes (scene, outcome) of several runs.

    There are none where `env.vehicles_count` of the config, by dotted keys, is not a range.
    """
    bounds = re.fullmatch(r"\[(\d+), ?(\d+)\]", str(config.get("env.vehicles_count")))
    if not (runs and bounds):
        return []
    low, high = map(int, bounds.groups())
    episodes = pd.concat(runs)
    numbers = {
        scene: drawn_number(np.random.PCG64(np.random.SeedSequence(scene)), low, high)
        for scene in episodes["scene"].unique().tolist()
    }
    counts = pd.crosstab(episodes["scene"].map(numbers), episodes["outcome"].astype(object))
    rows = counts.reindex(columns=[*OUTCOMES], fill_value=0).to_numpy()
    return [
        VehicleRate(int(vehicles), int(row.sum()), *(row / row.sum()).tolist())
        for vehicles, row in zip(counts.index, rows, strict=True)
    ]


def draw_vehicle_rates(cells: Sequence[Any]) -> Iterator[Drawing]:
    """Draw success and crashes against the number of parked cars."""
    shown = [cell for cell in cells if cell.task_data.get("vehicles")]
    if not shown:
        return
    figure = new_figure(3.2)
    panels = figure.subplots(1, 2, sharex=True)
    for cell, label in zip(shown, wrapped_labels(shown, 40), strict=True):
        style, rates = cell_style(cell.id), cell.task_data["vehicles"]
        line = {"color": style.colour, "linestyle": style.line, "marker": style.marker, "label": label}
        for axes, name in zip(panels, ("success", "crash"), strict=True):
            axes.plot([row.vehicles for row in rates], percentages([getattr(row, name) for row in rates]), **line)
            axes.set(xlabel="parked cars", ylabel=f"{name} (%)")
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    yield figure, "Final success and crashes by the number of parked cars of a scene, all seeds together."
