"""Callbacks as users write them."""

from typing import ClassVar

from stable_baselines3.common.callbacks import BaseCallback


class CountsRollouts(BaseCallback):
    """Log the number of rollouts as a metric, and stop the training at a step."""

    def __init__(self, stop_at: int | None = None) -> None:
        super().__init__()
        self.stop_at = stop_at
        self.n_rollouts = 0

    def _on_rollout_end(self) -> None:
        self.n_rollouts += 1
        self.logger.record("mine/rollouts", self.n_rollouts)

    def _on_step(self) -> bool:
        return self.stop_at is None or self.num_timesteps < self.stop_at


class KeepsArguments(BaseCallback):
    """Remember the types of the arguments that it was made with."""

    received: ClassVar[list[type]] = []

    def __init__(self, names: list[str], limits: dict[str, float]) -> None:
        super().__init__()
        self.received[:] = [type(names), type(limits)]

    def _on_step(self) -> bool:
        return True
