"""The simulator as a Stable-Baselines3 VecEnv."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from parking_exp.tasks.parking.nearby_vehicles import observation_size
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.parking.scenes import Scenes
from parking_exp.tasks.parking.simulator import Simulator


class ParkingVecEnv(VecEnv):
    """VecEnv of n parking envs, simulated together; an env starts a new scene when its episode
    ends.

    After `seed(s)`, `reset()` starts highway-env's scenes s, s + 1, ...; later ones are drawn from
    the same distribution by a generator seeded with s.
    """

    render_mode = None  # videos are made with highway-env

    def __init__(self, config: ParkingConfig, n_envs: int) -> None:
        self.config = config
        self._rng = np.random.default_rng()
        self.simulator = Simulator(config, self._draw(n_envs))
        self.goal_reward = self.simulator.reward
        goal = spaces.Box(-np.inf, np.inf, (len(config.observation.features),), np.float64)
        seen = spaces.Box(
            -np.inf, np.inf, (observation_size(config.observation.vehicles_count),), np.float64
        )
        observation_space = spaces.Dict(
            {"observation": seen, "achieved_goal": goal, "desired_goal": goal}
        )
        super().__init__(n_envs, observation_space, spaces.Box(-1.0, 1.0, (2,), np.float32))
        self._actions = np.zeros((n_envs, 2))

    def reset(self) -> VecEnvObs:
        """Start a scene in every env and return the first observations."""
        if self._seeds[0] is not None:
            # Not the stream that scene s itself is drawn from.
            self._rng = np.random.default_rng((self._seeds[0], 1))
            seeds = [s or 0 for s in self._seeds]
            self.simulator.start(
                Scenes.from_seeds(seeds, self.config.vehicles_range, self.config.obstacles)
            )
        else:
            self.simulator.start(self._draw(self.num_envs))
        self._reset_seeds()
        return self.simulator.observe()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next step, shape (n_envs, 2)."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step all envs. Where an episode ended, the observation is the next one's first."""
        step = self.simulator.step(self._actions)
        done = step.terminated | step.truncated
        infos: list[dict[str, Any]] = [
            {"is_success": success, "crashed": crashed}
            for success, crashed in zip(step.is_success.tolist(), step.failed.tolist(), strict=True)
        ]
        ended = np.flatnonzero(done)
        if len(ended):
            for row in ended:
                last = {key: value[row].copy() for key, value in step.observation.items()}
                only_time = bool(step.truncated[row] and not step.terminated[row])
                infos[row] |= {"terminal_observation": last, "TimeLimit.truncated": only_time}
            self.simulator.start(self._draw(len(ended)), ended)
            for key, value in self.simulator.observe(ended).items():
                step.observation[key][ended] = value
        return step.observation, step.reward.astype(np.float32), done, infos

    def get_state(self) -> dict[str, Any]:
        """Return the whole state, the generator of scenes included."""
        rng = self._rng.bit_generator.state
        return {"simulator": self.simulator.get_state(), "rng": rng, "seeds": list(self._seeds)}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore a state; what follows is identical."""
        self.simulator.set_state(state["simulator"])
        self._rng.bit_generator.state = state["rng"]
        self._seeds = list(state["seeds"])

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """Return an attribute for each of the envs, which share it."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(
        self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None
    ) -> None:
        """Refuse: the envs share everything."""
        raise NotImplementedError

    def env_method(
        self,
        method_name: str,
        *args: Any,
        indices: int | Iterable[int] | None = None,
        **kwargs: Any,
    ) -> list[Any]:
        """Call a method for each of the envs, such as `compute_reward`, which HER needs."""
        return [getattr(self, method_name)(*args, **kwargs) for _ in self._get_indices(indices)]

    def compute_reward(
        self, achieved_goal: np.ndarray, desired_goal: np.ndarray, info: object = None
    ) -> np.ndarray:
        """Return the reward of goals, collisions apart: shape (batch,) for goals of shape (batch,
        6).
        """
        return self.goal_reward(achieved_goal, desired_goal)[0]

    def env_is_wrapped(
        self, wrapper_class: type, indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        """Return that no env is wrapped."""
        return [False for _ in self._get_indices(indices)]

    def _draw(self, number: int) -> Scenes:
        return Scenes.random(self._rng, number, self.config.vehicles_range, self.config.obstacles)
