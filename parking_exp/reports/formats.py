"""Number formatting, and escaping for Markdown, LaTeX and CSV."""

import math
import re
from numbers import Real
from typing import Any

from parking_exp.config.cell_labels import setting
from parking_exp.reports.report_data import Interval, Share

CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")


def finite(value: object) -> float | None:
    """Return a number that is finite, else None: what JSON and readers can take."""
    return float(value) if isinstance(value, Real) and math.isfinite(value) else None


def within(bound: float, low: float, high: float) -> float | None:
    """Return the end of an interval, cut to what its number can be; None where there is none."""
    return None if (value := finite(bound)) is None else min(max(value, low), high)


def percent(share: float | None, *, signed: bool = False) -> str:
    """Write 0.944 as `94.4`; what is not known as nothing."""
    if (share := finite(share)) is None:
        return ""
    return f"{100 * share + 0.0:{'+' if signed else ''}.1f}".replace("-", "−" if signed else "-")  # noqa: RUF001


def number(value: float | None, digits: int = 0) -> str:
    """Write 40000 as `40,000`."""
    return "" if (value := finite(value)) is None else f"{value:,.{digits}f}"


def probability(p: float | None) -> str:
    """Write a p value: three digits, and nothing smaller."""
    if (p := finite(p)) is None:
        return ""
    return "<0.001" if p < 0.001 else f"{p:.3f}"


def percent_interval(interval: Interval | Share, *, signed: bool = False) -> str:
    """Write `94.4 [91.2, 97.1]`, or the number alone where it has no interval."""
    value = rate(interval)
    return _with_interval(*(percent(part, signed=signed) for part in (value, interval.low, interval.high)))


def number_interval(interval: Interval, digits: int = 0) -> str:
    """Write `24,000 [21,500, 26,100]`, or the number alone where it has no interval."""
    return _with_interval(*(number(part, digits) for part in (interval.value, interval.low, interval.high)))


def rate_text(value: float | None) -> str:
    """Write 0.944 as `94.4 %`, for sentences and hover values."""
    return f"{percent(value)} %" if finite(value) is not None else "unknown"


def rate_interval(interval: Interval) -> str:
    """Write `94.4 % [91.2, 97.1]`, or the number alone where it has no interval."""
    return rate_text(interval.value) + _brackets(percent(interval.low), percent(interval.high))


def points(difference: float | None) -> str:
    """Write a difference of rates in percentage points: `+3.2`, with a proper minus."""
    text = percent(difference, signed=True)
    return "0.0" if text[1:] == "0.0" else text


def points_interval(interval: Interval) -> str:
    """Write `+9.1 points [+4.0, +14.2]`, or the number alone."""
    return f"{points(interval.value)} points{_brackets(points(interval.low), points(interval.high))}"


def p_value(p: float | None) -> str:
    """Write `p = 0.012`; what is not known as nothing."""
    if (p := finite(p)) is None:
        return ""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}" if p < 0.1 else f"p = {p:.2f}"


def rate(share: Interval | Share) -> float | None:
    """Return an interval's value, a share's k / n."""
    if isinstance(share, Interval):
        return finite(share.value)
    return share.k / share.n if share.n else None


def level(value: Any) -> str:
    """Write a factor's level; a control that has no such key has none."""
    return "none" if value is None else setting(value)


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


def _with_interval(value: str, low: str, high: str) -> str:
    return value + _brackets(low, high) if value else value


def _brackets(low: str, high: str) -> str:
    return f" [{low}, {high}]" if low and high else ""
