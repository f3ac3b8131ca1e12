"""Train one run, from its config to its result."""

import resource
import shlex
import signal
import sys
import traceback
from collections.abc import Mapping
from contextlib import closing, nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig

from parking_exp.algorithms.build_model import torch_settings
from parking_exp.config.paths import default_uri
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import validate
from parking_exp.errors import ConfigError, FailedRunError, InterruptedRunError
from parking_exp.evaluation.evaluate_policy import describe
from parking_exp.runs.atomic_files import write_atomically
from parking_exp.runs.directory import TRACEBACK_FILE, RunDirectory, RunResult
from parking_exp.runs.metric_logs import restore_logs
from parking_exp.runs.run_provenance import command_line, record_provenance
from parking_exp.runs.trained_here import record_training
from parking_exp.terminal import is_script, say, unfailing_output
from parking_exp.tracking.mirror import follow_store
from parking_exp.tracking.run_mirror import RunMirror
from parking_exp.training import checkpoints
from parking_exp.training.finish import finish
from parking_exp.training.loop import TrainingLoop
from parking_exp.training.signals import StopRequest, stop_on_signal
from parking_exp.training.trackers import RunTrackers


def train(
    config: DictConfig | Mapping[str, Any] | RunConfig, *, supervised: bool = False
) -> RunResult:
    """Train, evaluate and track one run, or resume it from its latest whole checkpoint.

    A run that is done returns its stored result. `supervised`: the parent process holds the run's
    supervisor lock.

    Raises:
        ConfigError: the config cannot run; nothing is on disk.
        OutputDirectoryError: the run directory can't be written.
        RunLockedError: another process is working on the same run.
        InterruptedRunError: SIGINT or SIGTERM; the state is saved.
        FailedRunError: anything else; the run is marked failed, its traceback kept.
    """
    with unfailing_output():
        return _train_or_resume(validate(config), supervised)


def _train_or_resume(config: RunConfig, supervised: bool) -> RunResult:
    directory = RunDirectory(config.run_dir)
    is_finished = directory.result() is not None and not directory.needs_evaluation(config)
    if not is_finished:
        _check_device(config.device)
    with nullcontext() if supervised else directory.supervisor_lock(), directory.training_lock():
        result = directory.result()
        if result is not None:
            reason = _reason_to_keep(directory, config)
            if reason is not None:
                return _keep(result, reason, directory, config)
            say("already trained; its final model is evaluated again, with other settings")
            directory.reopen()
        if not supervised:  # else the sweep has done both
            directory.create(config)
            _record_start(config, directory)
        record_training(directory.path, config)
        # Slurm signals every process of a job, and the supervisor passes its own signal on: the
        # checkpoint comes first.
        at_second = None if supervised else signal.default_int_handler
        with stop_on_signal(at_second) as stop, torch_settings(config):
            return _train(config, directory, stop, supervised)


def _check_device(device: str) -> None:
    """Raise ConfigError for an NVIDIA GPU that torch does not find."""
    if device.startswith("cuda"):
        number = int(device[5:] or 0)
        if number >= torch.cuda.device_count():
            raise ConfigError(f"device={device}: torch finds no such device; use auto")


def _reason_to_keep(directory: RunDirectory, config: RunConfig) -> str | None:
    """Return why the result of a finished run is kept; None if the run is to be evaluated again."""
    if not directory.needs_evaluation(config):
        return "already done; to train it again, change the seed or delete its directory"
    problem = directory.evaluation_problem()
    return None if problem is None else f"already done; {problem}"


def _keep(result: RunResult, reason: str, directory: RunDirectory, config: RunConfig) -> RunResult:
    """Say why a result is kept, and return it; the store that the config names gets it, too."""
    mirror = RunMirror(config.store_uri, directory, partial(say, stderr=True))
    if follow_store(directory, config):
        mirror.send()
        result = directory.result() or result  # which has its run id now
    say(reason, *_closing_lines(result, mirror))
    return result


def _train(
    config: RunConfig, directory: RunDirectory, stop: StopRequest, supervised: bool
) -> RunResult:
    """Train a run whose locks are held, and record how that ends."""
    # The process that the user started writes the store: of a supervised run, the sweep.
    writes_store = config.tracking.mlflow and not supervised
    store_uri = config.store_uri if writes_store else None
    mirror = RunMirror(store_uri, directory, partial(say, stderr=True))
    trackers = RunTrackers(config, partial(say, stderr=True))
    try:
        description = _train_and_evaluate(config, directory, stop, mirror, trackers)
    except (InterruptedRunError, KeyboardInterrupt):
        directory.update(status="interrupted")
        mirror.send()
        raise
    except BaseException as error:
        _record_failure(error, directory, mirror)
        raise FailedRunError(
            f"the run failed: {type(error).__name__}: {error}; its traceback is in "
            f"{directory.path / TRACEBACK_FILE}"
        ) from error
    finally:
        trackers.finish(directory.status)
    mirror.send()
    result = directory.result()
    assert result is not None
    say(*description, *_closing_lines(result, mirror))
    return result


def _record_start(config: RunConfig, directory: RunDirectory) -> None:
    """Write into status.json that this process trains the run, and what a sweep would plan."""
    directory.begin()
    directory.update(
        total_timesteps=config.total_timesteps,
        tracking_uri=config.store_uri if config.tracking.mlflow else None,
    )
    command = command_line()
    if command is not None:
        directory.update(command=command)
    if config.label is not None:
        directory.update(label=config.label)


def _train_and_evaluate(
    config: RunConfig,
    directory: RunDirectory,
    stop: StopRequest,
    mirror: RunMirror,
    trackers: RunTrackers,
) -> list[str]:
    """Train from the last checkpoint to the end, write the result, and describe the episodes."""
    checkpoint = checkpoints.latest(directory.checkpoints)
    restore_logs(directory.path, checkpoint)
    record_provenance(directory.path)
    mirror.send()
    loop = TrainingLoop(config, directory, mirror.send_checkpoint, trackers, checkpoint, stop)
    with closing(loop):
        try:
            loop.learn()
            with loop.average.applied():
                episodes = finish(loop)
        except InterruptedRunError:
            loop.save_checkpoint()
            raise
        steps = loop.model.num_timesteps
        metrics = loop.metrics.latest()
        description = describe(episodes, loop.task.metrics)

    directory.finish(
        RunResult(str(directory.path), directory.run_id, steps, metrics),
        success_rate=metrics.get("final/success_rate"),
        wall_s=metrics.get("time/wall_s"),
        cpu_s=metrics.get("time/cpu_s"),
        memory_bytes=_peak_memory_bytes(),
        evaluation=config.final_settings,
    )
    return description


def _peak_memory_bytes() -> int:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _record_failure(error: BaseException, directory: RunDirectory, mirror: RunMirror) -> None:
    """Record status and traceback, as far as a full disk allows."""
    try:
        directory.update(status="failed", error=f"{type(error).__name__}: {error}")
        text = "".join(traceback.format_exception(error))
        write_atomically(directory.path / TRACEBACK_FILE, text)
        mirror.send()
    except Exception as second_error:  # the first is reported
        error.add_note(
            f"while recording the failure: {type(second_error).__name__}: {second_error}"
        )


def _closing_lines(result: RunResult, mirror: RunMirror) -> list[str]:
    """Return lines about a finished run: its success, and where it is."""
    lines = []
    rate = result.metrics.get("final/success_rate")
    if rate is not None:
        lines.append(f"final success rate {rate:.1%}, after {result.steps} env steps")
    lines.append(f"run directory  {result.run_dir}")
    if result.run_id:
        ui = ui_command(mirror.directory.tracking_uri or "")
        lines.append(f"MLflow run     {result.run_id}   ({ui})")
    if mirror.problem:
        lines.append(f"not all of it is in the store ({mirror.problem}); {mirror.hint}")
    return lines


def ui_command(uri: str) -> str:
    """Return the command that shows a store in MLflow's UI; a tracking server is its own."""
    if not uri.startswith("sqlite"):
        return uri
    if not is_script():
        return f"mlflow ui --workers 1 --backend-store-uri {shlex.quote(uri)}"
    if uri == default_uri(Path("outputs").absolute()):
        return "make ui"
    return f"make ui STORE={shlex.quote(uri)}"
