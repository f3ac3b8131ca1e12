"""Figures of parking reports: failures by goal slot on the lot from above, and outcomes by number
of parked cars.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

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
from parking_exp.tasks.parking.geometry import corners
from parking_exp.tasks.parking.lot import HighwayLot, Lot

_BOX = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) / 2


class LotOutline(NamedTuple):
    """What drawings show of a lot, as reports store it."""

    slots: Sequence[Sequence[float]]  # poses, shape (slots, 3) [m, m, rad]
    slot_size: Sequence[float]  # length and width [m]
    box: Sequence[float]  # length and width between the walls [m]

    @staticmethod
    def of(lot: Lot) -> "LotOutline":
        """Return the outline of a lot, in the middle of its ranges."""
        scene = lot.typical()
        return LotOutline(
            scene.slots[0].tolist(), scene.slot_size[0].tolist(), scene.box[0].tolist()
        )

    def slot_corners(self) -> np.ndarray:
        """Return the corners of the slots, shape (slots, 4, 2) [m]."""
        slots = np.array(self.slots)
        direction = np.stack([np.cos(slots[:, 2]), np.sin(slots[:, 2])], axis=-1)
        length, width = np.tile(self.slot_size, (len(slots), 1)).T
        return corners(slots[:, :2], direction, length, width)


HIGHWAY_OUTLINE = LotOutline.of(HighwayLot((0, 0), 0))


def _lots(outlines: Sequence[LotOutline], columns: int, head: float) -> tuple[Figure, np.ndarray]:
    """Return a figure of the lots of some scenes, and their axes in metres, shape (n,); `head` [in]
    is the height of titles.

    The frame of the axes is the wall of the largest lot.
    """
    n = len(outlines)
    rows = -(-n // columns)
    length, width = np.max([outline.box for outline in outlines], axis=0)
    lot_height = (WIDTH_IN - 0.8) / columns * width / length
    figure = new_figure(0.4 + rows * (head + lot_height))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.flat[n:]:
        axes.remove()
    lots = panels.flat[:n]
    for number, (axes, outline) in enumerate(zip(lots, outlines, strict=True)):
        axes.set(
            aspect="equal",
            xticks=(-30, 0, 30),
            yticks=(-20, 0, 20),
            xlim=(-length / 2, length / 2),
            ylim=(-width / 2, width / 2),
        )
        axes.spines[:].set(visible=True, linewidth=1.8, alpha=0.55)
        axes.xaxis.set_visible(number + columns >= n)
        axes.yaxis.set_visible(number % columns == 0)
        _shapes(axes, outline.slot_corners(), facecolors="none", edgecolors=GRID, linewidths=0.4)
        if np.any(np.array(outline.box) < (length, width)):
            _shapes(axes, [_BOX * outline.box], facecolors="none", edgecolors=GRID, linewidths=1.2)
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
    outlines = []
    failed = []
    for cell in report.shown_cells:
        lot = cell.task_data.get("lot")
        outline = LotOutline(**lot) if lot else HIGHWAY_OUTLINE
        rates = _failures(cell, len(outline.slots))
        if np.isfinite(rates).any():
            cells.append(cell)
            outlines.append(outline)
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
    figure, lots = _lots(outlines, columns, head=0.22 + 0.13 * n_breaks)
    highest = max(10.0, 5 * np.ceil(np.nanmax(np.concatenate(failed)) / 5))
    for axes, outline, rates, label in zip(lots, outlines, failed, labels, strict=True):
        slots = _shapes(
            axes,
            outline.slot_corners(),
            array=rates,
            cmap="Purples",
            clim=(0, highest),
            edgecolors=GRID,
            linewidths=0.4,
        )
        axes.set_title(label)
        if columns < 3:
            for (x, y, _), rate in zip(outline.slots, rates, strict=True):
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


def _failures(cell: Any, n_slots: int) -> np.ndarray:
    """Return the percentage of failed episodes by goal slot, NaN without episodes. Shape
    (n_slots,).
    """
    rates = np.full(n_slots, np.nan)
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
