"""Figures of the parking lot from above: failures by goal slot, and sampled trajectories."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from parking_exp.envs.geometry import (
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    LOT_LENGTH_M,
    LOT_WIDTH_M,
    SLOT_LENGTH_M,
    SLOT_POSITIONS,
    SLOT_WIDTH_M,
    WALL_THICKNESS_M,
)
from parking_exp.envs.outcomes import OUTCOMES
from parking_exp.errors import quoted_label
from parking_exp.reports.figures.canvas import Canvas, text_on, tiles
from parking_exp.reports.figures.style import COLUMN_IN, FULL_IN, GRID, INK, SMALL_PT, TINY_PT, labels, width_pt
from parking_exp.reports.formats import rate_text
from parking_exp.reports.report_data import Cell, Path, ReportData, SlotRate
from parking_exp.training.plot_curves import COLOURS

_MOST_ENDS = 150
_MOST_ROWS = 6
_MOST_PATHS = 6  # a panel
_MOST_POINTS = 150  # a path


class _LotGrid:
    """A grid of parking lots on one pair of axes in metres: many axes would take ten times as long to draw.

    Attributes:
        canvas, axes: what they are drawn on.
        origins: centre of each panel [m], row by row. Shape (n, 2).
        scale: points per metre.
    """

    def __init__(self, n: int, columns: int, right: float, gap: float, top: float = 0.0) -> None:
        left, width = 0.48, COLUMN_IN if n == 1 else FULL_IN
        rows = -(-n // columns)
        wide = (width - left - right - 0.1 * (columns - 1)) / columns
        self.scale = 72 * wide / (LOT_LENGTH_M + 2)
        tall = (LOT_WIDTH_M + 2) * self.scale / 72
        height = top + rows * (tall + gap) + 0.42
        self.canvas = Canvas(width, height)
        self.axes = self.canvas.axes(0, 0, width, height)
        self.axes.set_axis_off()
        per_metre = self.scale / 72
        self.axes.set(xlim=(0, width / per_metre), ylim=(-height / per_metre, 0))
        row, column = np.divmod(np.arange(n), columns)
        x = (left + wide / 2 + column * (wide + 0.1)) / per_metre
        y = -(top + row * (tall + gap) + gap + tall / 2) / per_metre
        self.origins = np.column_stack([x, y])
        self.columns = columns

    def ground(self) -> None:
        """Draw walls and slots, and axes in metres beside the outer panels."""
        slots, walls = [], []
        for ox, oy in self.origins:
            slots += [_around(x + ox, y + oy, SLOT_WIDTH_M, SLOT_LENGTH_M) for x, y in SLOT_POSITIONS]
            walls.append(_around(ox, oy, LOT_LENGTH_M, LOT_WIDTH_M))
        tiles(self.axes, slots, ["none"], linewidths=0.4, edgecolors=GRID, zorder=1)
        tiles(
            self.axes, walls, ["none"], linewidths=WALL_THICKNESS_M * self.scale, edgecolors=INK, alpha=0.55, zorder=1
        )
        n, half_x, half_y = len(self.origins), LOT_LENGTH_M / 2 + 1, LOT_WIDTH_M / 2 + 1
        tick = 2.5 / self.scale
        ticks = []
        for index, (ox, oy) in enumerate(self.origins):
            if index + self.columns >= n:
                for x in (-30, 0, 30):
                    ticks.append([(ox + x, oy - half_y), (ox + x, oy - half_y - tick)])
                    self._number(ox + x, oy - half_y - 2 * tick, x, ha="center", va="top")
                self._number(ox, oy - half_y - 14 / self.scale, "x (m)", ha="center", va="top")
            if index % self.columns == 0:
                for y in (-20, 0, 20):
                    ticks.append([(ox - half_x, oy + y), (ox - half_x - tick, oy + y)])
                    self._number(ox - half_x - 1.6 * tick, oy + y, y, ha="right", va="center")
                self._number(ox - half_x - 20 / self.scale, oy, "y (m)", ha="center", va="center", rotation=90)
        self.segments(ticks, color=INK, lw=0.6)

    def _number(self, x: float, y: float, value: int | str, **style: Any) -> None:
        text = str(value).replace("-", "\N{MINUS SIGN}")
        self.axes.text(x, y, text, fontsize=SMALL_PT, **style)

    def segments(self, lines: Sequence[Any], color: Any, lw: float, **style: Any) -> None:
        """Draw many lines as one artist."""
        from matplotlib.collections import LineCollection

        self.axes.add_collection(LineCollection(lines, colors=color, linewidths=lw, **style), autolim=False)

    def shapes(self, corners: Sequence[Any], **style: Any) -> None:
        """Draw many polygons as one artist."""
        from matplotlib.collections import PolyCollection

        self.axes.add_collection(PolyCollection(corners, **style), autolim=False)


def _around(x: float, y: float, width: float, height: float) -> tuple[float, float, float, float]:
    return x - width / 2, y - height / 2, width, height


def scene_map(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw, for each goal slot, the share of episodes that failed, and where failed episodes ended."""
    from matplotlib import colormaps

    cells = [cell for cell in report.shown_cells if any(_failed(slot) is not None for slot in cell.slots)]
    if not cells:
        return None
    columns = min(len(cells), 2 if len(cells) <= 4 else 3 if len(cells) <= 12 else 4)
    grid = _LotGrid(len(cells), columns, right=0.7, gap=0.22)
    grid.ground()
    worst = max(_failed(slot) or 0.0 for cell in cells for slot in cell.slots)
    top = max(10.0, 5 * np.ceil(20 * worst))
    colours = colormaps["Purples"]
    short = labels(cells, LOT_LENGTH_M * grid.scale)
    for cell, (ox, oy) in zip(cells, grid.origins, strict=True):
        y = oy + LOT_WIDTH_M / 2 + 1 + 7 / grid.scale
        grid.canvas.text(grid.axes, ox - LOT_LENGTH_M / 2 - 1, y, short[cell.id])
        _slots(grid, cell, (ox, oy), (colours, top))
    _ends(grid, cells)
    tall = min(1.8, grid.canvas.height - 0.68)
    right = (grid.origins[:, 0].max() + LOT_LENGTH_M / 2 + 1) * grid.scale / 72
    place = (right + 0.12, grid.canvas.height - 0.22 - tall, 0.1, tall)
    grid.canvas.colour_bar(place, colours, 0, top, "failed episodes (%)")
    shown_ends = any(cell.failures for cell in cells)
    ends = " × where crashes, ○ where timeouts ended (a sample)." if shown_ends else ""  # noqa: RUF001
    caption = (
        "The lot from above: share of episodes with that goal slot that failed (crash or timeout), in %, all seeds "
        f"together.{ends}"
    )
    return grid.canvas, caption


def _failed(slot: SlotRate) -> float | None:
    return None if slot.crash is None or slot.timeout is None or not slot.n else slot.crash + slot.timeout


def _slots(grid: _LotGrid, cell: Cell, origin: tuple[float, float], scale: tuple[Any, float]) -> None:
    colours, top = scale
    boxes, fills = [], []
    for slot in cell.slots:
        x, y = SLOT_POSITIONS[slot.slot] + origin
        box, share = _around(x, y, SLOT_WIDTH_M, SLOT_LENGTH_M), _failed(slot)
        if share is None:
            grid.canvas.tip_box(grid.axes, *box, f"{quoted_label(cell.label)}, slot {slot.slot}: no episodes")
            continue
        boxes.append(box)
        fills.append(colours(100 * share / top))
        number = str(round(100 * share))
        if width_pt("88", TINY_PT) < SLOT_WIDTH_M * grid.scale - 0.4 and len(number) < 3:
            style = {"ha": "center", "va": "center_baseline", "fontsize": TINY_PT}
            grid.axes.text(x, y, number, color=text_on(fills[-1]), zorder=4, **style)
        parts = f"{rate_text(slot.crash)} crash, {rate_text(slot.timeout)} timeout"
        tip = f"{quoted_label(cell.label)}, slot {slot.slot}: {rate_text(share)} failed ({parts}), {slot.n:,} episodes"
        grid.canvas.tip_box(grid.axes, *box, tip)
    if boxes:
        tiles(grid.axes, boxes, fills, linewidths=0.4, edgecolors=GRID, zorder=2)


def _ends(grid: _LotGrid, cells: Sequence[Cell]) -> None:
    looks: dict[str, dict[str, Any]] = {
        "crash": {"marker": "x", "ms": 2.6, "mew": 0.6, "color": COLOURS["crash"]},
        "timeout": {"marker": "o", "ms": 2.6, "mew": 0.6, "mfc": "none", "color": COLOURS["timeout"]},
    }
    for outcome, look in looks.items():
        places = []
        for cell, origin in zip(cells, grid.origins, strict=True):
            sampled = _spread(cell.failures, _MOST_ENDS if grid.columns < 3 else _MOST_ENDS // 2)
            places += [(x + origin[0], y + origin[1]) for x, y, how in sampled if how == outcome]
        grid.axes.plot([x for x, _ in places], [y for _, y in places], ls="", alpha=0.6, zorder=3, **look)


def _spread(items: Sequence[Any], most: int) -> list[Any]:
    """Return at most so many items, evenly spaced, the same each time."""
    if len(items) <= most:
        return list(items)
    return [items[k] for k in np.linspace(0, len(items) - 1, most).round().astype(int)]


def trajectories(report: ReportData) -> tuple[Canvas, str] | None:
    """Draw sampled episodes from above, a row per cell, a column per outcome."""
    having = sorted((cell for cell in report.shown_cells if cell.paths), key=lambda cell: -(cell.success.value or 0))
    best = having[:_MOST_ROWS]
    cells = [cell for cell in report.shown_cells if any(cell is one for one in best)]
    if not cells:
        return None
    grid = _LotGrid(3 * len(cells), 3, right=0.05, gap=0.24, top=0.16)
    grid.ground()
    for (x, _), outcome in zip(grid.origins, OUTCOMES, strict=False):
        grid.axes.text(x, -8 / grid.scale, outcome, ha="center", va="center")
    width = (FULL_IN - 0.55) * 72
    short = labels(cells, width)
    for row, cell in enumerate(cells):
        x, y = grid.origins[3 * row] + (-LOT_LENGTH_M / 2 - 1, LOT_WIDTH_M / 2 + 1 + 7 / grid.scale)
        grid.canvas.text(grid.axes, x, y, short[cell.id])
        for column, outcome in enumerate(OUTCOMES):
            paths = [path for path in cell.paths if path.outcome == outcome and len(path.x_m)]
            origin = grid.origins[3 * row + column]
            if not paths:
                grid.axes.text(*origin, "none", ha="center", va="center", alpha=0.7, style="italic")
            _paths(grid, cell, paths[:_MOST_PATHS], origin)
    caption = (
        "Sampled episodes from above, by how they ended: path of the car from its start (arrow) to its outline where "
        "it ended; the goal slot is shaded, parked cars are grey."
        + (f" The {len(cells)} of {len(having)} cells with the highest success." if len(cells) < len(having) else "")
    )
    return grid.canvas, caption


def _paths(grid: _LotGrid, cell: Cell, paths: Sequence[Path], origin: np.ndarray) -> None:
    lines, cars, arrows = [], [], []
    parked: set[int] = set()
    goals: set[int] = set()
    for path in paths:
        pose = np.column_stack([path.x_m, path.y_m, path.heading_rad])[:, :3]
        pose = pose[np.isfinite(pose).all(axis=1)]
        if not len(pose):
            continue
        pose[:, :2] += origin
        thinned = pose[np.unique(np.linspace(0, len(pose) - 1, min(len(pose), _MOST_POINTS)).round().astype(int))]
        lines.append(thinned[:, :2])
        cars.append(_placed(_CAR, pose[-1]))
        arrows.append(_placed(_ARROW, pose[0]))
        parked.update(path.parked_slots)
        goals.add(path.slot)
        which = f"{quoted_label(cell.label)}, seed {path.seed}, scene {path.scene}"
        tip = f"{which}: {path.outcome} after {path.steps} steps, slot {path.slot}"
        grid.canvas.tip_line(grid.axes, thinned[:: max(1, len(thinned) // 40), :2], tip)
    if not lines:
        return
    colour = COLOURS[paths[0].outcome]
    places = [SLOT_POSITIONS[slot] + origin for slot in sorted(goals)]
    boxes = [_around(x, y, SLOT_WIDTH_M, SLOT_LENGTH_M) for x, y in places]
    tiles(grid.axes, boxes, [colour], alpha=0.3, zorder=2)
    others = [_placed(_CAR, (*(SLOT_POSITIONS[slot] + origin), np.pi / 2)) for slot in sorted(parked - goals)]
    if others:
        grid.shapes(others, facecolors="#9aa0a6", edgecolors="none", zorder=2)
    grid.segments(lines, color=colour, lw=1.0, zorder=3)
    grid.shapes(cars, facecolors="none", edgecolors=INK, linewidths=0.8, zorder=4)
    grid.shapes(arrows, facecolors=INK, edgecolors="none", zorder=4)


_CAR = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * (CAR_LENGTH_M / 2, CAR_WIDTH_M / 2)
_ARROW = np.array([(4.0, 0.0), (0.0, 1.2), (0.8, 0.0), (0.0, -1.2)])


def _placed(shape: np.ndarray, pose: Any) -> np.ndarray:
    """Return a shape (n, 2) turned and moved to a pose (x, y, heading)."""
    x, y, heading = pose
    cos, sin = np.cos(heading), np.sin(heading)
    return shape @ np.array([(cos, sin), (-sin, cos)]) + (x, y)
