"""Phrases that messages share."""

import difflib
from collections.abc import Iterable

from parking_exp.signatures import UnknownTarget


def several(number: int, noun: str) -> str:
    """Return `1 run`, `2 runs`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def enclosed(label: str) -> str:
    """Return a label as it stands in a sentence: in quotes if it has commas, so that it reads as one name."""
    return f"“{label}”" if "," in label or ";" in label else label


def similar(word: str, choices: Iterable[str], cutoff: float = 0.5) -> str:
    """Return `; did you mean 'x'?` for the closest choice, or nothing when none is close."""
    match = difflib.get_close_matches(word, sorted(set(choices)), n=1, cutoff=cutoff)
    return f"; did you mean {match[0]!r}?" if match else ""


def closest(word: str, choices: Iterable[str]) -> str:
    """Return `; did you mean 'x'?`, or the choices when none is close and they are few, or nothing."""
    names = sorted(set(choices))
    if match := similar(word, names):
        return match
    if names and len(names) <= 30:
        return "; choose from " + ", ".join(names)
    return ""


def no_target(key: str, target: str, error: UnknownTarget) -> str:
    """Return what is wrong with a `_target_` that names nothing."""
    extra = "; pip install 'parking-exp[contrib]'" if target.startswith("sb3_contrib.") and not error.known else ""
    return f"{key}={target}: {error.reason}{closest(target.rpartition('.')[2], error.known)}{extra}"
