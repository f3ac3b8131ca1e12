"""Sessions of runs, trained or not: evaluations of a policy, their log, the shown progress."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from parking_exp.config.schema import RunConfig
from parking_exp.errors import DivergenceError
from parking_exp.evaluation.evaluate_policy import evaluate_policy, summarise
from parking_exp.evaluation.path_recorder import PathRecorder
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.metric_logs import EPISODES_FILE, METRICS_FILE, MetricsLog, append_episodes
from parking_exp.runs.run_state import read_state
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.task import Policy
from parking_exp.training.checkpoints import SavedProgress
from parking_exp.training.loggers import make_logger
from parking_exp.training.progress_display import ProgressDisplay
from parking_exp.training.signals import StopRequest
from parking_exp.training.trackers import RunTrackers

OnSaved = Callable[[RunDirectory], None]
"""A function that gets the directory of a run whenever something final was saved in it."""


@dataclass(frozen=True)
class RunContext:
    """The config, the directory and the services of a run, from which its session is made.

    Attributes:
        config: the run's config.
        directory: the run's directory, whose locks are held.
        stop: asks the run to stop.
        on_saved: called after each checkpoint.
        trackers: the trackers that get each row of metrics.
        resources: closes the task, its envs, the logs and the progress bar.
    """

    config: RunConfig
    directory: RunDirectory
    stop: StopRequest
    on_saved: OnSaved
    trackers: RunTrackers
    resources: ExitStack


class RunSession(ABC):
    """A run in one process, from its start or from a checkpoint.

    Args:
        context: what it works with.
        progress: the progress so far.
    """

    policy: Policy

    def __init__(self, context: RunContext, progress: SavedProgress) -> None:
        config = context.config
        directory = context.directory
        resources = context.resources
        self.config = config
        self.directory = directory
        self.progress = progress
        self.stop = context.stop
        self._cpu_start = time.process_time() - progress.cpu_s
        self._wall_start = time.monotonic() - progress.wall_s

        path = directory.path
        directory.models.mkdir(exist_ok=True)
        self.task = make_task(config.env)
        resources.callback(self.task.close)
        self.metrics_log = MetricsLog(path / METRICS_FILE)
        label = read_state(path).label
        log_row = context.trackers.log
        self.logger = make_logger(config.tracking, path, self.metrics_log, label, log_row)
        resources.callback(self.logger.close)
        self.display = ProgressDisplay(
            config.total_timesteps,
            progress.step,
            config.tracking.progress_bar,
            heartbeat=directory.heartbeat,
        )
        resources.callback(self.display.close)
        self.display.say(
            f"{config.cell_name}, seed {config.seed}: {config.total_timesteps} env steps, in {path}"
        )
        for note in self.task.notes():
            self.display.say(note)

    @property
    @abstractmethod
    def step(self) -> int:
        """Env steps trained so far."""

    @abstractmethod
    def learn(self) -> None:
        """Train up to `total_timesteps`."""

    @abstractmethod
    def save_final(self, path: Path) -> None:
        """Write the file of the final policy."""

    def evaluated_policy(self) -> AbstractContextManager[None]:
        """Make `policy` the one that is evaluated and saved, within a block."""
        return nullcontext()

    @abstractmethod
    def save_checkpoint(self) -> None:
        """Save the whole state, from which the run can be resumed."""

    def run_episodes(
        self,
        seeds: Sequence[int],
        simulator: str | None = None,
        path_recorder: PathRecorder | None = None,
    ) -> pd.DataFrame:
        """Return the policy's episodes, or raise when a signal asks to stop."""
        try:
            on_progress = self.progress_callback(len(seeds))
            return evaluate_policy(
                self.policy, self.task, seeds, on_progress, simulator, path_recorder
            )
        except DivergenceError as error:
            raise DivergenceError(f"evaluation at step {self.step}: {error}") from error

    def progress_callback(self, n_episodes: int) -> Callable[[int], None]:
        """Return a function that shows how many episodes are done, and raises on a stop signal."""

        def on_progress(n_finished: int) -> None:
            self.stop_if_asked()
            self.display.show_episodes(n_finished, n_episodes)

        return on_progress

    def stop_if_asked(self) -> None:
        """Raise InterruptedRunError if a signal has asked to stop."""
        self.stop.raise_if_made(f" at step {self.step}")

    def times(self) -> tuple[float, float]:
        """Return CPU and wall seconds of the run, earlier processes included."""
        return time.process_time() - self._cpu_start, time.monotonic() - self._wall_start

    def record_evaluation(self, episodes: pd.DataFrame, phase: str) -> dict[str, float]:
        """Append episodes to `episodes.csv`, log their summary and return it.

        The phase is `eval`, `final` or `certified`.
        """
        append_episodes(self.directory.path / EPISODES_FILE, episodes, phase, self.step)
        summary = summarise(episodes, self.task.metrics)
        for name, value in summary.items():
            self.logger.record(f"{phase}/{name}", value)
        return summary

    def dump_metrics(self) -> None:
        """Write the logger's row of metrics."""
        cpu_s, wall_s = self.times()
        self.logger.record("time/cpu_s", cpu_s)
        self.logger.record("time/wall_s", wall_s)
        self.logger.dump(self.step)
