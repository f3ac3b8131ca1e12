"""Figures of parking reports: failures by goal slot on the lot from above, and outcomes by number
of parked cars.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from parking_exp.figure_style import (
    GRID,
    WIDTH_IN,
    Drawing,
    cell_style,
    new_figure,
    percentages,
    text_colour,
    wrapped_labels,
)
from parking_exp.tasks.parking.geometry import (
    LOT_LENGTH_M,
    LOT_WIDTH_M,
    SLOT_LENGTH_M,
    SLOT_POSITIONS,
    SLOT_WIDTH_M,
)

_CORNERS = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) / 2
_SLOTS = SLOT_POSITIONS[:, None] + _CORNERS * (SLOT_WIDTH_M, SLOT_LENGTH_M)  # (28, 4, 2)


def _lots(n: int, columns: int, head: float) -> tuple[Figure, np.ndarray]:
    """Return a figure of parking lots, and their axes in metres, shape (n,); `head` [in] is the
    height of titles.

    The frame of the axes is the wall.
    """
    rows = -(-n // columns)
    lot_height = (WIDTH_IN - 0.8) / columns * LOT_WIDTH_M / LOT_LENGTH_M
    figure = new_figure(0.4 + rows * (head + lot_height))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.flat[n:]:
        axes.remove()
    lots = panels.flat[:n]
    for number, axes in enumerate(lots):
        axes.set(
            aspect="equal",
            xticks=(-30, 0, 30),
            yticks=(-20, 0, 20),
            xlim=(-LOT_LENGTH_M / 2, LOT_LENGTH_M / 2),
            ylim=(-LOT_WIDTH_M / 2, LOT_WIDTH_M / 2),
        )
        axes.spines[:].set(visible=True, linewidth=1.8, alpha=0.55)
        axes.xaxis.set_visible(number + columns >= n)
        axes.yaxis.set_visible(number % columns == 0)
        _shapes(axes, _SLOTS, facecolors="none", edgecolors=GRID, linewidths=0.4)
    figure.supxlabel("x (m)", fontsize="medium")
    figure.supylabel("y (m)", fontsize="medium")
    return figure, lots


def _shapes(axes: Axes, corners: Iterable[np.ndarray], **style: Any) -> PolyCollection:
    """Draw polygons of shape (n, 2) in metres."""
    shapes = PolyCollection(list(corners), **style)
    axes.add_collection(shapes, autolim=False)
    return shapes


def draw_scene_map(report: Any) -> Iterator[Drawing]:
    """Draw, for each goal slot, the share of episodes that failed."""
    cells = []
    failed = []
    for cell in report.shown_cells:
        rates = _failures(cell)
        if np.isfinite(rates).any():
            cells.append(cell)
            failed.append(rates)
    if not failed:
        return
    n = len(failed)
    columns = 4
    if n <= 12:
        columns = 3
    if n <= 4:
        columns = min(n, 2)
    labels = wrapped_labels(cells, 84 // columns, lines=2)
    n_breaks = max(label.count("\n") for label in labels)
    figure, lots = _lots(n, columns, head=0.22 + 0.13 * n_breaks)
    highest = max(10.0, 5 * np.ceil(np.nanmax(failed) / 5))
    for axes, rates, label in zip(lots, failed, labels, strict=True):
        slots = _shapes(
            axes,
            _SLOTS,
            array=rates,
            cmap="Purples",
            clim=(0, highest),
            edgecolors=GRID,
            linewidths=0.4,
        )
        axes.set_title(label)
        if columns < 3:
            for (x, y), rate in zip(SLOT_POSITIONS, rates, strict=True):
                if np.isfinite(rate):
                    colour = text_colour(slots.to_rgba(rate))
                    axes.text(
                        x, y, f"{rate:.0f}", ha="center", va="center", color=colour, fontsize=5.2
                    )
    bar = figure.colorbar(slots, ax=lots, aspect=30, pad=0.02, shrink=min(1.0, 1.4 * columns / n))
    bar.set_label("failed episodes (%)")
    yield (
        figure,
        "The lot from above: share of episodes with that goal slot that failed (crash or timeout), "
        "in %, all seeds "
        "together.",
    )


def _failures(cell: Any) -> np.ndarray:
    """Return the percentage of failed episodes by goal slot, NaN without episodes. Shape (28,)."""
    rates = np.full(len(SLOT_POSITIONS), np.nan)
    for row in cell.task_data.get("slots", ()):
        rates[row["slot"]] = percentages([row["crash"], row["timeout"]]).sum()
    return rates


def draw_vehicle_rates(report: Any) -> Iterator[Drawing]:
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
