"""HER replay buffer that replaces Stable-Baselines3's `HerReplayBuffer`."""

import json
from collections.abc import Mapping
from typing import Any, get_args

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.buffers import BaseBuffer, DictReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

from parking_exp.buffers.episode_index import NO_EPISODE
from parking_exp.buffers.storage import Storage, Transitions
from parking_exp.config_model import (
    GoalStrategy,
    GoalVelocity,
    RelabelCollision,
    RelabelTerminated,
)
from parking_exp.tasks.task import GoalReward, Observation

NO_GOALS = np.empty(0, np.int64)
DEMONSTRATIONS_PREFIX = "demonstrations/"
"""Prefix of the state's entries that belong to demonstrations."""


class HerBuffer(DictReplayBuffer):
    """Replay buffer with virtual goals.

    The cost of sampling depends neither on the capacity nor on how full the buffer is. By default
    (`relabel_collision` and `relabel_terminated` are `sb3`, `goal_velocity` is `achieved`), batches
    are as `HerReplayBuffer` of Stable-Baselines3 makes them. The buffer has its own generator. It
    is seeded once, from NumPy's global generator.

    `Storage` says how much memory a transition takes. Arguments that are not listed are those of
    `DictReplayBuffer`.

    Args:
        n_sampled_goal: virtual transitions for each real one: a share of n / (n + 1) of every
            batch. If the options below forbid relabelling, a transition keeps its goal and counts
            as real.
        goal_selection_strategy: where virtual goals come from: `future` (the rest of the episode),
            `final` (its end), `episode` (anywhere in it), `random` (all stored transitions), or
            None: no virtual transitions, and transitions of episodes under way are sampled too.
        relabel_collision: whether relabelled transitions keep the penalty for a failure (parking:
            a collision). `keep`: they do. `sb3`: they do not, since `compute_reward` has none.
            `exclude`: failing transitions are neither relabelled nor used as goals.
        relabel_terminated: when a virtual transition ends its episode. `sb3`: when the real one
            did. `goal`: when the virtual goal is reached. `goal_and_crash`: also at a failure
            (Stable-Baselines3 issue 627). `env`: as `goal_and_crash` if the env ends episodes at
            their goals, or else as `sb3`. In the first case, transitions that start at the virtual
            goal are not relabelled: the agent would learn that standing still is success.
        goal_velocity: the velocity of virtual goals: `achieved`, or `zero` as in real goals.
        reward: the env's reward.

    Raises:
        ValueError: there is no such strategy.

    Attributes:
        demonstrations: a buffer of the same class, of one env, from which `demonstration_share` of
            each batch is sampled; None without demonstrations.
        demonstration_share: between 0 and 1.
    """

    demonstrations: "HerBuffer | None" = None
    demonstration_share = 0.0

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Dict,
        action_space: spaces.Space,
        device: torch.device | str = "auto",
        n_envs: int = 1,
        optimize_memory_usage: bool = False,
        handle_timeout_termination: bool = True,
        n_sampled_goal: int = 4,
        goal_selection_strategy: GoalStrategy | None = "future",
        relabel_collision: RelabelCollision = "sb3",
        relabel_terminated: RelabelTerminated = "sb3",
        goal_velocity: GoalVelocity = "achieved",
        *,
        reward: GoalReward,
    ) -> None:
        rows = max(buffer_size // n_envs, 1)
        # Not DictReplayBuffer's method, which allocates arrays.
        BaseBuffer.__init__(self, rows, observation_space, action_space, device, n_envs)
        assert not optimize_memory_usage, "HerBuffer does not support optimize_memory_usage"
        strategies = get_args(GoalStrategy)
        if goal_selection_strategy not in (None, *strategies):
            raise ValueError(
                f"goal_selection_strategy={goal_selection_strategy!r}: give one of "
                f"{', '.join(strategies)}, or None"
            )
        self.reward = reward
        self.handle_timeout_termination = handle_timeout_termination
        self.goal_selection_strategy = goal_selection_strategy
        self.n_sampled_goal = 0 if goal_selection_strategy is None else n_sampled_goal
        self.relabel_collision = relabel_collision
        self.relabel_terminated = relabel_terminated
        self.goal_velocity = goal_velocity
        # Numbers of transitions sampled so far.
        self.n_real = 0
        self.n_virtual = 0
        self._info_keys = reward.info_keys
        n_info = len(self._info_keys)
        self.storage = Storage(self.buffer_size, n_envs, observation_space, action_space, n_info)
        self.episodes = self.storage.episodes
        # The model's seed has seeded NumPy's global generator by now.
        self.rng = np.random.default_rng(np.random.randint(2**32, size=4))

    @property
    def real_share(self) -> float | None:
        """Fraction of real transitions among the agent's own that were sampled so far.

        Demonstrations are left out. It is None before the first sample.
        """
        n_sampled = self.n_real + self.n_virtual
        return self.n_real / n_sampled if n_sampled else None

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
            infos: the envs' infos; the reward's `failure_key` and `info_keys`, and
                `TimeLimit.truncated` are read.
        """
        for env in np.flatnonzero(self.episodes.current == NO_EPISODE).tolist():
            self.episodes.start(env, obs["desired_goal"][env])

        terminated = np.array(done, bool)
        ended = np.flatnonzero(terminated).tolist()
        if self.handle_timeout_termination:
            for env in ended:
                terminated[env] = not infos[env].get("TimeLimit.truncated", False)
        failure_key = self.reward.failure_key
        failed = np.array([bool(info.get(failure_key)) for info in infos])
        info = np.empty((self.n_envs, len(self._info_keys)))
        for column, key in enumerate(self._info_keys):
            info[:, column] = [env_info[key] for env_info in infos]

        self.storage.write(obs, next_obs, action, reward, terminated, failed, info)
        self._update_position()
        for env in ended:
            self.episodes.finish(env)

    def sample(self, batch_size: int, env: None = None) -> DictReplayBufferSamples:  # type: ignore[override]
        """Sample a minibatch: real transitions first, then those with virtual goals.

        Demonstrated transitions follow, in the same order.

        Raises:
            RuntimeError: no episode has ended yet.
        """
        assert env is None, "HerBuffer does not support VecNormalize"
        if self.demonstrations is None:
            return self._sample(batch_size)
        n_demonstrated = round(self.demonstration_share * batch_size)
        collected = self._sample(batch_size - n_demonstrated)
        demonstrated = self.demonstrations._sample(n_demonstrated)
        return _join_minibatches(collected, demonstrated)

    def _sample(self, batch_size: int) -> DictReplayBufferSamples:
        """Sample a minibatch of this buffer's own transitions, without its demonstrations."""
        if self.goal_selection_strategy is None:
            index = self.episodes.sample_stored(self.rng, batch_size)
        else:
            index = self.episodes.sample(self.rng, batch_size)
        transitions = self.storage.take(index)

        goal_index = NO_GOALS
        n_virtual = int((1 - 1 / (self.n_sampled_goal + 1)) * batch_size)
        if n_virtual:
            records = transitions.records[-n_virtual:]
            goal_index = self.select_goals(index[-n_virtual:], records)
        return self._make_minibatch(transitions, goal_index)

    def select_goals(self, index: np.ndarray, record: np.ndarray) -> np.ndarray:
        """Return the indices of the transitions whose next achieved goals become virtual goals.

        The strategies come from Andrychowicz et al. 2017, section 4.5 (arXiv:1707.01495).
        A subclass may override this with its own strategy, which should sample from `self.rng`:
        checkpoints save it.

        Args:
            index: indices of the transitions that get virtual goals, shape (n,).
            record: their episodes: `start`, the row of the first transition, and `length`, shape
                (n,).
        """
        if self.goal_selection_strategy == "random":
            return self.episodes.sample_stored(self.rng, len(index))

        row, env = np.divmod(index, self.n_envs)
        length = record["length"].astype(np.int64)
        if self.goal_selection_strategy == "final":
            position = length - 1
        elif self.goal_selection_strategy == "future":
            # As in Stable-Baselines3, the transition itself is included.
            passed = (row - record["start"]) % self.episodes.capacity
            position = self.rng.integers(passed, length)
        else:  # "episode"
            position = self.rng.integers(length)
        return self.episodes.index(record["start"] + position, env)

    def get_state(self) -> dict[str, np.ndarray]:
        """Return the whole state as arrays, uncopied."""
        rng = json.dumps(self.rng.bit_generator.state).encode()
        state = {
            "sampled": np.array([self.n_real, self.n_virtual]),
            "rng": np.frombuffer(rng, np.uint8),
            **self.storage.get_state(),
        }
        if self.demonstrations is not None:
            for name, array in self.demonstrations.storage.get_state().items():
                state[f"{DEMONSTRATIONS_PREFIX}{name}"] = array
        return state

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Restore a state of a buffer with the same arguments; what follows is identical."""
        self.n_real, self.n_virtual = state["sampled"].tolist()
        self.rng.bit_generator.state = json.loads(state["rng"].tobytes())
        self.storage.set_state(state)
        self._update_position()
        if self.demonstrations is not None:
            names = self.demonstrations.storage.get_state()
            demonstrated = {name: state[f"{DEMONSTRATIONS_PREFIX}{name}"] for name in names}
            self.demonstrations.set_transitions(demonstrated)

    def set_transitions(self, state: Mapping[str, np.ndarray]) -> None:
        """Replace the stored transitions with those of a state, and end its unfinished episodes.

        These count as timeouts, since they did not terminate. The buffer keeps its own generator.

        Raises:
            ModelError: the transitions have other fields.
        """
        self.storage.set_state(state)
        for env in np.flatnonzero(self.episodes.current != NO_EPISODE).tolist():
            self.episodes.finish(env)
        self._update_position()

    def _update_position(self) -> None:
        self.pos = self.episodes.steps % self.buffer_size
        self.full = self.episodes.steps >= self.buffer_size

    def _make_minibatch(
        self, transitions: Transitions, goal_index: np.ndarray
    ) -> DictReplayBufferSamples:
        """Relabel the last len(goal_index) transitions with the goals achieved there.

        Returns:
            All transitions as tensors.
        """
        n_virtual = self._relabel(transitions, goal_index) if len(goal_index) else 0
        self.n_real += len(transitions.rewards) - n_virtual
        self.n_virtual += n_virtual
        return DictReplayBufferSamples(
            observations=self._tensors(transitions.obs),
            actions=self._tensor(transitions.actions),
            next_observations=self._tensors(transitions.next_obs),
            dones=self._tensor(transitions.terminated[:, None].astype(np.float32)),
            rewards=self._tensor(transitions.rewards[:, None]),
        )

    def _relabel(self, transitions: Transitions, goal_index: np.ndarray) -> int:
        """Give the last transitions virtual goals, in place, where the options allow it.

        Returns:
            How many got one.
        """
        last = slice(-len(goal_index), None)
        info = transitions.info[last]
        failed = transitions.failed[last]
        goals = self.storage.achieved(goal_index)
        if self.goal_velocity == "zero":
            goals[:, self.reward.velocity] = 0.0
        rewards, reached = self.reward(transitions.next_obs["achieved_goal"][last], goals, info)
        if self.relabel_collision == "keep":
            rewards = rewards + self.reward.failure_penalty * failed

        allowed = self._may_relabel(transitions, goal_index, goals)

        transitions.rewards[last][allowed] = rewards[allowed]
        if self.relabel_terminated == "goal":
            transitions.terminated[last][allowed] = reached[allowed]
        if self.relabel_terminated == "goal_and_crash" or self._ends_at_goal:
            transitions.terminated[last][allowed] = (reached | failed)[allowed]
        for obs in (transitions.obs, transitions.next_obs):
            obs["desired_goal"][last][allowed] = goals[allowed]
        return int(allowed.sum())

    def _may_relabel(
        self, transitions: Transitions, goal_index: np.ndarray, goals: np.ndarray
    ) -> np.ndarray:
        """Return a mask of the last transitions that may be relabelled, shape (n,)."""
        last = slice(-len(goal_index), None)
        allowed = np.ones(len(goals), bool)
        if self.relabel_collision == "exclude":
            allowed &= ~(transitions.failed[last] | self.storage.failed(goal_index))
        if self._ends_at_goal:
            before = transitions.obs["achieved_goal"][last]
            _, starts_there = self.reward(before, goals, transitions.info[last])
            allowed &= ~starts_there
        return allowed

    @property
    def _ends_at_goal(self) -> bool:
        """Whether virtual transitions end as in an env that ends episodes at their goal."""
        return self.relabel_terminated == "env" and self.reward.terminates

    def _tensors(self, entries: Observation) -> dict[str, torch.Tensor]:
        return {key: self._tensor(array) for key, array in entries.items()}

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(array), device=self.device)


def _join_minibatches(
    first: DictReplayBufferSamples, second: DictReplayBufferSamples
) -> DictReplayBufferSamples:
    """Return two minibatches as one."""
    # The sixth field, `discounts`, is None: it belongs to n-step returns.
    fields: Any = zip(first[:5], second[:5], strict=True)
    joined: list[Any] = []
    for own, other in fields:
        if isinstance(own, dict):
            joined.append({key: torch.cat([entry, other[key]]) for key, entry in own.items()})
        else:
            joined.append(torch.cat([own, other]))
    return DictReplayBufferSamples(*joined)
