"""A compact export of results: small CSV files that are analysed again without the store.

    write_export(load("her_ablation"), "docs/results/her_ablation")
    results = read_export("docs/results/her_ablation")  # the frames of `parking_exp.results`, as `load` gives them

`help(parking_exp.results)` has its files and their columns.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd
from pydantic import BaseModel, ValidationError

from parking_exp.config.paths import directory_path
from parking_exp.errors import ConfigError, ResultsError, did_you_mean
from parking_exp.results.export_parser import read_tables
from parking_exp.results.export_tables import TABLES, table_texts, without_paths
from parking_exp.results.frames import Results
from parking_exp.results.recordings import TRAJECTORIES

LAYOUT = 1
REPORT = "report.json"
FILES = (*TABLES, REPORT)


@dataclass(frozen=True, eq=False)
class Export(Results):
    """Results that were read from an export; `uri` is its folder, as it was typed.

    Attributes:
        recordings: rows of `trajectories`, with their run_id.
        about: content of `report.json`.
    """

    recordings: pd.DataFrame = field(default_factory=pd.DataFrame)
    about: Mapping[str, Any] = field(default_factory=dict)

    def trajectories(self, run_id: str) -> pd.DataFrame:
        """Return the trajectories of a run that the export has; `speed_mps` is missing.

        Raises:
            ResultsError: there is no such run.
        """
        self._refuse_unknown(run_id)
        rows = self.recordings[self.recordings["run_id"] == run_id]
        return rows[list(TRAJECTORIES)].reset_index(drop=True)


class _ExportEntries(BaseModel):
    """What `report.json` has to have."""

    problems: list[str]
    ignored: int


def write_export(
    results: Results,
    folder: str | Path,
    trajectories: Mapping[str, pd.DataFrame] | None = None,
    about: Mapping[str, Any] | None = None,
    problems: Sequence[str] = (),
) -> Path:
    """Write an export of results, in place of an earlier one, and return its folder. It is there as a whole or not.

    The same results give the same bytes.

    Args:
        results: to be exported.
        folder: made if it is not there.
        trajectories: by run id, rows of `Results.trajectories` to be kept: of each scene every nth step and the end, or
            the end alone.
        about: further entries of `report.json`.
        problems: sentences to be kept besides those of the results.

    Raises:
        ConfigError: the folder holds other files.
    """
    folder = directory_path(folder)
    refuse_foreign(folder)
    said = [without_paths(one) for one in dict.fromkeys([*problems, *results.problems])]
    described = {"layout": LAYOUT, "problems": said, "ignored": results.ignored, **(about or {})}
    texts = {**table_texts(results, trajectories or {}), REPORT: _lines(described)}
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as place:
        new, old = Path(place) / "new", Path(place) / "old"
        new.mkdir()
        for name, text in texts.items():
            (new / name).write_text(text, encoding="utf-8", newline="\n")
        if folder.exists():
            folder.rename(old)
        try:
            new.rename(folder)
        except OSError:
            if old.exists():
                old.rename(folder)
            raise
    return folder


def read_export(folder: str | Path) -> Export:
    """Read an export.

    Raises:
        ResultsError: it is not there, not whole, damaged, or of another version.
    """
    uri, folder = str(folder), directory_path(folder)
    if folder.is_file():
        raise ResultsError(f"{folder} is a file; name the folder of an export")
    if not folder.is_dir():
        there = [path.name for path in folder.parent.iterdir() if path.is_dir()] if folder.parent.is_dir() else []
        hint = (
            did_you_mean(folder.name, there) or "; `python scripts/report.py experiment=NAME export=FOLDER` makes one"
        )
        raise ResultsError(f"{folder}: there is no such folder{hint}")
    texts = {name: _text(folder / name) for name in FILES if (folder / name).is_file()}
    about, described = _described(folder / REPORT, texts.get(REPORT))
    if absent := [name for name in FILES if name not in texts]:
        raise ResultsError(f"{folder}: it is no whole export; it has no {' and no '.join(absent)}")
    runs, curves, episodes, recordings = read_tables(folder, texts)
    return Export(runs, curves, episodes, uri, tuple(described.problems), described.ignored, None, recordings, about)


def refuse_foreign(folder: Path) -> None:
    """Refuse to put an export where other files are.

    Raises:
        ConfigError: there are some.
    """
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"export={folder}: a file is in the way")
    others = sorted(path.name for path in folder.iterdir() if path.name not in FILES) if folder.exists() else []
    if others:
        raise ConfigError(f"export={folder}: it holds other files, e.g. {others[0]}; name a folder of its own")


def _text(path: Path) -> str:
    try:
        return path.read_bytes().decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ResultsError(f"{path} can't be read: {error}") from error


def _described(path: Path, text: str | None) -> tuple[dict[str, Any], _ExportEntries]:
    """Return the content of `report.json`, and what of it is needed here.

    Raises:
        ResultsError: it is no export's, or another version's.
    """
    if text is None:
        raise ResultsError(f"{path.parent}: it is no export; it has no {path.name}")
    try:
        about = json.loads(text)
        layout = about["layout"]
    except (ValueError, RecursionError, KeyError, TypeError) as error:
        raise ResultsError(f"{path} can't be read: it is no description of an export") from error
    if layout != LAYOUT:
        made = f"another version of parking_exp made it; its layout is {layout!r}"
        raise ResultsError(f"{path.parent}: {made}, and this one reads {LAYOUT}")
    try:
        return about, _ExportEntries.model_validate(about)
    except ValidationError as error:
        what = ".".join(map(str, error.errors()[0]["loc"]))
        raise ResultsError(f"{path} can't be read: {what} is missing or wrong") from error


def _lines(described: Mapping[str, Any]) -> str:
    """Return JSON with a line for each entry, and for each item of a list: small, and a change shows as few lines."""
    return _indented(described, 0) + "\n"


def _indented(value: Any, depth: int) -> str:
    if depth < 3 and value and isinstance(value, Mapping | list):
        space = " " * (depth + 1)
        items = (
            [f"{space}{_compact(key)}: {_indented(one, depth + 1)}" for key, one in value.items()]
            if isinstance(value, Mapping)
            else [f"{space}{_compact(one)}" for one in value]
        )
        opening, closing = "{}" if isinstance(value, Mapping) else "[]"
        return f"{opening}\n" + ",\n".join(items) + f"\n{' ' * depth}{closing}"
    return _compact(value)


def _compact(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
