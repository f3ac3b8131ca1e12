"""The status command: show the progress of runs, read from their directories."""

import json
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
from parking_exp.config.paths import default_uri, directory_path
from parking_exp.config.schema import ConfigModel, Name, StoreConfig
from parking_exp.config.validate import parse
from parking_exp.errors import ConfigError, ParkingError, RunNotFoundError, UnsyncedError, plural, suggestion
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import find_runs
from parking_exp.runs.state import RunState, as_plain, labelled, read_state
from parking_exp.runs.state_tables import cell_table, damaged_lines, failure_lines, running_lines, stopped_lines
from parking_exp.terminal import console, say
from parking_exp.tracking.sync_all import sync_all
from parking_exp.tuning.search import SEARCH_FILE, StoredSearch, study_in
from parking_exp.tuning.search_config import Storage
from parking_exp.tuning.trials import counts, progress_lines, trial_table

WATCH_S = 2.0
FLAGS = {"--json": "json=true", "--watch": "watch=true", "--sync": "sync=true"}


def main() -> None:
    """Run the command."""
    run_command("status", for_each("status", validate_status, show), flags=FLAGS, read=status_overrides)


def status_overrides(words: list[str]) -> list[str]:
    """Write `experiment=NAME`, here what was run, as `experiment_name=NAME`: in our tree it is a group."""
    return [f"experiment_name={word[11:]}" if word.startswith("experiment=") else word for word in words]


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
    """Check a composed config and return it typed.

    Raises:
        ConfigError: with a sentence for each thing that is wrong.
    """
    request = parse(StatusRequest, config)
    if request.watch and request.as_json:
        raise ConfigError("watch=true shows tables; ask for json=true again and again instead")
    return request


def show(config: DictConfig) -> None:
    """Print how far the runs are, again and again with `watch`.

    Raises:
        RunNotFoundError: there are none.
        UnsyncedError: with `sync`, a store still fails.
    """
    request = validate_status(config)
    if request.sync:
        _sync(request)
    states = _look(request)
    out = console()
    if request.as_json:
        say(*json.dumps(as_plain(states) | {"searches": _searches_plain(request)}, indent=2).split("\n"))
    elif request.watch and out.is_terminal:
        with Live(_picture(request, states), console=out, auto_refresh=False) as live:
            while True:
                time.sleep(WATCH_S)
                live.update(_picture(request, _look(request)), refresh=True)
    else:
        out.print(_picture(request, states))
        while request.watch:
            time.sleep(WATCH_S)
            out.print(_picture(request, _look(request)))


def _look(request: StatusRequest) -> list[RunState]:
    found = labelled([read_state(path) for path in find_runs(request.output_path, request.experiment_name)])
    if not found:
        if request.experiment_name is None:
            raise RunNotFoundError(f"there are no runs in {request.output_path}; train one first, or set output_dir")
        there = {path.parents[1].name for path in find_runs(request.output_path)}
        hint = suggestion(request.experiment_name, there)
        raise RunNotFoundError(f"experiment={request.experiment_name}: it has no runs in {request.output_path}{hint}")
    return found


def _sync(request: StatusRequest) -> None:
    """Send what stores have not got.

    Raises:
        UnsyncedError: one of them still fails.
    """
    directories = [RunDirectory(path) for path in find_runs(request.output_path, request.experiment_name)]
    uris = [default_uri(request.output_path), *filter(None, [request.tracking.uri])]
    problems: dict[str, list[RunDirectory]] = {}
    for directory, problem in sync_all(directories, uris):
        if problem is None:
            say(f"{directory.path}: the store has everything", stderr=True)
        else:
            problems.setdefault(problem, []).append(directory)
    for problem, runs in problems.items():
        others = f" and {len(runs) - 1} more" if len(runs) > 1 else ""
        say(f"{runs[0].path}{others}: {problem}", stderr=True)
    if problems:
        failed = sum(map(len, problems.values()))
        raise UnsyncedError(f"the store has not got all of {plural(failed, 'run')}; sync=true tries again")


def _picture(request: StatusRequest, states: list[RunState]) -> RenderableType:
    lines = (running_lines, stopped_lines, failure_lines, damaged_lines)
    parts: list[RenderableType] = [cell_table(states), *(line for some in lines for line in some(states))]
    return Group(*parts, *(part for name, found in _searches(request) for part in _search_picture(name, found)))


def _searches(request: StatusRequest) -> Iterator[tuple[str, StoredSearch | ParkingError]]:
    """Yield the name of each experiment that is a search, and the search, or why it can't be read."""
    for file in sorted(request.output_path.glob(f"{request.experiment_name or '*'}/{SEARCH_FILE}")):
        try:
            if (found := study_in(file.parent, request.storage)) is not None:
                yield file.parent.name, found
        except ParkingError as error:
            yield file.parent.name, error


def _search_picture(name: str, found: StoredSearch | ParkingError) -> Iterator[RenderableType]:
    """Yield the trials of a search, the best first, and how far it is."""
    if isinstance(found, ParkingError):
        yield f"search {name}: {found}"
        return
    yield ""
    yield f"search {name}"
    yield trial_table(found.trials, found.search.objective)
    yield from progress_lines(found.trials, found.search.objective, found.n_trials)


def _searches_plain(request: StatusRequest) -> list[dict[str, Any]]:
    """Return the searches and their trials as JSON can hold them."""
    plain = list[dict[str, Any]]()
    for name, found in _searches(request):
        about: dict[str, Any] = {"experiment": name}
        if isinstance(found, ParkingError):
            about["error"] = str(found)
        else:
            about |= {"n_trials": found.n_trials, "objectives": found.search.objective}
            about |= dict(counts(found.trials).items())
            about["trials"] = [asdict(trial) for trial in found.trials]
        plain.append(about)
    return plain
