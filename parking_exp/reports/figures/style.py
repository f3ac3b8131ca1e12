"""The style of figures: colour, marker and line of each cell, fonts, and text that fits and can be drawn."""

import re
import unicodedata
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from parking_exp.reports.report_data import Cell

COLUMN_IN, FULL_IN = 3.3, 6.8
TEXT_PT, SMALL_PT, TINY_PT = 8.0, 7.0, 6.0

# Pages replace these three by variables of their theme; nothing else is drawn with them.
INK, GRID, PAPER = "#1c1e21", "#d5d8dc", "#fffffe"

# Okabe and Ito's palette without black and yellow, and two of Paul Tol's `muted`.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#999933")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")  # one less than colours: no pair repeats in 56 cells
_LINES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1.2, 1.2)), (0, (5, 1.2, 1.2, 1.2)))

_RC = {
    "font.family": "DejaVu Sans",
    "font.size": TEXT_PT,
    "text.parse_math": False,
    "text.hinting": "none",  # at small sizes the hinter's letters grow serifs
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.labelsize": TEXT_PT,
    "axes.linewidth": 0.6,
    "axes.facecolor": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": False,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": SMALL_PT,
    "ytick.labelsize": SMALL_PT,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "figure.facecolor": "none",
    "savefig.facecolor": "auto",
    "svg.fonttype": "none",
    "svg.hashsalt": "parking_exp",
    "pdf.fonttype": 42,
}


@dataclass(frozen=True)
class CellStyle:
    """The style of a cell, told apart with or without colour vision: matplotlib's `color`, `marker` and `linestyle`."""

    colour: str
    marker: str
    line: Any


def cell_style(cell_id: str) -> CellStyle:
    """Return the style that follows from a cell's id, `c0`, `c1`, ..., and from nothing else."""
    number = int(cell_id[1:]) if cell_id[1:].isdecimal() else zlib.crc32(cell_id.encode())
    line = _LINES[number // len(_COLOURS) % len(_LINES)]
    return CellStyle(_COLOURS[number % len(_COLOURS)], _MARKERS[number % len(_MARKERS)], line)


@contextmanager
def report_style() -> Iterator[None]:
    """Draw with our settings and matplotlib's defaults, whatever the user's own settings are."""
    import matplotlib

    defaults = {key: value for key, value in matplotlib.rcParamsDefault.items() if not key.startswith("backend")}
    with matplotlib.rc_context({**defaults, **_RC}):
        yield


def clean(text: str) -> str:
    """Return text without control, formatting and unassigned characters; whitespace becomes single spaces."""
    kept = (" " if c.isspace() else c for c in text if c.isspace() or not unicodedata.category(c).startswith("C"))
    return " ".join("".join(kept).split())


@lru_cache(maxsize=1)
def _font() -> Any:
    import matplotlib
    from matplotlib.ft2font import FT2Font

    font = FT2Font(str(Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")))
    font.set_size(100, 72)
    return font


@lru_cache(maxsize=1)
def _characters() -> frozenset[int]:
    return frozenset(_font().get_charmap())


@lru_cache(maxsize=4096)
def _advance(character: str) -> float:
    """Return the width of a character over the font's size, which is what its em dash is wide."""
    font = _font()
    return font.load_char(ord(character)).linearHoriAdvance / font.load_char(ord("—")).linearHoriAdvance


def drawable(text: str) -> str:
    """Return clean text with a box for each character that the font lacks."""
    return "".join(c if ord(c) in _characters() else "□" for c in clean(text))


def width_pt(text: str, size: float = TEXT_PT) -> float:
    """Return the width of one line of text [pt], before there is a figure: its size follows from its labels."""
    return size * sum(_advance(c) for c in drawable(text))


def elided(text: str, width: float, size: float = TEXT_PT) -> str:
    """Return clean text, shortened in its middle to at most `width` points: both ends tell cells apart."""
    text = clean(text)
    if width_pt(text, size) <= width:
        return text
    for kept in range(min(len(text) - 1, 200), 0, -1):
        head = (kept + 1) // 2
        shorter = f"{text[:head].rstrip()}…{text[len(text) - (kept - head) :].lstrip()}"
        if width_pt(shorter, size) <= width:
            return shorter
    return "…"


def labels(cells: Sequence[Cell], width: float, size: float = TEXT_PT) -> dict[str, str]:
    """Return a label of at most `width` points for each cell's id; those that would read the same end in the id."""
    names = _without_common({cell.id: clean(cell.label) for cell in cells})
    short = {key: elided(_narrowed(text, width, size), width, size) or key for key, text in names.items()}
    texts = list(short.values())
    for key, text in names.items():
        if texts.count(short[key]) > 1:
            suffix = f" ({key})"
            short[key] = elided(text, width - width_pt(suffix, size), size) + suffix
    return short


def _without_common(names: dict[str, str]) -> dict[str, str]:
    """Drop the parts of labels that all of them have."""
    parts = {key: text.split(", ") for key, text in names.items()}
    common = set.intersection(*map(set, parts.values())) if len(parts) > 1 else set()
    return {key: ", ".join(part for part in some if part not in common) or names[key] for key, some in parts.items()}


def _narrowed(text: str, width: float, size: float) -> str:
    """Shorten the keys of a label, and no values, as far as it takes: `her_future, n_s…al=4`."""
    for kept in range(16, 1, -2):
        if width_pt(text, size) <= width:
            break
        text = re.sub(rf"(\w{{{kept // 2}}})[\w.…]+(\w{{{kept // 2}}}=)", r"\1…\2", text)
    return text


def widest(texts: Sequence[str], size: float = TEXT_PT) -> float:
    """Return the width of the widest of some texts [pt]; 0 without any."""
    return max((width_pt(text, size) for text in texts), default=0.0)


def seeds_text(n: int) -> str:
    """Return `1 seed` or `n seeds`."""
    return f"{n} seed" if n == 1 else f"{n} seeds"


def thousands(value: float, _position: int | None = None) -> str:
    """Return a number for a tick: `500`, `20k`, `1.5M`."""
    for scale, unit in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= scale * (1 if unit == "M" else 2):
            return f"{value / scale:.10g}{unit}"
    return f"{value:.10g}"
