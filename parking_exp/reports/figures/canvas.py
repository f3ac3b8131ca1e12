"""The canvas of a figure, laid out in inches: axes, labels, legends, and values under the pointer."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from parking_exp.reports.figures.page_svg import Tip, page_svg
from parking_exp.reports.figures.style import (
    INK,
    SMALL_PT,
    TEXT_PT,
    cell_style,
    drawable,
    labels,
    widest,
)
from parking_exp.reports.report_data import Cell

PNG_DPI = 200
_ROW_PT = 11.0


class Canvas:
    """A figure that is being drawn.

    Attributes:
        figure: matplotlib's, without pyplot, which would keep it open.
        width, height: of the figure [in].
    """

    def __init__(self, width: float, height: float, figure: Any = None) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self.width, self.height = width, height
        self.figure = figure or Figure()
        self.figure.set_size_inches(width, height)
        self.figure.set_dpi(72)  # so that display units are SVG's points
        FigureCanvasAgg(self.figure)
        self._tips: list[Tip] = []
        self._texts: dict[str, str] = {}

    def axes(self, left: float, bottom: float, width: float, height: float, grid: str = "") -> Any:
        """Return axes at a place [in], with a grid along `x`, `y` or `both`."""
        place = (left / self.width, bottom / self.height, width / self.width, height / self.height)
        axes: Any = self.figure.add_axes(place)
        if grid:
            axes.grid(axis=grid)
        return axes

    def blank(self, left: float, bottom: float, width: float, height: float) -> Any:
        """Return axes without ticks or frame whose units are points from their lower left corner."""
        axes = self.axes(left, bottom, width, height)
        axes.set_axis_off()
        axes.set(xlim=(0, 72 * width), ylim=(0, 72 * height))
        return axes

    def text(self, axes: Any, x: float, y: float, text: str, **style: Any) -> None:
        """Write text that may hold anything; `style` are matplotlib's arguments."""
        artist = axes.text(x, y, drawable(text), **{"va": "center", **style})
        if artist.get_text() != text:
            artist.set_gid(f"text-{len(self._texts)}")
            self._texts[artist.get_gid()] = text

    def row_labels(self, axes: Any, texts: Sequence[str], size: float = TEXT_PT) -> None:
        """Label rows 0, 1, ... left of the axes, from the top."""
        from matplotlib.transforms import ScaledTranslation, blended_transform_factory

        left = blended_transform_factory(axes.transAxes, axes.transData)
        place = left + ScaledTranslation(-6 / 72, 0, self.figure.dpi_scale_trans)
        for row, text in enumerate(texts):
            self.text(axes, 0, row, text, ha="right", va="center_baseline", fontsize=size, transform=place)
        axes.set(ylim=(len(texts) - 0.5, -0.5), yticks=[])

    def legend(self, cells: Sequence[Cell], width: float) -> None:
        """Show each cell's line, marker and label, one a row, at the right of the canvas; `width` in inches."""
        left, top = self.width - width, self.height - 0.1
        height = _ROW_PT * len(cells) / 72
        axes = self.blank(left, top - height, width, height)
        short = labels(cells, 72 * width - 27, SMALL_PT)
        for row, cell in enumerate(cells):
            y = 72 * height - (row + 0.5) * _ROW_PT
            look = cell_style(cell.id)
            axes.plot(
                [0, 9, 18], [y] * 3, color=look.colour, ls=look.line, marker=look.marker, markevery=[1], ms=4, lw=1.2
            )
            self.text(axes, 23, y, short[cell.id], fontsize=SMALL_PT, va="center_baseline")
            self.tip_box(axes, 0, y - _ROW_PT / 2, 72 * width, _ROW_PT, cell.label)

    def colour_bar(
        self, place: tuple[float, float, float, float], colours: Any, low: float, high: float, label: str
    ) -> None:
        """Draw an upright scale from `low` to `high` at (left, bottom, width, height) [in]."""
        axes = self.axes(*place)
        edges = np.linspace(low, high, 49)
        step = edges[1] - edges[0]
        # Each bar reaches under the next one, lest viewers show the page between them.
        tops = np.minimum(edges[:-1] + 1.6 * step, high)
        boxes = [(0, bottom, 1, top - bottom) for bottom, top in zip(edges[:-1], tops, strict=True)]
        tiles(axes, boxes, [colours(k / 47) for k in range(48)])
        axes.set(xlim=(0, 1), ylim=(low, high), xticks=[], ylabel=label)
        axes.yaxis.tick_right()
        axes.yaxis.set_label_position("right")
        axes.spines[["left", "bottom"]].set_visible(False)

    def tip_points(self, axes: Any, x: Any, y: Any, texts: Sequence[str], radius: float = 3.5) -> None:
        """Give points values under the pointer; `radius` in points."""
        for (px, py), text in zip(self._places(axes, x, y), texts, strict=True):
            self._tips.append(Tip("circle", {"cx": f"{px:.1f}", "cy": f"{py:.1f}", "r": f"{radius:g}"}, text))

    def tip_box(self, axes: Any, x: float, y: float, width: float, height: float, text: str) -> None:
        """Give a rectangle, in the axes' units, a value under the pointer."""
        corners = self._places(axes, [x, x + width], [y, y + height])
        (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
        sizes = {"x": left, "y": top, "width": right - left, "height": bottom - top}
        self._tips.append(Tip("rect", {key: f"{size:.1f}" for key, size in sizes.items()}, text))

    def tip_line(self, axes: Any, line: np.ndarray, text: str, width: float = 5) -> None:
        """Give a line, shape (n, 2), a value under the pointer; `width` in points."""
        places = self._places(axes, line[:, 0], line[:, 1])
        path = "M" + "L".join(f"{px:.1f} {py:.1f}" for px, py in places)
        self._tips.append(Tip("path", {"d": path, "stroke-width": f"{width:g}", "pointer-events": "stroke"}, text))

    def _places(self, axes: Any, x: Any, y: Any) -> np.ndarray:
        """From the axes' units to SVG's, whose y points down. Shape (n, 2). The axes' limits must be final."""
        data = np.column_stack([np.asarray(x, float), np.asarray(y, float)])
        places = axes.transData.transform(data) if len(data) else data
        return np.column_stack([places[:, 0], 72 * self.height - places[:, 1]])

    def save(self, name: str, title: str, folder: Path, formats: Sequence[str]) -> str:
        """Write `folder/<name>.<format>`, the same bytes for the same drawing; return the SVG for a page."""
        drawing = BytesIO()
        self.figure.savefig(drawing, format="svg", metadata={"Date": None, "Creator": None})
        for kind in formats:
            path = folder / f"{name}.{kind}"
            if kind == "svg":
                path.write_bytes(drawing.getvalue())
            elif kind == "pdf":
                self.figure.savefig(path, format="pdf", metadata={"CreationDate": None})
            else:
                look: dict[str, Any] = {"dpi": PNG_DPI, "facecolor": "white", "pil_kwargs": {"compress_level": 4}}
                self.figure.savefig(path, format=kind, metadata={"Software": None}, **look)
        return page_svg(drawing.getvalue(), name, title, self._tips, self._texts)


def legend_width(cells: Sequence[Cell]) -> float:
    """Return the width of a legend [in]; longer labels are shortened."""
    return min(2.2, widest([cell.label for cell in cells], SMALL_PT) / 72 + 0.42)


def legend_height(cells: Sequence[Cell]) -> float:
    """Return the height of a legend [in]."""
    return _ROW_PT * len(cells) / 72


def tiles(axes: Any, boxes: Sequence[tuple[float, float, float, float]], colours: Sequence[Any], **style: Any) -> None:
    """Draw rectangles (x, y, width, height) as one artist."""
    from matplotlib.collections import PolyCollection

    corners = [[(x, y), (x + w, y), (x + w, y + h), (x, y + h)] for x, y, w, h in boxes]
    axes.add_collection(PolyCollection(corners, facecolors=colours, **{"linewidths": 0, **style}), autolim=False)


def line_90(axes: Any, vertical: bool = False) -> None:
    """Draw the line of 90 % success."""
    style = {"color": INK, "lw": 0.7, "ls": (0, (2, 2)), "alpha": 0.7, "zorder": 1}
    _ = axes.axvline(90, **style) if vertical else axes.axhline(90, **style)


def text_on(colour: Any) -> str:
    """Return black or white, whichever can be read on a colour."""
    from matplotlib.colors import to_rgb

    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(colour))
    return "#000000" if 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.18 else "#ffffff"


def numbers(values: Sequence[float | None]) -> np.ndarray:
    """Return floats, NaN for what is not known."""
    return np.array([np.nan if value is None else value for value in values], dtype=float)
