"""A run under way: its model, envs and logs, and what happens between two of its steps."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from stable_baselines3.common.callbacks import BaseCallback

from parking_exp.algorithms.build import build_model, greedy_policy
from parking_exp.algorithms.weights import save_model
from parking_exp.buffers import HerBuffer
from parking_exp.config.schema import RunConfig, Simulation
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.errors import CertificationError, InterruptedRunError
from parking_exp.evaluation.evaluate import differences, evaluate, rank, summarise
from parking_exp.evaluation.summary import success_line
from parking_exp.evaluation.trajectories import TRAJECTORIES_FILE, Recorder
from parking_exp.evaluation.video import record
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.logs import MetricsLog, append_episodes
from parking_exp.tracking.tracker import Tracker
from parking_exp.training import checkpoints, rollout_state
from parking_exp.training.checkpoints import Progress
from parking_exp.training.figures import learning_curves
from parking_exp.training.loggers import make_logger
from parking_exp.training.progress import TrainingProgress
from parking_exp.training.seeding import derive_seeds
from parking_exp.training.signals import StopRequest

BAR_UPDATES_A_SECOND = 5


class Session:
    """One process's work on one run."""

    def __init__(
        self,
        *,
        config: RunConfig,
        directory: RunDirectory,
        tracker: Tracker,
        progress: Progress,
        checkpoint: Path | None,
        stop: StopRequest,
        bar: TrainingProgress,
    ) -> None:
        self.config, self.directory, self.tracker = config, directory, tracker
        self.progress, self.stop, self.bar = progress, stop, bar
        self._cpu_start = time.process_time() - progress.cpu_s
        self._wall_start = time.monotonic() - progress.wall_s
        path = directory.path
        directory.models.mkdir(exist_ok=True)
        self.metrics = MetricsLog(path / "metrics.jsonl")
        seeds = derive_seeds(config.seed)
        self.env = make_training_envs(config.env, config.n_envs, path / "monitor.csv", progress.wall_s)
        self.model = build_model(config, self.env, seeds.policy)
        self.policy = greedy_policy(self.model)
        self.env.seed(seeds.training_scenes)  # after the model, which seeds the envs with its own seed
        self._streams: dict[str, Any] | None = None
        if checkpoint is None:
            self._best.unlink(missing_ok=True)  # of steps that are going to be done again
        else:
            self._streams = checkpoints.restore(checkpoint, self.model, best=self._best)
            bar.say(f"resuming at step {progress.step}")
        self.model.set_logger(make_logger(config.tracking, path, self.metrics, progress.step))

    def learn(self) -> None:
        """Train up to `total_timesteps`, with evaluations and checkpoints on the way."""
        remaining = self.config.total_timesteps - self.model.num_timesteps
        if remaining > 0:
            interval = self.config.tracking.log_interval
            self.model.learn(remaining, Schedule(self), log_interval=interval, reset_num_timesteps=False)
        self.resume_streams()
        self.save_checkpoint()

    def finish(self) -> pd.DataFrame:
        """Evaluate the final model on all scenes, write everything down, and return the episodes on real highway-env.

        Raises:
            CertificationError: an episode went otherwise there than in the simulator; all tables are written.
        """
        path, evaluation = self.directory.path, self.config.evaluation
        self.bar.busy("final evaluation")
        recorder = Recorder()
        episodes = self._run_episodes(evaluation.final_n_scenes, recorder=recorder)
        recorder.save(path / TRAJECTORIES_FILE)
        summary = self._store_evaluation(episodes.head(evaluation.n_scenes), "eval")
        self.bar.say(success_line(summary, self.model.num_timesteps))
        self._store_evaluation(episodes, "final")
        certified = self._certify(episodes)
        self._dump()
        self.model.logger.close()
        save_model(self.model, self.directory.models / "final.zip")
        learning_curves(self.metrics.frame(), f"{self.config.experiment_name}: {path.parent.name}", path / "curves.png")
        if evaluation.video_episodes:
            self.bar.busy("video")
            record(self.policy, self.config.env, self._scenes(evaluation.video_episodes), path / "video.mp4")
        self.env.close()
        if found := differences(episodes, certified):
            raise CertificationError(
                f"{len(found)} of {len(episodes)} final episodes differ between env.simulator="
                f"{self.config.env.simulator} and highway-env; {'; '.join(found[:3])}"
            )
        return certified

    def evaluate(self) -> None:
        """Evaluate on the first of the fixed scenes, and keep the model if it is the best so far."""
        self.bar.busy("evaluation")
        episodes = self._run_episodes(self.config.evaluation.n_scenes)
        summary = self._store_evaluation(episodes, "eval")
        self._dump()
        self.bar.say(success_line(summary, self.model.num_timesteps))

    def resume_streams(self) -> None:
        """Go on with the streams of the checkpoint that the run was resumed from, once."""
        if self._streams is not None:
            rollout_state.restore(self.model, self._streams)
            self._streams = None

    def save_checkpoint(self) -> None:
        """Save the whole state, then send what is known so far to the store."""
        step = self.model.num_timesteps
        if step == self.progress.saved:
            return
        self.progress.step = self.progress.saved = step
        self.progress.cpu_s, self.progress.wall_s = self.times()
        checkpoints.save(
            self.directory.checkpoints, self.model, self.progress, self._best, self.config.checkpoint.keep_last
        )
        self.tracker.sync()

    def stop_if_asked(self) -> None:
        """Leave, with a checkpoint, if a signal has asked for it."""
        if self.stop.signal_number is not None:
            self.save_checkpoint()
            raise InterruptedRunError(
                f"stopped at step {self.model.num_timesteps}; type the same command to go on from there",
                self.stop.signal_number,
            )

    def times(self) -> tuple[float, float]:
        """Return CPU and wall seconds of the run, earlier processes included."""
        return time.process_time() - self._cpu_start, time.monotonic() - self._wall_start

    @property
    def _best(self) -> Path:
        return self.directory.models / "best.zip"

    def _scenes(self, number: int) -> range:
        first = self.config.evaluation.first_scene
        return range(first, first + number)

    def _run_episodes(
        self, number: int, simulator: Simulation | None = None, recorder: Recorder | None = None
    ) -> pd.DataFrame:
        def stop(_: int) -> None:
            self.stop_if_asked()

        return evaluate(self.policy, self.config.env, self._scenes(number), stop, simulator, recorder)

    def _certify(self, episodes: pd.DataFrame) -> pd.DataFrame:
        """Repeat the final evaluation on real highway-env, unless that is where it was made."""
        certified = episodes
        if self.config.env.simulator != "highway_env":
            self.bar.busy("certification on highway-env")
            certified = self._run_episodes(len(episodes), "highway_env")
        self._store_evaluation(certified, "certified")
        return certified

    def _store_evaluation(self, episodes: pd.DataFrame, phase: str) -> dict[str, float]:
        step, summary = self.model.num_timesteps, summarise(episodes)
        append_episodes(self.directory.path / "episodes.csv", episodes, phase, step)
        for name, value in summary.items():
            self.model.logger.record(f"{phase}/{name}", value)
        if phase == "eval":
            self.progress.evaluated = step
            if self.progress.best is None or list(rank(summary)) > self.progress.best:
                self.progress.best = list(rank(summary))
                save_model(self.model, self._best)
        return summary

    def _dump(self) -> None:
        cpu_s, wall_s = self.times()
        if isinstance(buffer := self.model.replay_buffer, HerBuffer) and buffer.real_share is not None:
            self.model.logger.record("buffer/real_share", buffer.real_share)
        self.model.logger.record("time/cpu_s", cpu_s)
        self.model.logger.record("time/wall_s", wall_s)
        self.model.logger.dump(self.model.num_timesteps)


class Schedule(BaseCallback):
    """Evaluates, saves and stops between rollouts, where Stable-Baselines3's state is whole.

    Inside a step the transition is counted already and not yet stored.
    """

    def __init__(self, session: Session) -> None:
        super().__init__()
        self.session = session
        self._next_update = 0.0

    def _on_rollout_start(self) -> None:
        session = self.session
        config, progress, step = session.config, session.progress, self.num_timesteps
        session.resume_streams()  # here, where they were saved
        session.stop_if_asked()
        if _due(step, progress.evaluated, config.evaluation.every_n_steps):
            session.evaluate()
        if _due(step, progress.saved, config.checkpoint.every_n_steps):
            session.save_checkpoint()
        if (now := time.monotonic()) >= self._next_update:
            self._next_update = now + 1 / BAR_UPDATES_A_SECOND
            session.bar.update(step, *self._recent())

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self.session.bar.update(self.num_timesteps, *self._recent())

    def _recent(self) -> tuple[float | None, float | None]:
        """Success rate and mean return of the last training episodes."""
        successes, episodes = self.model.ep_success_buffer, self.model.ep_info_buffer
        if not successes or not episodes:
            return None, None
        return float(np.mean(successes)), float(np.mean([episode["r"] for episode in episodes]))


def _due(step: int, last: int, every: int | None) -> bool:
    """Whether a multiple of `every` lies in (last, step]."""
    return every is not None and step // every > last // every
