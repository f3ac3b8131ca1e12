"""Train one run whose locks are held, and record in its directory how that ends."""

import traceback
from contextlib import ExitStack

from parking_exp.algorithms.torch_settings import torch_settings
from parking_exp.config.schema import RunConfig
from parking_exp.errors import FailedRunError, InterruptedRunError, class_and_message
from parking_exp.evaluation.evaluate_policy import describe_episodes
from parking_exp.runs.atomic_files import write_atomically
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import restore_logs
from parking_exp.runs.run_files import TRACEBACK_FILE
from parking_exp.runs.run_provenance import record_provenance
from parking_exp.runs.trained_here import record_training
from parking_exp.training import checkpoints
from parking_exp.training.final_evaluation import evaluate_final
from parking_exp.training.run_session import OnSaved, RunContext, RunSession
from parking_exp.training.scripted_session import ScriptedSession
from parking_exp.training.signals import StopRequest
from parking_exp.training.trackers import RunTrackers
from parking_exp.training.training_session import TrainingSession


def train_run(
    config: RunConfig, directory: RunDirectory, stop: StopRequest, on_saved: OnSaved
) -> list[str]:
    """Train a run from its latest whole checkpoint to its result, and describe its last episodes.

    Args:
        config: the run's config.
        directory: the run's directory, whose locks are held.
        stop: asks the run to save a checkpoint and stop.
        on_saved: called at the start, after each checkpoint, and when the run has ended.

    Raises:
        InterruptedRunError: it was asked to stop; the state is saved.
        FailedRunError: anything else; the run is marked failed, its traceback kept.
    """
    record_training(directory.path, config)
    trackers = RunTrackers(config)
    try:
        with torch_settings(config):
            return _train_and_evaluate(config, directory, stop, on_saved, trackers)
    except (InterruptedRunError, KeyboardInterrupt):
        directory.update_status(status="interrupted")
        raise
    except BaseException as error:
        _record_failure(error, directory)
        raise FailedRunError(
            f"the run failed: {class_and_message(error)}; its traceback is in "
            f"{directory.path / TRACEBACK_FILE}"
        ) from error
    finally:
        status = directory.status
        # A full disk may have kept a failure from being recorded.
        trackers.finish("failed" if status == "running" else status)
        on_saved(directory)


def _train_and_evaluate(
    config: RunConfig,
    directory: RunDirectory,
    stop: StopRequest,
    on_saved: OnSaved,
    trackers: RunTrackers,
) -> list[str]:
    """Train from the last checkpoint to the end, write the result, and describe the episodes."""
    checkpoint = checkpoints.latest(directory.checkpoints)
    restore_logs(directory.path, checkpoint)
    record_provenance(directory.path)
    on_saved(directory)
    with ExitStack() as resources:
        context = RunContext(config, directory, stop, on_saved, trackers, resources)
        session: RunSession
        if config.is_trained:
            session = TrainingSession(context, checkpoint)
        else:
            session = ScriptedSession(context)
        try:
            session.learn()
            with session.evaluated_policy():
                episodes = evaluate_final(session)
        except InterruptedRunError:
            session.save_checkpoint()
            raise

    metrics = session.metrics_log.latest()
    description = describe_episodes(episodes, session.task.metrics)
    directory.finish(
        session.step,
        metrics,
        success_rate=metrics.get("final/success_rate"),
        wall_s=metrics.get("time/wall_s"),
        cpu_s=metrics.get("time/cpu_s"),
        evaluation=config.final_settings,
    )
    return description


def _record_failure(error: BaseException, directory: RunDirectory) -> None:
    """Record status and traceback, as far as a full disk allows."""
    try:
        directory.update_status(status="failed", error=class_and_message(error))
        text = "".join(traceback.format_exception(error))
        write_atomically(directory.path / TRACEBACK_FILE, text)
    except Exception as second_error:  # the first is reported
        error.add_note(f"while recording the failure: {class_and_message(second_error)}")
