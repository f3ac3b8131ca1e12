"""Numbers and config values as texts: `X` is for tables, `X_in_words` for sentences.

Tables leave what is not known empty.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from parking_exp.config.settings import display_setting
from parking_exp.reports.report_data import Verdict
from parking_exp.statistics import Interval, finite_or_none

SMALLEST_P = 0.0001  # smaller p values are written as ≤ 0.0001


class VerdictWords(NamedTuple):
    """How a verdict on a pair of cells is written."""

    mark: str  # in figures
    table: str
    verb: str  # in sentences, between A and B


VERDICTS: dict[Verdict, VerdictWords] = {
    "a": VerdictWords("▲", "A is better", "is better than"),
    "b": VerdictWords("▼", "B is better", "is worse than"),
    "same": VerdictWords("≈", "indistinguishable", "is indistinguishable from"),
    "unclear": VerdictWords("~", "unclear", "may differ from"),
    "unknown": VerdictWords("?", "too few seeds", "cannot be compared with"),
}


def percent(share: float | None) -> str:
    """Write 0.944 as `94.4`, and 0.9997 as `99.97`.

    A share near 0 or 1 is never rounded to 0 or 100.
    """
    share = finite_or_none(share)
    if share is None:
        return ""
    if 1e-9 < min(share, 1 - share) < 0.001:
        return f"{min(max(100 * share, 0.01), 99.99):.2f}"
    # Adding 0.0 makes -0.0 positive.
    return f"{100 * share + 0.0:.1f}"


def points(difference: float | None) -> str:
    """Write a difference of rates in percentage points: `+3.2`, and `+0.03` next to 0."""
    difference = finite_or_none(difference)
    if difference is None:
        return ""
    if abs(difference) < 1e-9:
        return "0.0"
    digits = 1 if abs(difference) >= 0.0005 else 2
    return f"{100 * difference:+.{digits}f}".replace("-", "−")  # noqa: RUF001


def number(value: float | None, digits: int = 0) -> str:
    """Write 40000 as `40,000`."""
    value = finite_or_none(value)
    return "" if value is None else f"{value:,.{digits}f}"


def p_value(p: float | None) -> str:
    """Write a p value for a table, down to 0.0001."""
    p = finite_or_none(p)
    if p is None:
        return ""
    if p <= SMALLEST_P:
        return f"≤ {SMALLEST_P}"
    digits = 3 if p >= 0.001 else 4
    # More digits tell on which side of 0.05 it lies.
    while round(p, digits) == 0.05 and p != 0.05 and digits < 6:
        digits += 1
    return f"{p:.{digits}f}"


def p_in_words(p: float | None) -> str:
    """Write a p value for a sentence: `p = 0.012`."""
    text = p_value(p)
    if not text:
        return ""
    return f"p {text}" if text.startswith("≤") else f"p = {text}"


def percent_interval(interval: Interval) -> str:
    """Write `94.4 [91.2, 97.1]`, or the number alone where it has no interval."""
    return percent(interval.value) + _write_bounds(interval, percent)


def points_interval(interval: Interval) -> str:
    """Write `+9.1 [+4.0, +14.2]`, or the number alone."""
    return points(interval.value) + _write_bounds(interval, points)


def points_interval_in_words(interval: Interval) -> str:
    """Write `+9.1 points [+4.0, +14.2]`, or the number alone."""
    return f"{points(interval.value)} points{_write_bounds(interval, points)}"


def percent_in_words(value: float | None) -> str:
    """Write 0.944 as `94.4 %`, and what is not known as `unknown`."""
    text = percent(value)
    return f"{text} %" if text else "unknown"


def percent_interval_in_words(interval: Interval) -> str:
    """Write `94.4 % [91.2, 97.1]`, or the number alone where it has no interval."""
    return percent_in_words(interval.value) + _write_bounds(interval, percent)


def level(value: Any) -> str:
    """Write a factor's level; a control that has no such key has none."""
    return "none" if value is None else display_setting(value)


def _write_bounds(interval: Interval, write: Callable[[float | None], str]) -> str:
    """Write the ends of an interval as ` [91.2, 97.1]`, nothing where one is missing."""
    low = write(interval.low)
    high = write(interval.high)
    return f" [{low}, {high}]" if low and high else ""
