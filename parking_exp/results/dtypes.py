"""Conversion of a store's texts to typed columns."""

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import pandas as pd

TEXT: Any = "str" if int(pd.__version__.partition(".")[0]) >= 3 else object
CONSTANTS = {"None": None, "True": True, "False": False}
INTEGER = re.compile(r"[+-]?\d{1,300}")
FLOAT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?inf|nan", re.IGNORECASE)


@lru_cache(maxsize=100_000)
def typed(text: str | None) -> Any:
    """Return the value that a parameter is the text of: None, a bool, a number. Lists, mappings and words stay text."""
    if text is None or text in CONSTANTS:
        return CONSTANTS[text or "None"]
    if INTEGER.fullmatch(text):
        return int(text)
    return float(text) if FLOAT.fullmatch(text) and not text.strip("+-").isdigit() else text


def column(values: Sequence[Any]) -> pd.Series:
    """Return values as a column of their type; where some are None, they stay as they are."""
    return pd.Series(values, dtype=object if None in values else None)


def text(values: Iterable[str | None]) -> pd.Series:
    """Return texts as a column; None is missing."""
    return pd.Series(list(values), dtype=object).astype(TEXT)


def integers(values: Iterable[str | None]) -> Any:
    """Return the whole numbers that are written in texts; anything else is missing."""
    known = [typed(value) for value in values]
    return pd.array([value if type(value) is int and abs(value) < 2**63 else None for value in known], dtype="Int64")


def times(milliseconds: Iterable[int | None]) -> pd.Series:
    """Return milliseconds since 1970 as times in UTC; what no calendar has is missing."""
    known = pd.Series(list(milliseconds), dtype="Int64")
    return pd.to_datetime(known, unit="ms", utc=True, errors="coerce").dt.as_unit("ms")
