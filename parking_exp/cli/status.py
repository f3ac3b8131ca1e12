"""`scripts/status.py` and `parking-status`: show the progress of runs, read from their directories."""

import json
import re
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from omegaconf import DictConfig
from pydantic import Field
from rich.console import Group, RenderableType
from rich.live import Live

from parking_exp.cli.command import for_each, run_command
from parking_exp.config.paths import absolute, default_uri, directory_path, is_same_store
from parking_exp.config.schema import ConfigModel, Name, StoreConfig
from parking_exp.config.validate import parse
from parking_exp.errors import ConfigError, ParkingError, RunNotFoundError, StoreError, plural, suggestion
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.runs.run_state import RunState, as_plain, read_state
from parking_exp.runs.state_tables import cell_table, state_lines
from parking_exp.terminal import console, say
from parking_exp.tracking.mirror import mirror_missing
from parking_exp.tracking.store import Store
from parking_exp.tuning.search import SEARCH_FILE, StoredSearch, study_in
from parking_exp.tuning.search_config import Storage
from parking_exp.tuning.trials import counts, progress_lines, trial_table

WATCH_S = 2.0
FLAGS = {"--json": "json=true", "--watch": "watch=true", "--sync": "sync=true"}


def main() -> None:
    """Run the command."""
    run_command("status", for_each("status", validate_status, show), flags=FLAGS, read=status_overrides)


def status_overrides(words: list[str]) -> list[str]:
    """Replace `experiment=NAME` by `experiment_name=NAME`: in `conf/`, `experiment` is a group."""
    return [re.sub(r"^experiment=", "experiment_name=", word) for word in words]


class StatusRequest(ConfigModel):
    """The config of scripts/status.py."""

    experiment_name: Name | None
    output_dir: str
    as_json: Annotated[bool, Field(alias="json")]
    watch: bool
    sync: bool
    tracking: StoreConfig
    storage: Storage | None

    @property
    def output_path(self) -> Path:
        """Absolute output directory."""
        return directory_path(self.output_dir)


def validate_status(config: DictConfig) -> StatusRequest:
    """Validate a composed config."""
    request = parse(StatusRequest, config)
    if request.watch and request.as_json:
        raise ConfigError("watch=true shows tables; repeat the command with json=true instead")
    return request


def show(config: DictConfig) -> None:
    """Print the progress of runs, repeatedly with `watch`."""
    request, out = validate_status(config), console()
    if request.sync:
        _sync(request)
    if request.as_json:
        content = as_plain(_read_states(request)) | {"searches": _searches_plain(request)}
        say(*json.dumps(content, indent=2).split("\n"))
    elif request.watch and out.is_terminal:
        with Live(_tables(request), console=out, auto_refresh=False) as live:
            while True:
                time.sleep(WATCH_S)
                live.update(_tables(request), refresh=True)
    else:
        out.print(_tables(request))
        while request.watch:
            time.sleep(WATCH_S)
            out.print(_tables(request))


def _read_states(request: StatusRequest) -> list[RunState]:
    experiment, folder = request.experiment_name, request.output_path
    if states := [read_state(path) for path in find_runs(folder, experiment)]:
        return states
    if experiment is None:
        raise RunNotFoundError(f"there are no runs in {folder}; train one first, or set output_dir")
    hint = suggestion(experiment, {path.parents[1].name for path in find_runs(folder)})
    raise RunNotFoundError(f"experiment={experiment}: it has no runs in {folder}{hint}")


def _sync(request: StatusRequest) -> None:
    """Send to the stores whatever they lack."""
    directories = [RunDirectory(path) for path in find_runs(request.output_path, request.experiment_name)]
    uris = {default_uri(request.output_path), *filter(None, [request.tracking.uri])}
    for uri in {directory.tracking_uri for directory in directories}:
        if uri and not any(is_same_store(uri, absolute(named)) for named in uris):
            say(f"left out: runs that are tracked in {uri}; pass tracking.uri={uri} to send them", stderr=True)
    n_failed = 0
    stores = [Store(uri, request.output_path) for uri in uris]
    for directory, problem in (pair for store in stores for pair in mirror_missing(directories, store)):
        say(f"{directory.path}: {problem or 'the store has everything'}", stderr=True)
        n_failed += problem is not None
    if n_failed:
        raise StoreError(f"the store lacks data of {plural(n_failed, 'run')}; sync=true tries again")


def _tables(request: StatusRequest) -> RenderableType:
    states = _read_states(request)
    parts: list[RenderableType] = [cell_table(states), *state_lines(states, "running", "stopped", "failed", "damaged")]
    for name, search in _searches(request):
        if isinstance(search, ParkingError):
            parts.append(f"search {name}: {search}")
        else:
            parts += ["", f"search {name}", trial_table(search.trials, search.search.objective)]
            parts += progress_lines(search.trials, search.search.objective, search.n_trials)
    return Group(*parts)


def _searches(request: StatusRequest) -> Iterator[tuple[str, StoredSearch | ParkingError]]:
    """Yield the name of each search, and the search or the error of reading it."""
    for file in sorted(request.output_path.glob(f"{request.experiment_name or '*'}/{SEARCH_FILE}")):
        try:
            if (search := study_in(file.parent, request.storage)) is not None:
                yield file.parent.name, search
        except ParkingError as error:
            yield file.parent.name, error


def _searches_plain(request: StatusRequest) -> list[dict[str, Any]]:
    """Return the searches and their trials for JSON."""
    plain: list[dict[str, Any]] = []
    for name, search in _searches(request):
        if isinstance(search, ParkingError):
            plain.append({"experiment": name, "error": str(search)})
        else:
            about: dict[str, Any] = {"n_trials": search.n_trials, "objective": search.search.objective}
            about |= {str(state): number for state, number in counts(search.trials).items()}
            plain.append({"experiment": name, **about, "trials": [asdict(trial) for trial in search.trials]})
    return plain
