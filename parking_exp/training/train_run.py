"""Train one run, from its config to its result."""

import os
import resource
import shlex
import signal
import socket
import sys
import time
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
from parking_exp.runs.directory import RunDirectory, RunResult
from parking_exp.runs.metric_logs import restore_logs
from parking_exp.runs.run_provenance import command_line, record_provenance
from parking_exp.runs.trained_here import record_training
from parking_exp.tasks.registry import make_task
from parking_exp.terminal import is_script, say, unfailing_output
from parking_exp.tracking.mirror import follow_store
from parking_exp.tracking.tracker import Tracker
from parking_exp.training import checkpoints
from parking_exp.training.finish import finish
from parking_exp.training.loop import TrainingLoop
from parking_exp.training.signals import StopRequest, stop_on_signal


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
    lacks_device = (
        config.device.startswith("cuda")
        and int(config.device[5:] or 0) >= torch.cuda.device_count()
    )
    if lacks_device and (directory.result() is None or directory.needs_evaluation(config)):
        raise ConfigError(f"device={config.device}: torch finds no such device; use auto")
    with nullcontext() if supervised else directory.supervisor_lock(), directory.training_lock():
        if (result := directory.result()) is not None:
            if (reason := _reason_to_keep(directory, config)) is not None:
                tracker = Tracker(config.store_uri, directory, partial(say, stderr=True))
                if follow_store(directory, config):
                    tracker.mirror()
                    result = directory.result() or result
                say(reason, *_closing_lines(result, tracker))
                return result
            say("already trained; its final model is evaluated again, with other settings")
            directory.reopen()
        directory.create(config)
        record_training(directory.path, config)
        # Slurm signals every process of a job, and the supervisor passes its own signal on: the
        # checkpoint comes first.
        at_second = None if supervised else signal.default_int_handler
        with stop_on_signal(at_second) as stop, torch_settings(config):
            return _train(config, directory, stop, supervised)


def _reason_to_keep(directory: RunDirectory, config: RunConfig) -> str | None:
    """Return why the result of a finished run is kept; None if the run is to be evaluated again."""
    if not directory.needs_evaluation(config):
        return "already done; to train it again, change the seed or delete its directory"
    if problem := directory.evaluation_problem():
        return f"already done; {problem}"
    return None


def _train(
    config: RunConfig, directory: RunDirectory, stop: StopRequest, supervised: bool
) -> RunResult:
    (directory.path / "traceback.txt").unlink(missing_ok=True)
    process: dict[str, Any] = {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "started": time.time(),
    }
    if words := command_line():  # a supervised run has the sweep's
        process["command"] = words
    if config.label is not None:
        process["label"] = config.label
    directory.update(
        status="running", error=None, killed=None, total_timesteps=config.total_timesteps, **process
    )
    store_uri = config.store_uri if config.tracking.mlflow else None
    directory.update(tracking_uri=store_uri)
    # The process that the user started writes the store: of a supervised run, the sweep.
    tracker = Tracker(None if supervised else store_uri, directory, partial(say, stderr=True))
    try:
        checkpoint = checkpoints.latest(directory.checkpoints)
        restore_logs(directory.path, checkpoint)
        record_provenance(directory.path)
        tracker.mirror()
        with closing(TrainingLoop(config, directory, tracker.sync, checkpoint, stop)) as loop:
            try:
                loop.learn()
                with loop.average.applied():
                    episodes = finish(loop)
            except InterruptedRunError:
                loop.save_checkpoint()
                raise
        metrics = loop.metrics.latest()
        memory_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (
            1 if sys.platform == "darwin" else 1024
        )
        directory.finish(
            RunResult(str(directory.path), directory.run_id, loop.model.num_timesteps, metrics),
            success_rate=metrics.get("final/success_rate"),
            wall_s=metrics.get("time/wall_s"),
            cpu_s=metrics.get("time/cpu_s"),
            memory_bytes=memory_bytes,
            evaluation=config.final_settings,
        )
    except (InterruptedRunError, KeyboardInterrupt):
        directory.update(status="interrupted")
        tracker.mirror()
        raise
    except BaseException as error:
        _record_failure(error, directory, tracker)
        raise FailedRunError(
            f"the run failed: {type(error).__name__}: {error}; its traceback is in "
            f"{directory.path / 'traceback.txt'}"
        ) from error
    tracker.mirror()
    result = directory.result()
    assert result is not None
    say(
        *describe(episodes, make_task(config.env).metrics).split("\n"),
        *_closing_lines(result, tracker),
    )
    return result


def _record_failure(error: BaseException, directory: RunDirectory, tracker: Tracker) -> None:
    """Record status and traceback, as far as a full disk allows."""
    try:
        directory.update(status="failed", error=f"{type(error).__name__}: {error}")
        write_atomically(
            directory.path / "traceback.txt", "".join(traceback.format_exception(error))
        )
        tracker.mirror()
    except Exception as second_error:  # the first is reported
        error.add_note(
            f"while recording the failure: {type(second_error).__name__}: {second_error}"
        )


def _closing_lines(result: RunResult, tracker: Tracker) -> list[str]:
    rate = result.metrics.get("final/success_rate")
    lines = (
        [f"final success rate {rate:.1%}, after {result.steps} env steps"]
        if rate is not None
        else []
    )
    lines.append(f"run directory  {result.run_dir}")
    if result.run_id:
        lines.append(
            f"MLflow run     {result.run_id}   ({ui_command(tracker.directory.tracking_uri or '')})"
        )
    if tracker.problem:
        lines.append(f"not all of it is in the store ({tracker.problem}); {tracker.hint}")
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
