"""The version of the layout of run directories, and recognition of runs made by another version of this package."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from parking_exp.runs.provenance import PROVENANCE_FILE, read_provenance

LAYOUT = 1
"""Written into each new status.json and checkpoint; what has none is older.

Raise it when a class that a stored config may name moves, or when files of a run or a checkpoint change their content.
"""


def new_entries() -> dict[str, Any]:
    """Return what a status.json or a checkpoint's manifest begins with."""
    return {"layout": LAYOUT}


def other_version(entries: Mapping[str, Any]) -> str | None:
    """Return `an earlier version of parking_exp` or `a later` one for its entries, or None for those of this version.

    No entries are of a run that is new, or whose status.json is damaged.
    """
    layout = entries.get("layout", 0)
    if not entries or layout == LAYOUT:
        return None
    later = isinstance(layout, int) and layout > LAYOUT
    return f"{'a later' if later else 'an earlier'} version of parking_exp"


def refusal(path: Path, maker: str) -> str:
    """Return what to do with the run directory of another version."""
    commit = str(read_provenance(path / PROVENANCE_FILE)[1].get("git_commit", ""))
    # The file may come from anywhere, and this is for typing.
    known = re.fullmatch(r"[0-9a-f]{12,64}", commit)
    way = f"`git checkout {commit[:12]}` gives the version that can use it" if known else "that version can use it"
    return f"it was made by {maker} and is left as it is: {way}; to train it anew with this one, move it away first"
