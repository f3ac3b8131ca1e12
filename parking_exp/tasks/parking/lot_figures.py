"""Figures: paths and failures by goal slot on the lot; outcomes by number of parked cars."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from parking_exp.figure_style import (
    GRID,
    WIDTH_IN,
    cell_style,
    new_figure,
    percentages,
    text_colour,
    wrapped_labels,
)
from parking_exp.report_section import CaptionedFigure
from parking_exp.tasks.metrics import EPISODE_SEED, SUCCESS, TIMEOUT
from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, CAR_WIDTH_M, corners, direction_of
from parking_exp.tasks.parking.parking_metrics import CRASH, PATH_COLUMNS
from parking_exp.tasks.parking.scenes import Scenes

DRAWN_OUTCOMES = (SUCCESS, TIMEOUT, CRASH)
"""In the order in which their paths are drawn: crashes are on top."""
OUTLINE = {"edgecolors": GRID, "linewidths": 0.4}  # the style of slots
WALL = "#808286"


@dataclass(frozen=True)
class DrawnLot:
    """What figures show of a cell's lot."""

    scene: Scenes  # one, in the middle of all ranges
    walls: bool  # whether there are any
    paths: pd.DataFrame  # scene, step, PATH_COLUMNS, outcome; on this lot


def draw_paths(report: Any) -> Iterator[CaptionedFigure]:
    """Draw the paths of the first final episodes of a seed of each cell."""
    cells = [
        cell for cell in report.shown_cells if cell.figure_data and len(cell.figure_data.paths)
    ]
    if not cells:
        return
    figure, panels = draw_lots(cells)
    marks = []
    for outcome in DRAWN_OUTCOMES:
        for axes, cell in zip(panels, cells, strict=True):
            paths = cell.figure_data.paths
            _draw_cars(axes, paths[paths["outcome"] == outcome.name], outcome.colour)
        marks += panels[0].plot([], [], color=outcome.colour, label=outcome.name)
    figure.legend(handles=marks, loc="outside upper center", ncols=len(marks))
    yield (
        figure,
        "The lot from above: paths in the first final episodes, and the car at their ends. Of each "
        "cell, the lowest seed is shown. Where slots differ from scene to scene, each path is "
        "moved, but not turned, so that its goal is where that slot is drawn.",
    )


def _draw_cars(axes: Axes, paths: pd.DataFrame, colour: str | None) -> None:
    """Draw some paths, and the car at the end of each."""
    lines = []
    for _, path in paths.groupby(EPISODE_SEED):
        lines.append(path[["x_m", "y_m"]].to_numpy())
    axes.add_collection(LineCollection(lines, colors=colour, linewidths=0.5), autolim=False)
    ends = paths.groupby(EPISODE_SEED)[[*PATH_COLUMNS]].last().to_numpy()
    cars = outlines(ends, CAR_LENGTH_M, CAR_WIDTH_M)
    draw_polygons(axes, cars, facecolors=f"{colour}30", edgecolors=colour, linewidths=0.5)


def draw_scene_map(report: Any) -> Iterator[CaptionedFigure]:
    """Draw, for each goal slot, the share of episodes that failed."""
    cells = [cell for cell in report.shown_cells if cell.task_data.get("slots")]
    if not cells:
        return
    failed = [_failures(cell) for cell in cells]
    highest = max(10.0, 5 * np.ceil(np.nanmax(np.concatenate(failed)) / 5))
    figure, panels = draw_lots(cells)
    for axes, cell, rates in zip(panels, cells, failed, strict=True):
        scene = cell.figure_data.scene
        slots = draw_polygons(
            axes, _slots(scene), array=rates, cmap="Purples", clim=(0, highest), **OUTLINE
        )
        if len(cells) > 4:  # no room for numbers
            continue
        for (x, y, _), rate in zip(scene.slots[0], rates, strict=True):
            if np.isfinite(rate):
                colour = text_colour(slots.to_rgba(rate))
                axes.text(x, y, f"{rate:.0f}", ha="center", va="center", color=colour, fontsize=5.2)
    bar = figure.colorbar(slots, ax=panels, aspect=30, pad=0.02)
    bar.set_label("failed episodes (%)")
    yield (
        figure,
        "The lot from above: share of episodes with that goal slot that failed (crash or timeout), "
        "in %, all seeds together.",
    )


def _failures(cell: Any) -> np.ndarray:
    """Return the percentage of failed episodes by goal slot, shape (slots,); NaN without any."""
    rates = np.full(cell.figure_data.scene.slots.shape[1], np.nan)
    for row in cell.task_data["slots"]:
        rates[row["slot"]] = percentages([row["crash"], row["timeout"]]).sum()
    return rates


def draw_vehicle_rates(report: Any) -> Iterator[CaptionedFigure]:
    """Draw success and crashes against the number of parked cars."""
    shown = [cell for cell in report.shown_cells if cell.task_data.get("vehicles")]
    if not shown:
        return
    figure = new_figure(3.2)
    panels = figure.subplots(1, 2, sharex=True)
    for cell, label in zip(shown, wrapped_labels(shown, 40), strict=True):
        rows = cell.task_data["vehicles"]
        vehicles = [row["vehicles"] for row in rows]
        for axes, name in zip(panels, ("success", "crash"), strict=True):
            rates = percentages([row[name] for row in rows])
            axes.plot(vehicles, rates, label=label, **cell_style(cell.id).lines)
            axes.set(xlabel="parked cars", ylabel=f"{name} (%)")
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    yield (
        figure,
        "Final success and crashes by the number of parked cars of a scene, all seeds together.",
    )


def draw_lots(cells: Sequence[Any]) -> tuple[Figure, list[Axes]]:
    """Return a figure with the lot of each cell, and their axes in metres."""
    n = len(cells)
    columns = 4
    if n <= 12:
        columns = 3
    if n <= 4:
        columns = min(n, 2)
    rows = -(-n // columns)
    labels = wrapped_labels(cells, 84 // columns, lines=2)
    n_breaks = max(label.count("\n") for label in labels)
    length, width = np.max([cell.figure_data.scene.box[0] for cell in cells], axis=0)
    lot_height = (WIDTH_IN - 0.8) / columns * width / length
    figure = new_figure(0.4 + rows * (0.22 + 0.13 * n_breaks + lot_height))
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for unused in grid.flat[n:]:
        unused.remove()
    panels = list(grid.flat[:n])
    figure.supxlabel("x (m)", fontsize="medium")
    figure.supylabel("y (m)", fontsize="medium")

    for axes, cell, label in zip(panels, cells, labels, strict=True):
        axes.set(
            aspect="equal",
            title=label,
            xlim=(-length / 2, length / 2),
            ylim=(-width / 2, width / 2),
        )
        axes.spines[:].set_visible(False)
        axes.locator_params(nbins=4)
        scene = cell.figure_data.scene
        draw_polygons(axes, _slots(scene), facecolors="none", **OUTLINE)
        if cell.figure_data.walls:
            box = outlines(np.zeros((1, 3)), *scene.box[0])
            style = {"facecolors": "none", "edgecolors": WALL, "linewidths": 1.8}
            draw_polygons(axes, box, clip_on=False, **style)
    return figure, panels


def _slots(scene: Scenes) -> np.ndarray:
    """Return the corners of the slots of one scene, shape (slots, 4, 2) [m]."""
    return outlines(scene.slots[0], *scene.slot_size[0])


def draw_polygons(axes: Axes, polygons: np.ndarray, **style: Any) -> PolyCollection:
    """Draw polygons of shape (n, corners, 2) [m]."""
    shapes = PolyCollection(list(polygons), **style)
    axes.add_collection(shapes, autolim=False)
    return shapes


def outlines(poses: np.ndarray, length: float, width: float) -> np.ndarray:
    """Return the corners of equal rectangles with some poses, shape (n, 4, 2) [m]."""
    return corners(poses[:, :2], direction_of(poses[:, 2]).T, length, width)
