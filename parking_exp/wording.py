"""Phrases that error messages share."""

import difflib
from collections.abc import Iterable

from parking_exp.signatures import UnknownTarget


def closest(word: str, choices: Iterable[str]) -> str:
    """Return ` (did you mean 'x'?)`, or the choices when none is close and they are few, or nothing."""
    names = sorted(set(choices))
    if match := difflib.get_close_matches(word, names, n=1, cutoff=0.5):
        return f"; did you mean {match[0]!r}?"
    if names and len(names) <= 30:
        return "; choose from " + ", ".join(names)
    return ""


def no_target(key: str, target: str, error: UnknownTarget) -> str:
    """Return what is wrong with a `_target_` that names nothing."""
    extra = "; pip install 'parking-exp[contrib]'" if target.startswith("sb3_contrib.") and not error.known else ""
    return f"{key}={target}: {error.reason}{closest(target.rpartition('.')[2], error.known)}{extra}"
