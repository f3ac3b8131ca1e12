"""The session of a run that is trained: its model and envs, with evaluations and checkpoints."""

import time
from contextlib import AbstractContextManager
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from hydra.utils import instantiate
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import safe_mean

from parking_exp.algorithms.build_model import GreedyPolicy, build_model
from parking_exp.algorithms.normalization import UpdateNormalizer
from parking_exp.algorithms.policy_ema import PolicyEMA
from parking_exp.buffers import HerBuffer
from parking_exp.evaluation.evaluate_policy import describe_rates, rank_evaluation
from parking_exp.runs.foreign_files import sha256
from parking_exp.runs.metric_logs import MONITOR_FILE
from parking_exp.runs.run_files import BEST_MODEL
from parking_exp.tasks.finite import check_finite
from parking_exp.tasks.training_envs import make_training_envs
from parking_exp.training import checkpoints, demonstrations, rollout_state, warm_start
from parking_exp.training.checkpoints import SavedProgress, save_model
from parking_exp.training.run_session import RunContext, RunSession
from parking_exp.training.seeds import derive_seeds

BAR_UPDATES_PER_S = 5


class TrainingSession(RunSession):
    """The training of one run in one process, from its start or from a checkpoint.

    Args:
        context: what it works with.
        checkpoint: the checkpoint from which the run is resumed, if any.
    """

    def __init__(self, context: RunContext, checkpoint: Path | None) -> None:
        saved = checkpoints.load_state(checkpoint)["progress"] if checkpoint else {}
        progress = SavedProgress(**saved)
        super().__init__(context, progress)
        config = self.config
        directory = self.directory
        self._on_saved = context.on_saved
        self._best = directory.models / BEST_MODEL

        seeds = derive_seeds(config.seed, config.env.training_seeds)
        self.env = make_training_envs(
            self.task, config.n_envs, directory.path / MONITOR_FILE, progress.wall_s
        )
        context.resources.callback(self.env.close)
        self.model = build_model(config, self.task, self.env, seeds.policy)
        if config.buffer.demonstrations:
            demonstrations.attach_demonstration_buffer(config, self.task, self.model)
        self.model.set_logger(self.logger)
        self.policy = GreedyPolicy(self.model)
        self.policy_ema = PolicyEMA(self.model, config.algorithm.policy_ema_half_life)
        # After the model, which seeds the envs with its own seed.
        self.env.seed(seeds.training_envs)

        self._rollout_state: dict[str, Any] | None = None
        if checkpoint is None:
            # An attempt that was killed before its first checkpoint may have left one.
            self._best.unlink(missing_ok=True)
            if config.init is not None:
                source = warm_start.load_source(config, self.model)
                directory.update_status(init_sha256=sha256(source.weights))
                self.display.say(f"starting from {source.weights}")
            if config.buffer.demonstrations:
                self._add_demonstrations()
        else:
            self._rollout_state = checkpoints.restore(
                checkpoint, self.model, self.policy_ema, self._best
            )
            self.display.say(f"resuming at step {progress.step}")

    def _add_demonstrations(self) -> None:
        """Fill the demonstration buffer, and count the CPU time of recording it.

        It counts even if another run has recorded them.
        """
        self.display.show_activity("demonstrations")
        before_s = time.process_time()
        n_episodes = self.config.buffer.demonstrations
        stats = demonstrations.add_demonstrations(
            self.config, self.task, self.model, self.progress_callback(n_episodes)
        )
        self._cpu_start += time.process_time() - before_s - stats.cpu_s
        self.display.say(f"demonstrations: {stats.n_successes} of {n_episodes} reach the goal")

    @property
    def step(self) -> int:
        """Env steps trained so far."""
        return self.model.num_timesteps

    def learn(self) -> None:
        """Train up to `total_timesteps`, with evaluations and checkpoints on the way."""
        remaining = self.config.total_timesteps - self.step
        if remaining > 0:
            interval = self.config.tracking.log_interval
            user_callbacks: list[BaseCallback] = [
                instantiate(node, _convert_="all") for node in self.config.callbacks or ()
            ]
            callbacks = [RolloutCallback(self), UpdateNormalizer(), *user_callbacks]
            self.model.learn(remaining, callbacks, log_interval=interval, reset_num_timesteps=False)
        self.restore_rollout_state()
        self.save_checkpoint()

    def evaluate(self) -> None:
        """Evaluate the model on the first of the fixed episodes."""
        self.display.show_activity("evaluation")
        settings = self.config.evaluation
        with self.evaluated_policy():
            episodes = self.run_episodes(settings.seeds(settings.n_scenes))
            summary = self.record_evaluation(episodes, "eval")
        self.dump_metrics()
        self.display.say(describe_rates(summary, self.step, self.task.metrics))

    def restore_rollout_state(self) -> None:
        """Set the rollout state of the checkpoint that the run was resumed from, once."""
        if self._rollout_state is not None:
            rollout_state.set_state(self.model, self._rollout_state)
            self._rollout_state = None

    def save_checkpoint(self) -> None:
        """Save the whole state, unless this step is saved already."""
        step = self.step
        if step == self.progress.step:
            return
        self.progress.step = step
        self.progress.cpu_s, self.progress.wall_s = self.times()
        checkpoints.save(
            self.directory.checkpoints,
            self.model,
            self.policy_ema,
            self.progress,
            self._best,
            self.config.checkpoint.keep_last,
        )
        self._on_saved(self.directory)

    def record_evaluation(self, episodes: pd.DataFrame, phase: str) -> dict[str, float]:
        """Record episodes; in the phase `eval`, also keep the model if it is the best so far."""
        summary = super().record_evaluation(episodes, phase)
        if phase == "eval":
            self.progress.evaluated = self.step
            self._keep_if_best(rank_evaluation(summary, self.task))
        return summary

    def _keep_if_best(self, new_rank: list[float]) -> None:
        """Save the model as the best one if its rank exceeds the best so far."""
        if self.progress.best is None or new_rank > self.progress.best:
            self.progress.best = new_rank
            save_model(self.model, self._best)

    def dump_metrics(self) -> None:
        """Write the logger's row of metrics."""
        buffer = self.model.replay_buffer
        if isinstance(buffer, HerBuffer) and buffer.real_share is not None:
            self.logger.record("buffer/real_share", buffer.real_share)
        super().dump_metrics()

    def evaluated_policy(self) -> AbstractContextManager[None]:
        """Give the actor its EMA weights within a block."""
        return self.policy_ema.applied()

    def save_final(self, path: Path) -> None:
        """Write the model, as Stable-Baselines3 saves it."""
        save_model(self.model, path)


class RolloutCallback(BaseCallback):
    """Evaluates, saves checkpoints and stops as configured, before each rollout.

    Within a step Stable-Baselines3's state is incomplete: the transition is counted, but not stored
    yet.
    """

    def __init__(self, session: TrainingSession) -> None:
        super().__init__()
        self.session = session
        self._next_update = 0.0

    def _on_rollout_start(self) -> None:
        session = self.session
        step = self.num_timesteps
        session.restore_rollout_state()  # here, where it was saved
        self._check_losses()
        session.policy_ema.update()
        session.stop_if_asked()
        if _is_due(step, session.progress.evaluated, session.config.evaluation.every_n_steps):
            session.evaluate()
        if _is_due(step, session.progress.step, session.config.checkpoint.every_n_steps):
            session.save_checkpoint()
        now = time.monotonic()
        if now >= self._next_update:
            self._next_update = now + 1 / BAR_UPDATES_PER_S
            self._update_display()

    def _on_step(self) -> bool:
        where = f"at step {self.num_timesteps}"
        check_finite({**self.locals["new_obs"], "reward": self.locals["rewards"]}, where)
        for env in np.flatnonzero(self.locals["dones"]):
            check_finite(self.locals["infos"][env]["terminal_observation"], where)
        return True

    def _on_training_end(self) -> None:
        self._check_losses()
        self._update_display()

    def _check_losses(self) -> None:
        """Check what the last updates have logged."""
        losses: dict[str, Any] = {}
        for name, value in self.model.logger.name_to_value.items():
            if name.startswith("train/") and isinstance(value, Real):
                losses[name] = value
        check_finite(losses, f"at step {self.num_timesteps}")

    def _update_display(self) -> None:
        returns = [episode["r"] for episode in self.model.ep_info_buffer or ()]
        success_rate = safe_mean(self.model.ep_success_buffer or [])
        self.session.display.update(self.num_timesteps, success_rate, safe_mean(returns))


def _is_due(step: int, last: int, every: int | None) -> bool:
    """Return whether a multiple of `every` lies in (last, step]."""
    return every is not None and step // every > last // every
