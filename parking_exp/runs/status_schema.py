"""Schemas of `status.json` and `beat.json`; what they hold is checked, since they may be damaged or untrusted."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from parking_exp.runs.atomic_files import read_json

Status = Literal["pending", "running", "done", "failed", "interrupted", "pruned"]
"""What status.json says. `running` may be out of date: the process may be gone (`read_state` looks)."""
Count = Annotated[int, Field(ge=0, le=10**15)]
Seconds = Annotated[float, Field(ge=0, le=1e12)]


class _Entries(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class StatusEntries(_Entries):
    """How far a run is; `run_state.RunState` says what the entries mean."""

    status: Status | None = None
    label: str | None = None
    error: str | None = None
    killed: bool | None = None
    total_timesteps: Count | None = None
    steps: Count | None = None
    success_rate: Annotated[float, Field(ge=0, le=1)] | None = None
    wall_s: Seconds | None = None
    cpu_s: Seconds | None = None
    memory_bytes: Count | None = None
    host: str | None = None
    pid: Count | None = None
    started: Seconds | None = None
    run_id: str | None = None
    tracking_uri: Annotated[str, Field(pattern=r"^[^\x00-\x1f]+$")] | None = None
    unsynced: str | None = None
    command: str | None = None
    search: str | None = None
    trial: Count | None = None


class HeartbeatEntries(_Entries):
    """What a process that trains writes every second."""

    time: Seconds | None = None
    step: Count | None = None
    steps_per_s: Annotated[float, Field(ge=0, le=1e9)] | None = None
    doing: str | None = None


def read_entries(path: Path, schema: type[BaseModel]) -> tuple[dict[str, Any], str | None]:
    """Return a file's entries, and what is wrong with it. Entries of another type than the schema's are left out.

    A file that is not there has no entries, and there is nothing wrong with it.
    """
    try:
        stored = read_json(path)
    except (OSError, ValueError):
        stored = "damaged"
    if stored is None:
        return {}, None
    if not isinstance(stored, dict):
        return {}, f"{path.name} can't be read"
    entries = {key: value for key, value in stored.items() if value is not None}
    try:
        schema.model_validate(entries)
    except ValidationError as error:
        wrong = {str(problem["loc"][0]) for problem in error.errors()}
        valid = {key: value for key, value in entries.items() if key not in wrong}
        return valid, f"{path.name} has no valid {' and no valid '.join(sorted(wrong))}"
    return entries, None
