"""highway-env has no state that could be saved; but an episode follows from how it started and what was done."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding


class ReplayActions(gym.Wrapper):
    """Remembers the episode under way, so that another env of the same kind can be brought to the same state.

    What an episode depends on is the generator as it was before `reset`, and the actions since. At most one episode is
    kept, and to restore it takes as long as it took to drive it.
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
        """Drive a saved episode again up to where it was; what follows is identical."""
        if state["start"] is None:
            return
        self.unwrapped.np_random.bit_generator.state = state["start"]
        self.reset()
        for action in state["actions"]:
            self.step(action)
