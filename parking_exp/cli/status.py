"""`scripts/status.py` and `parking-status`: show the progress of runs from their directories."""

import json
import time
from dataclasses import asdict
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import Field
from rich.console import Console

from parking_exp.cli.command import rename_experiment, run_command
from parking_exp.config.compose import compose_configs
from parking_exp.config.paths import default_uri, is_same_store
from parking_exp.config.schema import OutputConfig, StoreConfig
from parking_exp.config.validate import parse_config
from parking_exp.config_model import Name
from parking_exp.errors import ParkingError, RunNotFoundError, StoreError
from parking_exp.phrases import plural, suggestion
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.lookup import experiment_of, find_runs
from parking_exp.runs.run_plans import delete_planned_run
from parking_exp.runs.run_state import RunState, as_plain, in_plan_order, read_state
from parking_exp.runs.state_tables import cell_table, state_lines
from parking_exp.terminal import check_output, make_console, say
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import delete_stored, sync_missing
from parking_exp.tuning.search import SEARCH_FILE, StoredSearch, read_search
from parking_exp.tuning.trials import OBJECTIVE, count_states, progress_lines, progress_table

WATCH_S = 2.0
Searches = dict[str, StoredSearch | ParkingError]
"""The search of each experiment that has one, or the error of reading it."""


def main() -> None:
    """Run the command."""
    run_command("status", show_status, rename_experiment)


class StatusRequest(OutputConfig):
    """The config of scripts/status.py."""

    experiment_name: Name | None
    as_json: Annotated[bool, Field(alias="json")]
    watch: bool
    sync: bool
    prune: Literal["pending"] | None
    tracking: StoreConfig


def show_status(overrides: list[str], extra_config_dir: str | None) -> None:
    """Print the progress of runs for each config of the overrides."""
    configs = compose_configs("status", overrides, extra_config_dir)
    for request in [parse_config(StatusRequest, config) for config in configs]:
        _show_request(request)


def _show_request(request: StatusRequest) -> None:
    """Prune and sync as asked, then print the progress of runs, repeatedly with `watch`."""
    out = make_console()
    if request.prune:
        _prune(request)
    if request.sync:
        _sync(request)
    while True:
        states = _read_states(request)
        searches = _read_searches(request)
        if request.as_json:
            content = as_plain(states)
            content["searches"] = [
                _describe_search(name, search) for name, search in searches.items()
            ]
            say(*json.dumps(content, indent=2).split("\n"))
        else:
            if request.watch:
                out.clear()
            _print_tables(out, states, searches)
        check_output()
        if not request.watch:
            break
        time.sleep(WATCH_S)


def _read_states(request: StatusRequest) -> list[RunState]:
    """Return the runs of a request, or raise RunNotFoundError if it has none."""
    experiment = request.experiment_name
    folder = request.output_path
    states = in_plan_order(read_state(path) for path in find_runs(folder, experiment))
    if states or request.prune:  # which may have left none
        return states
    if experiment is None:
        raise RunNotFoundError(f"there are no runs in {folder}; train one first, or set output_dir")
    hint = suggestion(experiment, {experiment_of(path) for path in find_runs(folder)})
    raise RunNotFoundError(f"experiment={experiment}: it has no runs in {folder}{hint}")


def _prune(request: StatusRequest) -> None:
    """Delete the directories of runs that never began, and mark them as deleted in the stores."""
    stores = _stores(request)
    for path in find_runs(request.output_path, request.experiment_name):
        directory = RunDirectory(path)
        if delete_planned_run(directory, before=partial(_delete_stored, directory, stores)):
            say(f"dropped  {path}", stderr=True)


def _delete_stored(directory: RunDirectory, stores: list[Store]) -> None:
    """Mark a run as deleted in its store, if that is one of `stores`."""
    for store in stores:
        if directory.run_id is not None and store.tracks(directory):
            delete_stored(directory, store)


def _stores(request: StatusRequest) -> list[Store]:
    """Return the stores of a request; those that a run directory names may come from elsewhere."""
    folder = request.output_path
    stores = [Store(default_uri(folder), folder)]
    chosen = request.tracking.uri
    if chosen is not None and not is_same_store(chosen, stores[0].uri):
        stores.append(Store(chosen, folder))
    return stores


def _sync(request: StatusRequest) -> None:
    """Send to the stores whatever they lack."""
    paths = find_runs(request.output_path, request.experiment_name)
    directories = [RunDirectory(path) for path in paths]
    stores = _stores(request)
    others = set()
    for directory in directories:
        if not any(store.tracks(directory) for store in stores):
            others.add(directory.tracking_uri)
    for uri in others - {None}:
        say(
            f"left out: runs that are tracked in {uri}; pass tracking.uri={uri} to send them",
            stderr=True,
        )
    n_failed = 0
    for store in stores:
        for directory, problem in sync_missing(directories, store):
            say(f"{directory.path}: {problem or 'the store has everything'}", stderr=True)
            n_failed += problem is not None
    if n_failed:
        raise StoreError(
            f"files and store differ for {plural(n_failed, 'run')}; the lines above say why"
        )


def _print_tables(out: Console, states: list[RunState], searches: Searches) -> None:
    out.print(cell_table(states))
    for line in state_lines(states, "running", "stopped", "failed", "damaged"):
        out.print(line)
    for name, search in searches.items():
        if isinstance(search, ParkingError):
            out.print(f"search {name}: {search}")
        else:
            out.print("", f"search {name}", progress_table(search.trials), sep="\n")
            out.print(*progress_lines(search.trials, search.n_trials), sep="\n")


def _read_searches(request: StatusRequest) -> Searches:
    """Return the searches of a request."""
    searches: Searches = {}
    for file in sorted(request.output_path.glob(f"{request.experiment_name or '*'}/{SEARCH_FILE}")):
        try:
            search = read_search(file.parent)
            if search is not None:
                searches[file.parent.name] = search
        except ParkingError as error:
            searches[file.parent.name] = error
    return searches


def _describe_search(name: str, search: StoredSearch | ParkingError) -> dict[str, Any]:
    """Return a search and its trials for JSON."""
    if isinstance(search, ParkingError):
        return {"experiment": name, "error": str(search)}
    return {
        "experiment": name,
        "n_trials": search.n_trials,
        "objective": OBJECTIVE,
        **count_states(search.trials),
        "trials": [asdict(trial) for trial in search.trials],
    }
