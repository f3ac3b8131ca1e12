"""Number formatting, and escaping for Markdown, LaTeX and CSV. What is not known is an empty text."""

import re
from typing import Any

from parking_exp.config.cell_labels import setting
from parking_exp.statistics import Interval, Proportion
from parking_exp.statistics.checks import finite_or_none

CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")


def percent(share: float | None, *, signed: bool = False) -> str:
    """Write 0.944 as `94.4`."""
    if (share := finite_or_none(share)) is None:
        return ""
    return f"{100 * share + 0.0:{'+' if signed else ''}.1f}".replace("-", "−" if signed else "-")  # noqa: RUF001


def number(value: float | None, digits: int = 0) -> str:
    """Write 40000 as `40,000`."""
    return "" if (value := finite_or_none(value)) is None else f"{value:,.{digits}f}"


def probability(p: float | None) -> str:
    """Write a p value for a table: three digits, and nothing smaller."""
    if (p := finite_or_none(p)) is None:
        return ""
    return "<0.001" if p < 0.001 else f"{p:.3f}"


def p_value(p: float | None) -> str:
    """Write a p value for a sentence: `p = 0.012`."""
    if (p := finite_or_none(p)) is None:
        return ""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}" if p < 0.1 else f"p = {p:.2f}"


def percent_interval(interval: Interval, *, signed: bool = False) -> str:
    """Write `94.4 [91.2, 97.1]`, or the number alone where it has no interval."""
    value, low, high = (percent(part, signed=signed) for part in (interval.value, interval.low, interval.high))
    return value + brackets(low, high) if value else ""


def number_interval(interval: Interval) -> str:
    """Write `24,000 [21,500, 26,100]`, or the number alone where it has no interval."""
    value, low, high = (number(part) for part in (interval.value, interval.low, interval.high))
    return value + brackets(low, high) if value else ""


def share_interval(share: Proportion) -> str:
    """Write `9/10 [59.6, 98.2]`: of ten, nine, with the interval of their share in per cent."""
    return f"{share.k}/{share.n}" + brackets(percent(share.low), percent(share.high)) if share.n else ""


def rate_text(value: float | None) -> str:
    """Write 0.944 as `94.4 %`, for sentences and hover values."""
    return f"{percent(value)} %" if finite_or_none(value) is not None else "unknown"


def rate_interval(interval: Interval) -> str:
    """Write `94.4 % [91.2, 97.1]`, or the number alone where it has no interval."""
    return rate_text(interval.value) + brackets(percent(interval.low), percent(interval.high))


def points(difference: float | None) -> str:
    """Write a difference of rates in percentage points: `+3.2`, with a proper minus."""
    text = percent(difference, signed=True)
    return "0.0" if text[1:] == "0.0" else text


def points_interval(interval: Interval) -> str:
    """Write `+9.1 points [+4.0, +14.2]`, or the number alone."""
    return f"{points(interval.value)} points{brackets(points(interval.low), points(interval.high))}"


def words(value: Any) -> str:
    """Write a name or a few words."""
    return "" if value is None else str(value)


def level(value: Any) -> str:
    """Write a factor's level; a control that has no such key has none."""
    return "none" if value is None else setting(value)


def brackets(low: str, high: str) -> str:
    """Write the ends of an interval as ` [91.2, 97.1]`, nothing where one is missing."""
    return f" [{low}, {high}]" if low and high else ""


def one_line(text: str) -> str:
    """Return a text without line breaks and other control characters."""
    return CONTROL.sub(" ", text).strip()


_LATEX = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "−": "$-$",  # noqa: RUF001
    "≥": r"$\geq$",
    "×": r"$\times$",  # noqa: RUF001
}
_MARKDOWN = re.compile(r"([\\`*_\[\]<>|~$&#!])")
_LIST_MARK = re.compile(r"^(\d+)([.)])(?=\s|$)|^([-+=])(?!\d)")


def latex(text: str) -> str:
    """Escape a text for LaTeX; `[` at its start would otherwise be an argument of the line break before it."""
    escaped = "".join(_LATEX.get(character, character) for character in one_line(text))
    return "{}" + escaped if escaped.startswith(("[", "*")) else escaped


def markdown(text: str) -> str:
    """Escape a text for GitHub's Markdown, tables included."""
    escaped = _MARKDOWN.sub(r"\\\1", one_line(text))
    return _LIST_MARK.sub(lambda match: rf"{match[1] or ''}\{match[2] or match[3]}", escaped)


def csv(value: Any) -> Any:
    """Keep spreadsheets from running a text as a formula: an apostrophe before `=`, `+`, `-`, `@`, tab and return."""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) else value
