"""Figures of the parking lot from above: failures by goal slot, and sampled trajectories."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from parking_exp.figure_style import (
    GRID,
    INK,
    WIDTH_IN,
    Drawing,
    cell_labels,
    new_figure,
    percentages,
    text_colour,
)
from parking_exp.tasks.parking.geometry import (
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    LOT_LENGTH_M,
    LOT_WIDTH_M,
    SLOT_LENGTH_M,
    SLOT_POSITIONS,
    SLOT_WIDTH_M,
)
from parking_exp.tasks.parking.lot_map import OUTCOMES, Path
from parking_exp.tasks.parking.parking_metrics import METRICS

COLOURS = {metric.name: metric.colour or INK for metric in METRICS}
_MOST_ROWS = 6  # of trajectories

_CORNERS = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) / 2
_CAR = _CORNERS * (CAR_LENGTH_M, CAR_WIDTH_M)
_ARROW = np.array([(4.0, 0.0), (0.0, 1.2), (0.8, 0.0), (0.0, -1.2)])
_SLOTS = SLOT_POSITIONS[:, None] + _CORNERS * (SLOT_WIDTH_M, SLOT_LENGTH_M)  # (28, 4, 2)


def _lots(n: int, columns: int, head: float) -> tuple[Figure, np.ndarray]:
    """Return a figure of parking lots, and their axes in metres, shape (n,); `head` [in] is the height of titles.

    The frame of the axes is the wall.
    """
    rows = -(-n // columns)
    figure = new_figure(0.4 + rows * (head + (WIDTH_IN - 0.8) / columns * LOT_WIDTH_M / LOT_LENGTH_M))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in panels.flat[n:]:
        axes.remove()
    for number, axes in enumerate(lots := panels.flat[:n]):
        axes.set(aspect="equal", xticks=(-30, 0, 30), yticks=(-20, 0, 20))
        axes.set(xlim=(-LOT_LENGTH_M / 2, LOT_LENGTH_M / 2), ylim=(-LOT_WIDTH_M / 2, LOT_WIDTH_M / 2))
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


def draw_scene_map(cells: Sequence[Any]) -> Iterator[Drawing]:
    """Draw, for each goal slot, the share of episodes that failed, and where failed episodes ended."""
    failed = [(cell, _failures(cell)) for cell in cells]
    failed = [(cell, rates) for cell, rates in failed if np.isfinite(rates).any()]
    if not failed:
        return
    n = len(failed)
    columns = min(n, 2 if n <= 4 else 3 if n <= 12 else 4)
    labels = cell_labels([cell for cell, _ in failed], 84 // columns, lines=2)
    figure, lots = _lots(n, columns, head=0.22 + 0.13 * max(label.count("\n") for label in labels))
    highest = max(10.0, 5 * np.ceil(max(np.nanmax(rates) for _, rates in failed) / 5))
    for axes, (cell, rates), label in zip(lots, failed, labels, strict=True):
        slots = _shapes(axes, _SLOTS, array=rates, cmap="Purples", clim=(0, highest), edgecolors=GRID, linewidths=0.4)
        axes.set_title(label)
        if columns < 3:
            for (x, y), rate in zip(SLOT_POSITIONS, rates, strict=True):
                if np.isfinite(rate):
                    colour = text_colour(slots.to_rgba(rate))
                    axes.text(x, y, f"{rate:.0f}", ha="center", va="center", color=colour, fontsize=5.2)
        for outcome, marker in (("crash", "x"), ("timeout", "o")):
            failures = cell.task_data.get("failures", ())
            ends = np.array([(x, y) for x, y, ended in failures if ended == outcome]).reshape(-1, 2)
            style = {"color": COLOURS[outcome], "markerfacecolor": "none", "markeredgewidth": 0.6, "alpha": 0.6}
            axes.plot(*ends.T, linestyle="", marker=marker, markersize=2.6, **style)
    bar = figure.colorbar(slots, ax=lots, aspect=30, pad=0.02, shrink=min(1.0, 1.4 * columns / n))
    bar.set_label("failed episodes (%)")
    ends_note = " × where crashes, ○ where timeouts ended (a sample)."  # noqa: RUF001
    yield (
        figure,
        "The lot from above: share of episodes with that goal slot that failed (crash or timeout), in %, all seeds "
        f"together.{ends_note if any(cell.task_data.get('failures') for cell, _ in failed) else ''}",
    )


def _failures(cell: Any) -> np.ndarray:
    """Return the percentage of failed episodes by goal slot, NaN without episodes. Shape (28,)."""
    rates = np.full(len(SLOT_POSITIONS), np.nan)
    for slot in cell.task_data.get("slots", ()):
        rates[slot.slot] = percentages([slot.crash, slot.timeout]).sum()
    return rates


def draw_trajectories(cells: Sequence[Any]) -> Iterator[Drawing]:
    """Draw sampled episodes from above, a row per cell, a column per outcome."""
    sampled = [cell for cell in cells if cell.task_data.get("paths")]
    if not sampled:
        return
    best = sorted(sampled, key=lambda cell: -(cell.success.value or 0))[:_MOST_ROWS]
    shown = [cell for cell in sampled if cell in best]
    figure, lots = _lots(3 * len(shown), 3, head=0.24)
    rows = lots.reshape(-1, 3)
    for axes, outcome in zip(rows[0], OUTCOMES, strict=True):
        axes.set_title(f"{outcome}\n", loc="center")  # above the label of the first row
    for row, cell, label in zip(rows, shown, cell_labels(shown, 80), strict=True):
        row[0].set_title(label)
        for axes, outcome in zip(row, OUTCOMES, strict=True):
            paths = [path for path in cell.task_data["paths"] if path.outcome == outcome and len(path.x_m)]
            _paths(axes, paths, COLOURS[outcome])
    yield (
        figure,
        "Sampled episodes from above, by how they ended: path of the car from its start (arrow) to its outline where "
        "it ended; the goal slot is shaded, parked cars are grey."
        + (f" The {len(shown)} of {len(sampled)} cells with the highest success." if len(shown) < len(sampled) else ""),
    )


def _paths(axes: Axes, paths: Sequence[Path], colour: str) -> None:
    if not paths:
        axes.text(0, 0, "none", ha="center", va="center", style="italic", alpha=0.7)
        return
    poses = [np.column_stack([path.x_m, path.y_m, path.heading_rad]) for path in paths]
    goals = sorted({path.slot for path in paths})
    others = sorted({slot for path in paths for slot in path.parked_slots}.difference(goals))
    _shapes(axes, _SLOTS[goals], facecolors=colour, alpha=0.3)
    parked = [_placed(_CAR, np.array([x, y, np.pi / 2])) for x, y in SLOT_POSITIONS[others]]
    _shapes(axes, parked, facecolors="#9aa0a6", edgecolors="none")
    axes.add_collection(LineCollection([pose[:, :2] for pose in poses], colors=colour, linewidths=1.0), autolim=False)
    _shapes(axes, [_placed(_CAR, pose[-1]) for pose in poses], facecolors="none", edgecolors=INK, linewidths=0.8)
    _shapes(axes, [_placed(_ARROW, pose[0]) for pose in poses], facecolors=INK, edgecolors="none")


def _placed(shape: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return a shape (n, 2) rotated and moved to a pose (x, y, heading)."""
    x, y, heading = pose
    cos, sin = np.cos(heading), np.sin(heading)
    return shape @ np.array([(cos, sin), (-sin, cos)]) + (x, y)
