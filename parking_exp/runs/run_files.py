"""The small files of a run directory, which may be damaged: config, status and heartbeat."""

import json
import re
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field

from parking_exp.config.paths import absolute_uri, relative_uri
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import parse_plain
from parking_exp.errors import ConfigError, first_line
from parking_exp.runs.atomic_files import write_atomically
from parking_exp.runs.foreign_files import MAX_SMALL, parse_plain_yaml, read_file, read_json
from parking_exp.runs.metric_logs import EPISODES_FILE, MONITOR_FILE

CONFIG_FILE = "config.yaml"
STATUS_FILE = "status.json"
RESULT_FILE = "result.json"
HEARTBEAT_FILE = "beat.json"
TRACEBACK_FILE = "traceback.txt"
EVALUATIONS = "evaluations"
SUMMARY_FILE = "summary.json"  # in the folder of an evaluation
PATHS_FILE = "paths.csv.gz"
CURVES_FILE = "curves.png"
VIDEO_FILE = "video.mp4"
PROGRESS_FILE = "progress.csv"
MODELS = "models"
BEST_MODEL = "best.zip"
FINAL_MODEL = "final.zip"
WHOLE_AT_THE_END = (
    EPISODES_FILE,
    PATHS_FILE,
    CURVES_FILE,
    VIDEO_FILE,
    MONITOR_FILE,
    PROGRESS_FILE,
    TRACEBACK_FILE,
    f"{MODELS}/{BEST_MODEL}",
    f"{MODELS}/{FINAL_MODEL}",
)
"""Files that are whole once a run has ended."""
OUTPUT_DIR_FROM_RUN = "../../.."

Status = Literal["pending", "running", "done", "failed", "interrupted"]
"""Status in status.json; the process of a `running` run may be gone (`read_state` checks)."""
# Larger numbers, of a damaged or foreign file, would overflow.
BoundedCount = Annotated[int, Field(ge=0, le=10**15)]
Seconds = Annotated[float, Field(ge=0, le=1e12)]


class _Entries(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False)


Entries = TypeVar("Entries", bound=_Entries)


class StatusEntries(_Entries):
    """Entries of status.json."""

    status: Status | None = None
    label: str | None = None
    error: str | None = None
    killed: bool | None = None
    total_timesteps: BoundedCount | None = None
    steps: BoundedCount | None = None
    success_rate: float | None = None
    wall_s: Seconds | None = None
    cpu_s: Seconds | None = None
    host: str | None = None
    pid: BoundedCount | None = None
    started: Seconds | None = None
    run_id: str | None = None
    tracking_uri: Annotated[str, Field(pattern=r"^[^\x00-\x1f]+$")] | None = None
    command: str | None = None
    search: str | None = None
    trial: BoundedCount | None = None
    cell_number: BoundedCount | None = None
    evaluation: dict[str, BoundedCount] | None = None
    init_sha256: str | None = None


class HeartbeatEntries(_Entries):
    """Entries of beat.json, which a process that trains writes every second."""

    time: Seconds = 0.0
    step: BoundedCount = 0
    steps_per_s: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    doing: str | None = None


def read_entries(path: Path, schema: type[Entries]) -> Entries | None:
    """Return the entries of a file: the defaults if it is missing, None if it is damaged."""
    try:
        stored = read_json(path)
        return schema() if stored is None else schema.model_validate(stored)
    except (OSError, ValueError):
        return None


def write_config(directory: Path, config: RunConfig) -> None:
    """Write a run's config into its directory, with paths relative to it."""
    uri = config.tracking.uri and relative_uri(config.tracking.uri, config.output_path)
    tracking = config.tracking.model_copy(update={"uri": uri})
    changes = {"output_dir": OUTPUT_DIR_FROM_RUN, "tracking": tracking}
    relocatable = config.model_copy(update=changes)
    text = yaml.safe_dump(relocatable.plain(), sort_keys=False)
    directory.mkdir(parents=True, exist_ok=True)
    write_atomically(directory / CONFIG_FILE, text, durable=False)


def find_evaluations(run_dir: Path) -> list[Path]:
    """Return the folders of the evaluations that are complete."""
    summaries = run_dir.glob(f"{EVALUATIONS}/[!.]*/{SUMMARY_FILE}")
    return sorted(summary.parent for summary in summaries)


def evaluation_files(folder: Path) -> list[Path]:
    """Return the files of an evaluation."""
    return [file for file in sorted(folder.glob("[!.]*")) if file.is_file()]


def read_config(directory: Path, output_dir: Path) -> RunConfig:
    """Read a run's config as plain data, with the output directory where the run is now.

    Raises:
        ConfigError: it can't be read, has an interpolation, or does not fit this version of the
            package.
    """
    path = directory / CONFIG_FILE
    try:
        stored = parse_plain_yaml(read_file(path, MAX_SMALL))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or first_line(error)
        raise ConfigError(f"{path} can't be read: {reason}") from error
    if not isinstance(stored, dict):
        raise ConfigError(
            f"{path} can't be read: expected a mapping, got a {type(stored).__name__}"
        )
    interpolation = re.search(r'[^"]*\$\{[^"]*', json.dumps(stored))
    if interpolation is not None:
        raise ConfigError(
            f"{path} contains the interpolation {interpolation[0]}, which a stored config may not"
        )
    try:
        config = parse_plain(RunConfig, stored)
    except ConfigError as error:
        raise ConfigError(f"{path} does not fit this version of parking_exp: {error}") from error
    uri = config.tracking.uri and absolute_uri(config.tracking.uri, output_dir)
    tracking = config.tracking.model_copy(update={"uri": uri})
    return config.model_copy(update={"output_dir": str(output_dir), "tracking": tracking})
