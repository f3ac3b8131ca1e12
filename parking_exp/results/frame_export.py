"""Export results: their frames as small gzipped CSV files, to be analysed again without the store.

    write_export(load("her_ablation"), "docs/results/her_ablation")
    results = read_export("docs/results/her_ablation")

`help(parking_exp.results)` has its files and their columns.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from parking_exp.config.paths import absolute_path
from parking_exp.config.settings import decode_setting, encode_setting
from parking_exp.errors import ConfigError, ResultsError
from parking_exp.results.artifact_parsers import (
    CURVE_KEYS,
    CURVE_TYPES,
    EPISODE_TYPES,
    REQUIRED_TYPES,
)
from parking_exp.results.frames import (
    CONFIG_PREFIX,
    FINAL_COLUMNS,
    RUN_TYPES,
    TEXT,
    Results,
    as_results_error,
    config_columns,
    run_category,
    setting_column,
    typed_curves,
)
from parking_exp.runs.atomic_files import write_gzip, write_json
from parking_exp.runs.foreign_files import read_json
from parking_exp.tasks.metrics import EPISODE_SEED
from parking_exp.tasks.registry import added_metrics

REPORT = "report.json"
FILES = ("runs.csv.gz", "curves.csv.gz", "outcomes.csv.gz", REPORT)
LOCAL_COLUMNS = (
    "run_dir",
    "artifact_uri",
    f"{CONFIG_PREFIX}output_dir",
    f"{CONFIG_PREFIX}tracking.uri",
)
"""Columns of runs that name a place on the machine; an export has none of them."""
LABEL_COLUMNS = [f"{CONFIG_PREFIX}label", f"{CONFIG_PREFIX}contrasts"]
"""Columns of runs with labels, in which slashes separate no folders."""
# A path from / or ~, also in a sqlite or file URI, but not in http://HOST/...; group 1 is its last
# part.
ABSOLUTE_PATH = re.compile(
    r"(?<![\w.~:/])(?:(?:sqlite|file):/*)?~?/(?:[^\s/'\",:;)\]]+/)*([^\s/'\",:;)\]]+)/?"
)


def write_export(
    results: Results, folder: str | Path, about: Mapping[str, Any] | None = None
) -> Path:
    """Write an export of results, in place of an earlier one, and return its folder.

    The same results give the same bytes. An export that is interrupted has no `report.json` and
    can't be read.

    Args:
        results: what is exported.
        folder: the folder of the export; it replaces an earlier one.
        about: further entries of `report.json`.

    Raises:
        ConfigError: the folder holds other files.
    """
    folder = absolute_path(folder)
    refuse_foreign(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for outdated in (folder / REPORT, *folder.glob(".tmp-*")):
        outdated.unlink(missing_ok=True)
    tables = {
        "runs.csv.gz": _without_unknown(_exported_runs(results.runs), FINAL_COLUMNS.values()),
        "curves.csv.gz": _without_unknown(results.curves, CURVE_KEYS.values()),
        "outcomes.csv.gz": _exported_outcomes(results.episodes),
    }
    for name, table in tables.items():
        # The exact test recognises shares of episodes to within 1e-12.
        digits = 12 if name == "runs.csv.gz" else 6
        text = table.to_csv(index=False, float_format=f"%.{digits}g")
        # An existing link is replaced, not followed.
        write_gzip(folder / name, text)
    problems = [without_paths(problem) for problem in results.problems]
    write_json(folder / REPORT, {"problems": problems, **(about or {})})
    return folder


def read_export(folder: str | Path) -> Results:
    """Read an export; `Results.uri` is its folder.

    Raises:
        ResultsError: it is not there, not whole, or damaged.
    """
    path = absolute_path(folder)
    for name in FILES:
        if not (path / name).is_file():
            raise ResultsError(f"{path} is not a whole export: it has no {name}")
    with as_results_error(f"{path} can't be read"):
        about = read_json(path / REPORT)
        runs = _read_runs(path / "runs.csv.gz")
        return Results(
            runs,
            curves=_read_curves(path / "curves.csv.gz", runs),
            episodes=_read_episodes(path / "outcomes.csv.gz", runs),
            uri=str(folder),
            problems=tuple(map(str, about["problems"])),
            about=about,
        )


def refuse_foreign(folder: Path) -> None:
    """Raise ConfigError if a folder for an export holds other files."""
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"export={folder} is a file; name a folder")
    names = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    # A killed export leaves files with `.tmp-` in front.
    others = [name for name in names if name not in FILES and not name.startswith(".tmp-")]
    if others:
        raise ConfigError(
            f"export={folder}: it holds other files, e.g. {others[0]}; name a folder of its own"
        )


def without_paths(words: str) -> str:
    """Return a text with absolute paths shortened to their last part."""
    return ABSOLUTE_PATH.sub(r"\1", words)


def _exported_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """Return runs without columns that name a place, with the config as text, as MLflow has it."""
    kept = runs.drop(columns=[*LOCAL_COLUMNS], errors="ignore")
    config = kept[config_columns(kept)].astype(object)
    kept = kept.assign(**config.where(config.notna(), None).map(encode_setting))
    texts = kept.select_dtypes(["object", "string"]).drop(columns=LABEL_COLUMNS, errors="ignore")
    return kept.assign(**texts.map(without_paths, na_action="ignore"))


def _exported_outcomes(episodes: pd.DataFrame) -> pd.DataFrame:
    """Return outcomes of final episodes, a column for each run: equal columns compress well."""
    final = episodes[episodes["phase"] == "final"].astype({"run_id": str})
    return final.pivot(index=EPISODE_SEED, columns="run_id", values="outcome").reset_index()


def _without_unknown(frame: pd.DataFrame, metrics: Iterable[str]) -> pd.DataFrame:
    """Return a frame without the metrics that none of its runs has; reading adds them again."""
    unknown = [name for name in metrics if name in frame and frame[name].isna().all()]
    return frame.drop(columns=unknown)


def _read_runs(path: Path) -> pd.DataFrame:
    timestamps = ["started", "ended"]
    types = defaultdict(lambda: TEXT, {**RUN_TYPES, **dict.fromkeys(timestamps, TEXT)})
    runs = pd.read_csv(path, dtype=types, keep_default_na=False, na_values=[""])
    for name in timestamps:
        runs[name] = pd.to_datetime(runs[name], format="ISO8601", utc=True)
    versions = sorted(map(str, runs.filter(regex=r"^version\.")))
    settings = sorted(config_columns(runs))
    for name in settings:
        texts = runs[name].astype(object).where(runs[name].notna(), None)
        runs[name] = config_column(texts)
    # The copy is in one piece, after so many columns were replaced.
    runs = runs.copy().assign(run_dir=None, artifact_uri=None)
    # Exports have no metrics that only other tasks have.
    missing = [name for name in FINAL_COLUMNS.values() if name not in runs]
    runs = runs.reindex(columns=[*runs.columns, *missing])
    columns = RUN_TYPES | dict.fromkeys(added_metrics(runs.columns), "float64")
    return runs[[*columns, *versions, *settings]].astype(columns)


def config_column(texts: Iterable[str | None]) -> pd.Series:
    """Return the typed values of a config key."""
    return setting_column([decode_setting(text) for text in texts])


def _read_curves(path: Path, runs: pd.DataFrame) -> pd.DataFrame:
    curves = pd.read_csv(path, dtype=CURVE_TYPES)
    curves = typed_curves(curves[curves["run_id"].isin(runs["run_id"])])
    return curves.sort_values(["run_id", "step"], ignore_index=True)


def _read_episodes(path: Path, runs: pd.DataFrame) -> pd.DataFrame:
    """Return the final episodes; columns that an export lacks have missing values."""
    table = pd.read_csv(path, dtype=str).astype({EPISODE_SEED: "int64"})
    outcomes = table.melt(EPISODE_SEED, var_name="run_id", value_name="outcome")
    episodes = outcomes.dropna(ignore_index=True)
    steps = episodes["run_id"].map(runs.set_index("run_id")["steps"])
    episodes = episodes.assign(step=steps, phase="final")
    episodes = episodes.astype({"run_id": run_category(runs["run_id"])}).dropna(subset="run_id")
    episodes = episodes.astype(REQUIRED_TYPES).sort_values(
        ["run_id", EPISODE_SEED], ignore_index=True
    )
    return episodes.reindex(columns=["run_id", *EPISODE_TYPES])
