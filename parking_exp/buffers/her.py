"""HER replay buffer that replaces Stable-Baselines3's `HerReplayBuffer`."""

import json
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from parking_exp.buffers.episode_index import NO_EPISODE
from parking_exp.buffers.storage import Storage, Transitions
from parking_exp.buffers.strategies import STRATEGIES
from parking_exp.config.argument_limits import (
    GoalStrategy,
    GoalVelocity,
    RelabelCollision,
    RelabelTerminated,
)
from parking_exp.tasks.task import GoalReward, Observation

NO_GOALS = np.empty(0, np.int64)


class HerBuffer(HerReplayBuffer):
    """Replay buffer with virtual goals, at a cost that depends neither on its capacity nor on how
    full it is.

    With `relabel_collision` and `relabel_terminated` at `sb3` and `goal_velocity` at `achieved`,
    which are the defaults, batches are Stable-Baselines3's. It draws from NumPy's global generator
    only its own seed. An env that is reset in the middle of an episode truncates it, where
    Stable-Baselines3 would continue it.

    Memory is 112 bytes for a transition of parking-v0, and 60 to 90 for an episode.

    Args (others are those of `HerReplayBuffer`):
        n_sampled_goal: virtual transitions for each real one: a share of n / (n + 1) of every
            batch. Those that the options below allow no virtual goal keep their own, and count as
            real.
        goal_selection_strategy: `future`, `final`, `episode`, `random` (any goal achieved so far),
            or None: no virtual transitions, and transitions of episodes under way are drawn too.
        relabel_collision: the penalty of a failure (parking: a collision) with a virtual goal.
        `keep`: it is added.
            `sb3`: it is not, since `compute_reward` knows none. `exclude`: transitions at which the
            episode fails are neither relabelled nor used as goals.
        relabel_terminated: when a virtual transition ends its episode. `sb3`: when the real one
        did. `goal`: when the
            virtual goal is reached. `goal_and_crash`: also at a failure (Stable-Baselines3 issue
            627). `env`: as in the env; if that ends episodes at their goal, as `goal_and_crash`,
            and transitions that start at the virtual goal are not relabelled. Otherwise the agent
            learns that standing still counts as success.
        goal_velocity: of virtual goals: `achieved`, or `zero` as of real goals.
        reward: the env's reward; None: the `compute_reward` of `env`.

    Raises:
        ValueError: there is no such strategy, or options other than the defaults need a `reward`.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Dict,
        action_space: spaces.Space,
        env: VecEnv | None = None,
        device: torch.device | str = "auto",
        n_envs: int = 1,
        optimize_memory_usage: bool = False,
        handle_timeout_termination: bool = True,
        n_sampled_goal: int = 4,
        goal_selection_strategy: GoalStrategy | None = "future",
        relabel_collision: RelabelCollision = "sb3",
        relabel_terminated: RelabelTerminated = "sb3",
        goal_velocity: GoalVelocity = "achieved",
        reward: GoalReward | None = None,
    ) -> None:
        # Not HerReplayBuffer's own: it would allocate 400 bytes a transition, empty dicts among
        # them.
        BaseBuffer.__init__(
            self, max(buffer_size // n_envs, 1), observation_space, action_space, device, n_envs
        )
        assert not optimize_memory_usage, "HerBuffer does not support optimize_memory_usage"
        if goal_selection_strategy not in (*STRATEGIES, None):
            raise ValueError(f"{goal_selection_strategy=} is not one of {', '.join(STRATEGIES)}")
        if reward is None and (relabel_collision, relabel_terminated, goal_velocity) != (
            "sb3",
            "sb3",
            "achieved",
        ):
            raise ValueError(
                "relabel_collision, relabel_terminated and goal_velocity need a reward"
            )
        self.env, self.reward = env, reward
        self.handle_timeout_termination = handle_timeout_termination
        self.goal_selection_strategy = goal_selection_strategy  # type: ignore[assignment]
        self.optimize_memory_usage = self.copy_info_dict = False
        self.n_sampled_goal = n_sampled_goal if goal_selection_strategy else 0
        self.her_ratio = 1 - 1 / (self.n_sampled_goal + 1)
        self.relabel_collision, self.relabel_terminated = relabel_collision, relabel_terminated
        self.goal_velocity = goal_velocity
        self._make_empty()
        # The model's seed has seeded NumPy's global generator by now.
        self.rng = np.random.default_rng(np.random.randint(2**32, size=4))

    @property
    def real_fraction(self) -> float | None:
        """Fraction of real transitions among all sampled so far; None before the first."""
        real, virtual = self.sampled
        return real / (real + virtual) if real else None

    def reset(self) -> None:
        """Forget all transitions."""
        super().reset()
        self._make_empty()

    def add(  # type: ignore[override]
        self,
        obs: dict[str, np.ndarray],
        next_obs: dict[str, np.ndarray],
        action: np.ndarray,
        reward: np.ndarray,
        done: np.ndarray,
        infos: list[dict[str, Any]],
    ) -> None:
        """Store a transition of each env.

        Args:
            obs, next_obs: Dict observations, each entry of shape (n_envs, ...); where an episode
                ended, the last one's.
            action: shape (n_envs, actions).
            reward, done: shape (n_envs,).
            infos: of the envs; the reward's `failure_key` and `TimeLimit.truncated` are read.
        """
        episodes, storage = self.episodes, self.storage
        obs, next_obs = storage.cast(obs), storage.cast(next_obs)
        for env in storage.other_goals(obs).tolist():
            # SB3's `learn` resets the envs without notice when it is called again.
            if episodes.current[env] != NO_EPISODE:
                self._truncate(env)
        for env in np.flatnonzero(episodes.current == NO_EPISODE).tolist():
            episodes.start(env, obs["desired_goal"][env])
        episodes.overwrite(storage.record_ids(self.pos))
        terminated = np.asarray(done, bool)
        ended = np.flatnonzero(terminated).tolist()
        if ended and self.handle_timeout_termination:
            terminated = terminated & [not info.get("TimeLimit.truncated", False) for info in infos]
        failure_key = self.reward and self.reward.failure_key
        failed = np.array([bool(failure_key and info.get(failure_key)) for info in infos])
        info = np.array([[info[key] for key in self._info_keys] for info in infos], float)
        storage.write(self.pos, obs, next_obs, action, reward, terminated, failed, info)
        episodes.steps += 1
        self.pos += 1
        if self.pos == self.buffer_size:
            self.full, self.pos = True, 0
        for env in ended:
            episodes.finish(env)

    def sample(self, batch_size: int, env: VecNormalize | None = None) -> DictReplayBufferSamples:  # type: ignore[override]
        """Draw a minibatch: real transitions first, then those with virtual goals.

        Entries of the observations that are equal may be one tensor.

        Raises:
            RuntimeError: no episode has ended yet.
        """
        draw = (
            self.episodes.draw_stored
            if self.goal_selection_strategy is None
            else self.episodes.draw
        )
        index, virtual = draw(self.rng, batch_size), int(self.her_ratio * batch_size)
        transitions, goal_index = self.storage.take(index), NO_GOALS
        if virtual:
            goal_index = self.select_goals(index[-virtual:], transitions.records[-virtual:])
        return self._collect(transitions, goal_index, env)

    def select_goals(self, index: np.ndarray, record: np.ndarray) -> np.ndarray:
        """Return the indices of the transitions whose next achieved goals become virtual goals.

        A subclass may override this with its own strategy, which should draw from `self.rng`:
        checkpoints save it.

        Args:
            index: of the transitions that get virtual goals, shape (n,).
            record: their episodes: `start`, the row of the first transition, and `length`, shape
                (n,).
        """
        return STRATEGIES[str(self.goal_selection_strategy)](self.rng, self.episodes, index, record)

    def truncate_last_trajectory(self) -> None:
        """Truncate the episodes under way, since the envs do not continue them."""
        under_way = np.flatnonzero(self.episodes.current != NO_EPISODE).tolist()
        if under_way:
            warnings.warn("The episodes under way in the replay buffer are truncated", stacklevel=2)
        for env in under_way:
            self._truncate(env)

    def _truncate(self, env: int) -> None:
        self.storage.end(self.pos - 1, env, terminated=not self.handle_timeout_termination)
        self.episodes.finish(env)

    def get_state(self) -> dict[str, np.ndarray]:
        """Return the whole state as arrays, the filled part of the rows uncopied."""
        rng = np.frombuffer(json.dumps(self.rng.bit_generator.state).encode(), np.uint8)
        counters = {
            "pos": np.array(self.pos),
            "full": np.array(self.full),
            "sampled": np.array(self.sampled),
        }
        return counters | {"rng": rng} | self.storage.get_state() | self.episodes.get_state()

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Restore a state of a buffer with the same arguments; what follows is identical."""
        self.pos, self.full, self.sampled = (
            int(state["pos"]),
            bool(state["full"]),
            state["sampled"].tolist(),
        )
        self.rng.bit_generator.state = json.loads(state["rng"].tobytes())
        self.storage.set_state(state)
        self.episodes.set_state(state)

    def _make_empty(self) -> None:
        assert isinstance(self.observation_space, spaces.Dict)
        self._info_keys = self.reward.info_keys if self.reward else ()
        spaces_of = (self.observation_space, self.action_space)
        self.storage = Storage(self.buffer_size, self.n_envs, *spaces_of, len(self._info_keys))
        self.episodes = self.storage.episodes
        self.sampled = [0, 0]  # real transitions, virtual ones

    def _collect(
        self, transitions: Transitions, goal_index: np.ndarray, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Make a minibatch of transitions; the last len(goal_index) get the goals that were
        achieved there.
        """
        relabelled = self._relabel(transitions, goal_index) if len(goal_index) else 0
        self.sampled[0] += len(transitions.rewards) - relabelled
        self.sampled[1] += relabelled
        obs, next_obs, rewards = transitions.obs, transitions.next_obs, transitions.rewards[:, None]
        if env is not None:
            obs, next_obs = self._normalize_obs(obs, env), self._normalize_obs(next_obs, env)  # type: ignore[assignment]
            rewards = self._normalize_reward(rewards, env)
        return DictReplayBufferSamples(
            observations=self._tensors(obs),
            actions=self._tensor(transitions.actions),
            next_observations=self._tensors(next_obs),
            dones=self._tensor(transitions.terminated[:, None].astype(np.float32)),
            rewards=self._tensor(rewards),
        )

    def _relabel(self, transitions: Transitions, goal_index: np.ndarray) -> int:
        """Give the last transitions virtual goals, in place, where the options allow it; return how
        many got one.
        """
        last = slice(-len(goal_index), None)
        goals, failed = self.storage.achieved(goal_index), transitions.failed[last]
        if self.reward is not None and self.goal_velocity == "zero":
            goals[:, self.reward.velocity] = 0.0
        allowed = np.ones(len(goals), bool)
        if self.relabel_collision == "exclude":
            allowed &= ~(failed | self.storage.failed(goal_index))
        terminates = self.relabel_terminated
        if terminates == "env" and self.reward is not None and not self.reward.terminates:
            terminates = "sb3"
        if self.reward is not None and terminates == "env":
            allowed &= ~self.reward(
                transitions.obs["achieved_goal"][last], goals, transitions.info[last]
            )[1]
        rewards, reached = self._reward(
            transitions.next_obs["achieved_goal"][last], goals, transitions.info[last]
        )
        if self.reward is not None and self.relabel_collision == "keep":
            rewards = rewards + self.reward.failure_penalty * failed
        transitions.rewards[last][allowed] = rewards[allowed]
        if terminates != "sb3":
            terminated = reached if terminates == "goal" else reached | failed
            transitions.terminated[last][allowed] = terminated[allowed]
        for obs in (transitions.obs, transitions.next_obs):
            obs["desired_goal"][last][allowed] = goals[allowed]
        return int(allowed.sum())

    def _reward(
        self, achieved: np.ndarray, goals: np.ndarray, info: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the reward of goals, and whether they are reached if the reward function is
        known.
        """
        if self.reward is not None:
            return self.reward(achieved, goals, info)
        assert self.env is not None, (
            "give the buffer its envs (set_env), whose compute_reward it asks"
        )
        infos: list[dict[str, Any]] = [{} for _ in goals]
        (rewards,) = self.env.env_method("compute_reward", achieved, goals, infos, indices=[0])
        return np.reshape(rewards, -1), np.zeros(len(goals), bool)

    def _tensors(self, entries: Observation) -> dict[str, torch.Tensor]:
        """Return tensors, one for entries that are the same array."""
        tensors: dict[int, torch.Tensor] = {}
        return {
            key: tensors.setdefault(id(array), self._tensor(array))
            for key, array in entries.items()
        }

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(array), device=self.device)
