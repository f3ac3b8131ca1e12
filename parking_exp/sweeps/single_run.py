"""Train a single run in this process, which also writes its store."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from omegaconf import DictConfig

from parking_exp.algorithms.torch_settings import check_device
from parking_exp.config.cell_labels import label_cells
from parking_exp.config.schema import RunConfig
from parking_exp.config.settings import flatten_config
from parking_exp.config.validate import validate
from parking_exp.evaluation.init_sources import pin_source
from parking_exp.runs.directory import RunDirectory, RunResult
from parking_exp.runs.run_plans import make_pending
from parking_exp.terminal import say, unfailing_output
from parking_exp.tracking.store_writer import StoreWriter
from parking_exp.tracking.sync import adopt_store
from parking_exp.tracking.ui_addresses import ui_command
from parking_exp.training.signals import stop_on_signal
from parking_exp.training.train_run import train_run
from parking_exp.training.warm_start import check_sources


def train(config: DictConfig | Mapping[str, Any] | RunConfig) -> RunResult:
    """Train, evaluate and track one run, or resume it from its latest whole checkpoint.

    A run that is done returns its stored result.

    Raises:
        ConfigError, ModelError: the config cannot run; nothing is on disk.
        RunNotFoundError: there is no run that `init` names.
        OutputDirectoryError: the run directory can't be written.
        RunLockedError: another process is working on the same run.
        InterruptedRunError: SIGINT or SIGTERM; the state is saved.
        FailedRunError: anything else; the run is marked failed, its traceback kept.
    """
    with unfailing_output():
        return _train_or_keep(pin_source(validate(config)))


def _train_or_keep(config: RunConfig) -> RunResult:
    """Train a checked run, or keep its result; return the result."""
    directory = RunDirectory(config.run_dir)
    writer = StoreWriter([config], partial(say, stderr=True))
    has_result = directory.read_result() is not None
    if not has_result or directory.needs_evaluation(config):
        check_device(config.device)
    if not has_result:
        check_sources([config])
    try:
        with directory.supervisor_lock(), directory.training_lock():
            reason = _reason_to_keep(directory, config)
            if reason is None:
                _begin(directory, config)
                with stop_on_signal() as stop:
                    lines = train_run(config, directory, stop, writer.sync)
    finally:
        if writer.has_failed:
            writer.complete_stores([directory])
    if reason is not None:
        lines = [reason]
        adopt_store(directory, config)
        writer.complete_stores([directory])
    result = directory.read_result()
    assert result is not None
    say(*lines, *_closing_lines(result, directory))
    return result


def _reason_to_keep(directory: RunDirectory, config: RunConfig) -> str | None:
    """Return why the result of a run is kept; None if there is none, or it is evaluated again."""
    if directory.read_result() is None:
        return None
    if not directory.needs_evaluation(config):
        return "already done; to train it again, change the seed or delete its directory"
    problem = directory.evaluation_problem()
    return None if problem is None else f"already done; {problem}"


def _begin(directory: RunDirectory, config: RunConfig) -> None:
    """Plan a run as a sweep would, and record that this process begins it."""
    if directory.read_result() is not None:
        say("already trained; its final model is evaluated again, with other settings")
    (own_label,) = label_cells([flatten_config(config.plain())], [config.cell_name])
    planned_label = directory.read_status().label  # in a sweep
    make_pending(directory, config, config.label or planned_label or own_label)
    directory.reserve()
    directory.begin()


def _closing_lines(result: RunResult, directory: RunDirectory) -> list[str]:
    """Return lines about a finished run: its success, and where it is."""
    lines = []
    rate = result.metrics.get("final/success_rate")
    if rate is not None:
        lines.append(f"final success rate {rate:.1%}, after {result.steps} env steps")
    lines.append(f"run directory  {result.run_dir}")
    uri = directory.tracking_uri or ""
    if result.run_id:
        lines.append(f"MLflow run     {result.run_id}   ({ui_command(uri)})")
    return lines
