"""Conversion of a store's texts to typed columns."""

import re
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import pandas as pd

TEXT: Any = "str" if int(pd.__version__.partition(".")[0]) >= 3 else object
INTEGER = re.compile(r"[+-]?\d+")
FLOAT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?inf|nan", re.IGNORECASE)
INT64 = range(-(2**63), 2**63)
YEAR_10000_MS = 253_402_300_800_000
DIGITS = 300  # of whole numbers that floats can take


@lru_cache(maxsize=100_000)
def typed(text: str | None) -> Any:
    """Return the value that a parameter is the text of: None, a bool, a number. Lists, mappings and words stay text."""
    if text is None or text == "None":
        return None
    if text in ("True", "False"):
        return text == "True"
    if INTEGER.fullmatch(text) and len(text) < DIGITS:
        return int(text)
    return float(text) if FLOAT.fullmatch(text) and not INTEGER.fullmatch(text) else text


def column(values: Sequence[Any]) -> Any:
    """Return values as a column of one type where they are of one, else as objects. None is missing."""
    known = [value for value in values if value is not None]
    types, gaps = {type(value) for value in known}, len(known) < len(values)
    if types == {bool}:
        return pd.array(values, "boolean" if gaps else "bool")
    if types == {int} and all(value in INT64 for value in known):
        return pd.array(values, "Int64" if gaps else "int64")
    if types and types <= {int, float}:
        return np.array([np.nan if value is None else value for value in values], dtype="float64")
    return text(values) if types == {str} else pd.Series(values, dtype=object)


def text(values: Iterable[str | None]) -> Any:
    """Return texts as a column; None is missing."""
    return pd.Series(list(values), dtype=object).astype(TEXT)


def integers(values: Iterable[str | None]) -> Any:
    """Return the whole numbers that are written in texts; what is none is missing."""
    known = [value if type(value := typed(word)) is int and value in INT64 else None for word in values]
    return pd.array(known, dtype="Int64")


def flags(values: Iterable[str | None]) -> Any:
    """Return a column of `true` and `false`; anything else is missing."""
    return pd.array([{"true": True, "false": False}.get(value or "") for value in values], dtype="boolean")


def times(values: Iterable[int | None]) -> Any:
    """Return milliseconds since 1970 as times in UTC; None is missing, and so is what no calendar has."""
    known = [value if value is not None and 0 <= value < YEAR_10000_MS else None for value in values]
    return pd.to_datetime(pd.Series(known, dtype="Int64"), unit="ms", utc=True).dt.as_unit("ms")
