"""The Stable-Baselines3 callback that evaluates, saves checkpoints and stops between rollouts."""

import time
from typing import TYPE_CHECKING

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

if TYPE_CHECKING:
    from parking_exp.training.loop import TrainingLoop

BAR_UPDATES_A_SECOND = 5


class RolloutCallback(BaseCallback):
    """Evaluates, saves checkpoints and stops as configured, before each rollout.

    Stable-Baselines3's state is whole there: inside a step the transition is counted already and not yet stored.
    """

    def __init__(self, loop: "TrainingLoop") -> None:
        super().__init__()
        self.loop = loop
        self._next_update = 0.0

    def _on_rollout_start(self) -> None:
        loop = self.loop
        config, progress, step = loop.config, loop.progress, self.num_timesteps
        loop.restore_rollout_state()  # here, where it was saved
        loop.average.update()
        loop.stop_if_asked()
        if _due(step, progress.evaluated, config.evaluation.every_n_steps):
            loop.evaluate()
        if _due(step, progress.saved, config.checkpoint.every_n_steps):
            loop.save_checkpoint()
        if (now := time.monotonic()) >= self._next_update:
            self._next_update = now + 1 / BAR_UPDATES_A_SECOND
            loop.bar.update(step, *self._recent())

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self.loop.bar.update(self.num_timesteps, *self._recent())

    def _recent(self) -> tuple[float | None, float | None]:
        """Success rate and mean return of the last training episodes."""
        successes, episodes = self.model.ep_success_buffer, self.model.ep_info_buffer
        if not successes or not episodes:
            return None, None
        return float(np.mean(successes)), float(np.mean([episode["r"] for episode in episodes]))


def _due(step: int, last: int, every: int | None) -> bool:
    """Whether a multiple of `every` lies in (last, step]."""
    return every is not None and step // every > last // every
