"""Exports of results: their frames as small gzipped CSV files, which are analysed again without the store.

    write_export(load("her_ablation"), "docs/results/her_ablation")
    results = read_export("docs/results/her_ablation")  # the frames of `parking_exp.results`, as `load` gives them

`help(parking_exp.results)` has its files and their columns.
"""

import gzip
import json
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
from pydantic import BaseModel, ValidationError

from parking_exp.config.paths import directory_path
from parking_exp.errors import ConfigError, ResultsError, did_you_mean
from parking_exp.evaluation.metrics import DTYPES
from parking_exp.results.dtypes import TEXT, column, flags, typed
from parking_exp.results.frames import CONFIGURED, COST, CURVE_COLUMNS, FINAL, RUN_COLUMNS, STATUSES, Results
from parking_exp.results.recordings import EPISODES, NULLABLE, TRAJECTORIES
from parking_exp.runs.atomic_files import replacing, write_atomically

REPORT = "report.json"
FILES = ("runs.csv.gz", "curves.csv.gz", "outcomes.csv.gz", "trajectories.csv.gz", REPORT)
LOCAL_COLUMNS = ("run_dir", "artifact_uri", "config.output_dir", "config.tracking.uri")
"""Columns of runs that name a place on the machine; an export has none of them."""
PATH = re.compile(r"(?<![\w.~:/])(?:(?:sqlite|file):/*)?~?/(?:[^\s/'\",:;)\]]+/)*([^\s/'\",:;)\]]+)/?")
DAMAGED = (ValueError, TypeError, KeyError, OSError, EOFError, OverflowError, zlib.error)  # what pandas and gzip raise


@dataclass(frozen=True, eq=False)
class Export(Results):
    """Results that were read from an export; `uri` is its folder, as it was passed.

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
    """What `report.json` must have."""

    problems: list[str]
    ignored: int


def write_export(
    results: Results,
    folder: str | Path,
    trajectories: Mapping[str, pd.DataFrame] | None = None,
    about: Mapping[str, Any] | None = None,
    problems: Sequence[str] = (),
) -> Path:
    """Write an export of results, in place of an earlier one, and return its folder.

    The same results give the same bytes. An export that is interrupted has no `report.json` and can't be read.

    Args:
        results: to be exported.
        folder: made if it is not there.
        trajectories: rows of `Results.trajectories` to be kept, by run id.
        about: further entries of `report.json`.
        problems: sentences to be kept besides those of the results.

    Raises:
        ConfigError: the folder holds other files.
    """
    folder = directory_path(folder)
    refuse_foreign(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / REPORT).unlink(missing_ok=True)
    final = results.episodes[results.episodes["phase"] == "final"]
    recordings = [rows.assign(run_id=run_id) for run_id, rows in sorted((trajectories or {}).items())]
    tables = {
        "runs.csv.gz": _exported_runs(results.runs),
        "curves.csv.gz": results.curves,
        # One column per run: equal columns compress to almost nothing.
        "outcomes.csv.gz": final.astype({"run_id": str}).pivot(index="scene", columns="run_id", values="outcome"),
        "trajectories.csv.gz": pd.concat([pd.DataFrame(columns=["run_id", *TRAJECTORIES]), *recordings]).astype(
            TRAJECTORIES
        ),
    }
    tables["outcomes.csv.gz"] = tables["outcomes.csv.gz"].reset_index()
    tables["trajectories.csv.gz"] = tables["trajectories.csv.gz"].drop(columns="speed_mps")
    for name, table in tables.items():
        text = table.to_csv(index=False, float_format="%.2f" if name == "trajectories.csv.gz" else "%.6g")
        with replacing(folder / name) as temporary:  # writes through no link
            temporary.write_bytes(gzip.compress(text.encode(), mtime=1))  # the same content gives the same bytes
    said = [without_paths(one) for one in dict.fromkeys([*problems, *results.problems])]
    described = {"problems": said, "ignored": results.ignored, **(about or {})}
    text = json.dumps(described, ensure_ascii=False, allow_nan=False, indent=1)
    write_atomically(folder / REPORT, text + "\n")
    return folder


def read_export(folder: str | Path) -> Export:
    """Read an export.

    Raises:
        ResultsError: it is not there, not whole, or damaged.
    """
    uri, folder = str(folder), directory_path(folder)
    if folder.is_file():
        raise ResultsError(f"{folder} is a file; name the folder of an export")
    if not folder.is_dir():
        there = [path.name for path in folder.parent.iterdir() if path.is_dir()] if folder.parent.is_dir() else []
        make_one = "; `python scripts/report.py experiment=NAME export=FOLDER` makes one"
        raise ResultsError(f"{folder}: there is no such folder{did_you_mean(folder.name, there) or make_one}")
    if absent := [name for name in FILES if not (folder / name).is_file()]:
        raise ResultsError(f"{folder} is not a whole export: it has no {absent[0]}")

    def read(name: str, parse: Callable[[Path], Any]) -> Any:
        try:
            return parse(folder / name)
        except DAMAGED as error:
            what = f"it has no column {error}" if isinstance(error, KeyError) else str(error).partition("\n")[0]
            raise ResultsError(f"{folder / name} can't be read: {what}") from error

    about, described = read(REPORT, _read_report)
    runs = read("runs.csv.gz", _read_runs)
    curves = read("curves.csv.gz", lambda path: _read_curves(path, runs["run_id"]))
    episodes = read("outcomes.csv.gz", lambda path: _read_episodes(path, runs))
    recordings = read("trajectories.csv.gz", lambda path: _read_recordings(path, runs["run_id"]))
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


def without_paths(words: str) -> str:
    """Return a text in which absolute paths are only their last part."""
    return PATH.sub(r"\1", words)


def _exported_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """Return runs without columns that name a place; the config is written as MLflow has parameters."""
    kept = runs.drop(columns=[name for name in LOCAL_COLUMNS if name in runs])
    config = {str(name): kept[name].astype(object).map(_as_param) for name in kept if str(name).startswith("config.")}
    texts = kept.assign(**config).select_dtypes(["object", "string"])
    return kept.assign(**{str(name): texts[name].map(without_paths, na_action="ignore") for name in texts})


def _as_param(value: Any) -> str:
    return "None" if pd.isna(value) else str(value)


def _read_report(path: Path) -> tuple[dict[str, Any], _ExportEntries]:
    """Return the content of `report.json`, and what of it is needed here."""
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        return about, _ExportEntries.model_validate(about)
    except (ValidationError, RecursionError) as error:
        raise ValueError("it is no description of an export") from error


def _read_runs(path: Path) -> pd.DataFrame:
    found = pd.read_csv(path, dtype=str, keep_default_na=False, na_values=[""])
    found = found.reindex(columns=[*found.columns, "run_dir", "artifact_uri"])
    names = [str(name) for name in found]
    versions, keys = (sorted(name for name in names if name.startswith(what)) for what in ("version.", "config."))
    runs = pd.DataFrame({name: _run_column(name, found[name]) for name in (*RUN_COLUMNS, *versions, *keys)})
    if runs.empty or not runs["run_id"].is_unique:
        raise ValueError("it has no runs, or one of them twice")
    return runs


def _run_column(name: str, words: pd.Series) -> Any:
    known = [None if pd.isna(word) else word for word in words]
    if name.startswith("config."):
        return column([typed(word) for word in known])
    if name in CONFIGURED.values():
        return pd.to_numeric(words).astype("Int64")
    if name in ("seed", "steps"):
        return pd.to_numeric(words).astype("Int64").astype("int64")  # refuses fractions and gaps
    if name in (*FINAL.values(), *COST.values()):
        return words.astype("float64")
    if name in ("started", "ended"):
        return pd.to_datetime(words, format="ISO8601", utc=True).dt.as_unit("ms")
    if name == "git_dirty":
        return flags(word and word.lower() for word in known)
    if name == "status" and not words.isin(STATUSES).all():
        raise ValueError("it has a status that there is not")
    return pd.Categorical(known, STATUSES) if name == "status" else pd.Series(known, dtype=object).astype(TEXT)


def _read_curves(path: Path, run_ids: pd.Series) -> pd.DataFrame:
    types: dict[str, Any] = dict.fromkeys(CURVE_COLUMNS, "float64") | {"run_id": TEXT, "step": "int64"}
    curves = pd.read_csv(path, dtype=types, float_precision="round_trip")[list(CURVE_COLUMNS)]
    _refuse_other_runs(curves["run_id"], run_ids)
    return curves.sort_values(["run_id", "step"], ignore_index=True)


def _read_episodes(path: Path, runs: pd.DataFrame) -> pd.DataFrame:
    """Return the final episodes; what the export does not have of them is missing."""
    table = pd.read_csv(path, dtype=str).astype({"scene": "int64"})
    _refuse_other_runs(table.columns[1:], runs["run_id"])
    long = table.melt("scene", var_name="run_id", value_name="outcome").dropna(ignore_index=True)
    if not long["outcome"].isin(EPISODES["outcome"].categories).all():
        raise ValueError("it has an outcome that there is not")
    ids = pd.CategoricalDtype(pd.Index(runs["run_id"].to_list(), dtype="str"))
    steps = long["run_id"].map(runs.set_index("run_id")["steps"])
    frame = long.assign(run_id=long["run_id"].astype(ids), step=steps, phase="final").sort_values(["run_id", "scene"])
    types = EPISODES | {name: NULLABLE.get(dtype, dtype) for name, dtype in DTYPES.items()}
    return frame.reindex(columns=["run_id", *EPISODES]).astype(types).reset_index(drop=True)


def _read_recordings(path: Path, run_ids: pd.Series) -> pd.DataFrame:
    rows = pd.read_csv(path, dtype={"run_id": TEXT, **TRAJECTORIES}).assign(speed_mps=float("nan"))
    _refuse_other_runs(rows["run_id"], run_ids)
    return rows[["run_id", *TRAJECTORIES]].astype(TRAJECTORIES)


def _refuse_other_runs(found: Any, run_ids: pd.Series) -> None:
    """Refuse a table with rows of runs that are not in the export.

    Raises:
        ValueError: it has some.
    """
    if not pd.Index(found).isin(run_ids).all():
        raise ValueError("it has rows of runs that are not in runs.csv.gz")
