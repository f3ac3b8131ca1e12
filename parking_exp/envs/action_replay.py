"""Save and restore a highway-env env by replaying its episode's actions, as its state cannot be saved."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding


class ReplayActions(gym.Wrapper):
    """Record how the episode under way started and its actions; replay them in another env of the same kind.

    The start is the random generator before `reset`. Only the episode under way is kept, and to restore it takes as
    long as to drive it.
    """

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self._start: dict[str, Any] | None = None
        self._actions: list[np.ndarray] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        rng = self.unwrapped.np_random if seed is None else seeding.np_random(seed)[0]
        self._start, self._actions = rng.bit_generator.state, []
        return self.env.reset(seed=seed, options=options)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step the env."""
        self._actions.append(np.array(action))
        return self.env.step(action)

    def get_state(self) -> dict[str, Any]:
        """Return how the episode started, None before the first one, and the actions since, shape (steps, actions)."""
        actions = np.reshape(np.array(self._actions, self.action_space.dtype), (-1, *self.action_space.shape))
        return {"start": self._start, "actions": actions}

    def set_state(self, state: dict[str, Any]) -> None:
        """Replay a saved episode up to where it was; what follows is identical."""
        if state["start"] is None:
            return
        self.unwrapped.np_random.bit_generator.state = state["start"]
        self.reset()
        for action in state["actions"]:
            self.step(action)
