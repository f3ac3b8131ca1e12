"""Phrases of messages and reports: counted nouns, quoted labels, hints at what was meant."""

import difflib
from collections.abc import Iterable, Sequence

FEW_NAMES = 4  # longer lists of names are cut


def plural(number: int, noun: str) -> str:
    """Return `1 run`, `2 runs`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def printable_line(text: str) -> str:
    """Return text in one line, without control, formatting and unassigned characters."""
    kept = "".join(c for c in text if c.isprintable() or c.isspace())
    return " ".join(kept.split())


def quoted_label(label: str) -> str:
    """Return a label for a sentence: in quotes if it contains commas or semicolons."""
    return f"“{label}”" if "," in label or ";" in label else label


def list_names(names: Sequence[str]) -> str:
    """List the first few names, and how many more there are; a name with commas is in quotes."""
    parts = [quoted_label(name) for name in names[:FEW_NAMES]]
    if len(names) > FEW_NAMES:
        parts.append(f"{len(names) - FEW_NAMES} more")
    return join_with_and(parts)


def join_with_and(parts: Sequence[str]) -> str:
    """Write `a, b and c`."""
    first = ", ".join(parts[:-1])
    return f"{first} and {parts[-1]}" if first else parts[-1]


def did_you_mean(word: str, choices: Iterable[str], cutoff: float = 0.5) -> str:
    """Return `; did you mean 'x'?` for the closest choice, or nothing when none is close."""
    match = difflib.get_close_matches(word, sorted(set(choices)), n=1, cutoff=cutoff)
    return f"; did you mean {match[0]!r}?" if match else ""


def suggestion(word: str, choices: Iterable[str]) -> str:
    """Return `; did you mean 'x'?`, or the choices if few and none is close, or nothing."""
    names = sorted(set(choices))
    few = f"; choose from {', '.join(map(quoted_label, names))}" if 0 < len(names) <= 30 else ""
    return did_you_mean(word, names) or few
