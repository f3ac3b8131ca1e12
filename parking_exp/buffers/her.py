"""HER replay buffer that replaces Stable-Baselines3's `HerReplayBuffer`."""

import json
import warnings
from collections.abc import Mapping
from typing import Any, Protocol, get_args

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.buffers import BaseBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from stable_baselines3.her import GoalSelectionStrategy

from parking_exp.buffers.episode_index import NONE, EpisodeIndex
from parking_exp.buffers.storage import Observation, Storage, Transitions
from parking_exp.buffers.strategies import STRATEGIES
from parking_exp.config.her_options import GoalStrategy, GoalVelocity, RelabelCollision, RelabelTerminated

NO_GOALS = np.empty(0, np.int64)


class Reward(Protocol):
    """Reward function with which the buffer relabels without asking the env, such as `envs.reward.GoalReward`."""

    collision: float  # what a crash adds
    velocity: tuple[int, ...]  # which entries of a goal are a velocity

    def __call__(self, achieved: np.ndarray, desired: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return reward and whether the goal is reached, both of shape (n,)."""


class HerBuffer(HerReplayBuffer):
    """Replay buffer with virtual goals, at a cost that depends neither on its capacity nor on how full it is.

    With `relabel_collision` and `relabel_terminated` at `sb3` and `goal_velocity` at `achieved`, which are the
    defaults, batches are Stable-Baselines3's. It draws from NumPy's global generator only its own seed. An env that is
    reset in the middle of an episode ends it as if by time, where Stable-Baselines3 would go on with it.

    Memory is 112 bytes for a transition of parking-v0, and 60 to 90 for an episode.

    Args:
        buffer_size: transitions, all envs together.
        observation_space: Dict with `observation`, `achieved_goal` and `desired_goal`.
        action_space: of the env.
        env: the training envs; their `compute_reward` is asked where there is no `reward`.
        device: where minibatches go.
        n_envs: how many envs.
        optimize_memory_usage: must be False, as in Stable-Baselines3.
        handle_timeout_termination: whether an episode that ended by time alone goes on in value.
        n_sampled_goal: virtual transitions for each real one: a share of n / (n + 1) of every batch. Those that may
            have no virtual goal, by the options below, keep their own, and count as real.
        goal_selection_strategy: `future`, `final`, `episode`, `random` (any goal achieved so far), or None: no
            virtual transitions, and transitions of episodes under way are drawn too.
        copy_info_dict: must be False: rewards that read `info` are not supported.
        relabel_collision: what becomes of the penalty when a crash gets a virtual goal. `keep`: it stays. `sb3`: it is
            lost, since `compute_reward` knows no collision; at its own goal the crash is then the best there is.
            `exclude`: crashes get no virtual goals, and are none; such transitions keep the goal that they had.
        relabel_terminated: when a virtual transition ends its episode. `sb3`: when the real one did. `goal`: when the
            virtual goal is reached. `goal_and_crash`: also at a crash, as in the env (Stable-Baselines3 issue 627).
            `env`: also, where the virtual goal was reached before the transition, it keeps the goal that it had: in the
            env nothing comes after a goal. Cars that stand would otherwise have learned that standing is arriving.
        goal_velocity: `achieved`: a virtual goal moves as fast as the car did. `zero`: it stands, as real goals do.
        reward: the env's reward, for relabelling without asking the env.

    Raises:
        ValueError: an argument is not one of those above.
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
        copy_info_dict: bool = False,
        relabel_collision: RelabelCollision = "sb3",
        relabel_terminated: RelabelTerminated = "sb3",
        goal_velocity: GoalVelocity = "achieved",
        reward: Reward | None = None,
    ) -> None:
        # Not HerReplayBuffer's own: it would allocate 400 bytes a transition, empty dicts among them.
        BaseBuffer.__init__(self, max(buffer_size // n_envs, 1), observation_space, action_space, device, n_envs)
        if optimize_memory_usage or copy_info_dict:
            raise ValueError("optimize_memory_usage and copy_info_dict must be False")
        if isinstance(goal_selection_strategy, GoalSelectionStrategy):
            goal_selection_strategy = goal_selection_strategy.name
        if goal_selection_strategy is not None:
            goal_selection_strategy = goal_selection_strategy.lower()  # type: ignore[assignment]
            if n_sampled_goal < 1:
                raise ValueError(f"n_sampled_goal={n_sampled_goal} is below 1; for no virtual goals, give no strategy")
        _check_choice("goal_selection_strategy", goal_selection_strategy, (*STRATEGIES, None))
        _check_choice("relabel_collision", relabel_collision, get_args(RelabelCollision))
        _check_choice("relabel_terminated", relabel_terminated, get_args(RelabelTerminated))
        _check_choice("goal_velocity", goal_velocity, get_args(GoalVelocity))
        as_sb3 = relabel_collision == relabel_terminated == "sb3" and goal_velocity == "achieved"
        if reward is None and not as_sb3:
            raise ValueError(
                "relabelling otherwise than Stable-Baselines3 needs to know the reward; "
                "give reward=, such as GoalReward.of(env)"
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
    def real_share(self) -> float | None:
        """Share of real transitions among all that were sampled so far; None before the first."""
        real, virtual = self.sampled
        return real / (real + virtual) if real else None

    @property
    def nbytes(self) -> int:
        """Bytes of memory, when full."""
        return self.storage.nbytes + self.episodes.nbytes

    def virtual(self, batch_size: int) -> int:
        """Return how many transitions of a batch get a virtual goal."""
        return int(self.her_ratio * batch_size)

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
            obs, next_obs: Dict observations, each entry of shape (n_envs, ...); where an episode ended, the last one's.
            action: shape (n_envs, actions).
            reward, done: shape (n_envs,).
            infos: of the envs; `crashed` and `TimeLimit.truncated` are read.
        """
        episodes, storage = self.episodes, self.storage
        obs, next_obs = storage.shaped(obs), storage.shaped(next_obs)
        for env in storage.other_goals(obs, episodes.current).tolist() if episodes.steps else []:
            # The env was reset without a word: SB3's `learn` does so when it is called again.
            if episodes.current[env] != NONE:
                self._truncate(env)
        for env in np.flatnonzero(episodes.current == NONE).tolist():
            storage.start(episodes.start(env), obs["desired_goal"][env])
        episodes.overwrite(storage.record_ids(self.pos))
        terminated = np.asarray(done, bool)
        ended = np.flatnonzero(terminated).tolist()
        if ended and self.handle_timeout_termination:
            terminated = terminated & [not info.get("TimeLimit.truncated", False) for info in infos]
        crashed = np.array([info.get("crashed", False) for info in infos], bool)
        storage.write(self.pos, obs, next_obs, action, reward, episodes.current, terminated, crashed)
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
        without = self.goal_selection_strategy is None
        draw = self.episodes.draw_stored if without else self.episodes.draw
        index, virtual = draw(self.rng, batch_size), self.virtual(batch_size)
        taken, goal_index = self.storage.take(index), NO_GOALS
        if virtual:
            record = self.episodes.table.take(taken.record_ids[-virtual:])
            goal_index = self.select_goals(index[-virtual:], record)
        return self._collect(taken, goal_index, env)

    def select_goals(self, index: np.ndarray, record: np.ndarray) -> np.ndarray:
        """Choose virtual goals: return the indices of the transitions whose next achieved goals they become.

        A subclass may override this with a strategy of its own. `self.rng` is saved in checkpoints: draw with it.

        Args:
            index: of the transitions that get virtual goals, shape (n,).
            record: their episodes: `start`, the row of the first transition, and `length`, shape (n,).
        """
        return STRATEGIES[str(self.goal_selection_strategy)](self.rng, self.episodes, index, record)

    def truncate_last_trajectory(self) -> None:
        """End the episodes under way as if by time, since the envs do not go on with them."""
        under_way = np.flatnonzero(self.episodes.current != NONE).tolist()
        if under_way:
            warnings.warn("The episodes under way in the replay buffer are truncated", stacklevel=2)
        for env in under_way:
            self._truncate(env)

    def _truncate(self, env: int) -> None:
        self.storage.end(self.pos - 1, env, terminated=not self.handle_timeout_termination)
        self.episodes.finish(env)

    def get_state(self) -> dict[str, np.ndarray]:
        """Return everything that the future depends on as arrays, the filled part of the rows uncopied."""
        state = {"pos": np.array(self.pos), "full": np.array(self.full)}
        state |= self.storage.get_state(self.size(), self.episodes.n_records)
        state |= {f"episodes/{name}": array for name, array in self.episodes.get_state().items()}
        rng = json.dumps(self.rng.bit_generator.state).encode()
        return state | {"sampled": np.array(self.sampled), "rng": np.frombuffer(rng, np.uint8)}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Restore a state of a buffer with the same arguments; what follows is identical.

        Raises:
            ValueError: the state is of a buffer of another size, of other spaces or envs; nothing has changed.
        """
        if state["episodes/capacity"] != self.buffer_size:
            raise ValueError(f"the saved buffer has {state['episodes/capacity']} rows and this one {self.buffer_size}")
        self.storage.set_state(state)
        self.pos, self.full = int(state["pos"]), bool(state["full"])
        prefix = "episodes/"
        self.episodes.set_state({name.removeprefix(prefix): state[name] for name in state if name.startswith(prefix)})
        self.sampled = state["sampled"].tolist()
        self.rng.bit_generator.state = json.loads(state["rng"].tobytes())

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickling: without the env, and with the filled part of the rows only."""
        without = {"env", "storage", "episodes", "rng"}
        return {name: value for name, value in vars(self).items() if name not in without} | {"state": self.get_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a pickled state; `set_env` is to be called before a reward is asked of the env."""
        stored = state.pop("state")
        vars(self).update(state)
        self.env = None
        self._make_empty()
        self.rng = np.random.default_rng(0)
        self.set_state(stored)

    def _make_empty(self) -> None:
        assert isinstance(self.observation_space, spaces.Dict)
        self.episodes = EpisodeIndex(self.buffer_size, self.n_envs)
        self.storage = Storage(self.buffer_size, self.n_envs, self.observation_space, self.action_space)
        self.sampled = [0, 0]  # with the goal that they had, with a virtual one

    def _collect(
        self, taken: Transitions, goal_index: np.ndarray, env: VecNormalize | None = None
    ) -> DictReplayBufferSamples:
        """Make a minibatch of transitions; the last len(goal_index) get the goals that were achieved there."""
        virtual = len(goal_index)
        goals = self.storage.achieved(goal_index)
        if self.reward is not None and self.goal_velocity == "zero":
            goals[:, self.reward.velocity] = 0.0
        own = np.zeros(virtual, bool)  # those that keep their own goal
        if virtual and self.relabel_collision == "exclude":
            own |= taken.crashed[-virtual:] | self.storage.crashed(goal_index)
        if virtual and self.relabel_terminated == "env":
            assert self.reward is not None
            own |= self.reward(taken.achieved(virtual), goals)[1]
        if own.any():
            goals[own] = taken.goals(np.flatnonzero(own) - virtual)
        relabelled = virtual - int(own.sum())
        self.sampled[0] += len(taken.rewards) - relabelled
        self.sampled[1] += relabelled
        obs, next_obs = taken.observations(goals)
        rewards, terminated = taken.rewards, taken.terminated
        if virtual:
            new = self._relabel(
                next_obs["achieved_goal"][-virtual:], goals, taken.crashed[-virtual:], terminated[-virtual:]
            )
            for stored, under_goals in zip((rewards, terminated), new, strict=True):
                stored[-virtual:] = np.where(own, stored[-virtual:], under_goals)
        rewards = rewards[:, None]
        if env is not None:
            obs, next_obs = self._normalize_obs(obs, env), self._normalize_obs(next_obs, env)  # type: ignore[assignment]
            rewards = self._normalize_reward(rewards, env)
        return DictReplayBufferSamples(
            observations=self._tensors(obs),
            actions=self._tensor(taken.actions),
            next_observations=self._tensors(next_obs),
            dones=self._tensor(terminated[:, None].astype(np.float32)),
            rewards=self._tensor(rewards),
        )

    def _relabel(
        self, achieved: np.ndarray, goals: np.ndarray, crashed: np.ndarray, terminated: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return reward and end of transitions under virtual goals."""
        if self.reward is None:
            assert self.env is not None, "give the buffer its envs (set_env), whose compute_reward it asks"
            infos: list[dict[str, Any]] = [{} for _ in goals]
            (rewards,) = self.env.env_method("compute_reward", achieved, goals, infos, indices=[0])
            return np.reshape(rewards, -1), terminated
        rewards, reached = self.reward(achieved, goals)
        if self.relabel_collision == "keep":
            rewards = rewards + self.reward.collision * crashed
        if self.relabel_terminated == "goal":
            terminated = reached
        elif self.relabel_terminated in ("goal_and_crash", "env"):
            terminated = reached | crashed
        return rewards, terminated

    def _tensors(self, entries: Observation) -> dict[str, torch.Tensor]:
        """Make tensors, one for entries that are one and the same array."""
        made: dict[int, torch.Tensor] = {}
        return {key: made.setdefault(id(array), self._tensor(array)) for key, array in entries.items()}

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(array), device=self.device)


def _check_choice(name: str, value: object, choices: tuple[str | None, ...]) -> None:
    if value not in choices:
        raise ValueError(f"{name}={value!r} is not one of {choices}")
