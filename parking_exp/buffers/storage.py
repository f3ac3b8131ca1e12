"""Storage of transitions: all fields of one lie together, so that reading it is one memory
access.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.preprocessing import get_action_dim, get_obs_shape

from parking_exp.buffers.episode_index import EpisodeIndex
from parking_exp.tasks.task import Observation

TERMINATED, FAILED, ID_SHIFT = (
    1,
    2,
    2,
)  # bits of `mark`; above them is the id of the episode's record


@dataclass
class Transitions:
    """n transitions copied out of the storage; equal entries of an observation may be one array."""

    obs: Observation  # before, each entry of shape (n, ...)
    next_obs: Observation
    actions: np.ndarray  # shape (n, actions)
    rewards: np.ndarray  # shape (n,)
    terminated: np.ndarray  # booleans, shape (n,)
    failed: np.ndarray
    info: np.ndarray  # numbers of `info`, shape (n, n_info)
    records: np.ndarray  # entries of `EpisodeIndex.table`, shape (n,)


class Storage:
    """Ring buffer of `capacity` rows, each with one transition of each of `n_envs` envs, and the
    index of its episodes.

    Compact storage leaves out an achieved goal that equals the observation, as in parking-v0, and a
    desired goal that is constant within an episode, whose record has it. The first transition that
    violates this widens all rows.

    A transition of parking-v0 takes 112 bytes: 2 x 6 doubles, 2 + 1 floats, and a mark; its
    episode's record, 56. If K vehicles make the observation wider than a goal, it takes 304 + 80 K
    bytes.
    """

    def __init__(
        self,
        capacity: int,
        n_envs: int,
        observation_space: spaces.Dict,
        action_space: spaces.Space,
        n_info: int = 0,
    ) -> None:
        shapes: dict[str, tuple[int, ...]] = get_obs_shape(observation_space)  # type: ignore[assignment]
        self.formats = {
            key: (space.dtype, shapes[key]) for key, space in observation_space.spaces.items()
        }
        self.episodes = EpisodeIndex(capacity, n_envs, *self.formats["desired_goal"])
        self._action = (
            ReplayBuffer._maybe_cast_dtype(action_space.dtype),
            (get_action_dim(action_space),),
        )
        self._n_info = n_info
        self._allocate(compact=self.formats["achieved_goal"] == self.formats["observation"])

    def cast(self, obs: Mapping[str, Any]) -> Observation:
        """Return observations with the types and shapes of the space, each entry (n_envs, ...)."""
        return {
            key: np.asarray(obs[key], dtype).reshape(self.episodes.n_envs, *shape)
            for key, (dtype, shape) in self.formats.items()
        }

    def other_goals(self, obs: Observation) -> np.ndarray:
        """Return the envs whose desired goal changed within their episode; empty if storage is not
        compact.
        """
        if not self.compact or not self.episodes.steps:
            return np.empty(0, np.int64)
        differs = obs["desired_goal"] != self.episodes.table["goal"][self.episodes.current]
        return np.flatnonzero(differs.reshape(len(differs), -1).any(axis=1))

    def write(
        self,
        row: int,
        obs: Observation,
        next_obs: Observation,
        action: np.ndarray,
        reward: np.ndarray,
        terminated: np.ndarray,
        failed: np.ndarray,
        info: np.ndarray,
    ) -> None:
        """Write a row: a transition of each env, in the episodes under way."""
        record_ids = self.episodes.current
        if self.compact and not (
            np.array_equal(obs["achieved_goal"], obs["observation"])
            and np.array_equal(next_obs["achieved_goal"], next_obs["observation"])
            and np.array_equal(next_obs["desired_goal"], self.episodes.table["goal"][record_ids])
        ):
            self._widen()
        rows = self.data[row]
        for name, entries in (("obs", obs), ("next_obs", next_obs)):
            stored = rows[name]
            for key in stored.dtype.names or ():
                stored[key] = entries[key]
        rows["action"] = np.reshape(action, rows["action"].shape)
        rows["reward"] = reward
        rows["info"] = info
        rows["mark"] = record_ids << ID_SHIFT | failed * FAILED | terminated * TERMINATED

    def record_ids(self, row: int) -> np.ndarray:
        """Return the record ids of a row's episodes, shape (n_envs,)."""
        return self.data["mark"][row] >> ID_SHIFT

    def end(self, row: int, env: int, terminated: bool) -> None:
        """Note how a transition ends its episode."""
        mark = self.data["mark"]
        mark[row, env] = mark[row, env] // FAILED * FAILED | terminated * TERMINATED

    def take(self, index: np.ndarray) -> Transitions:
        """Return transitions by index, row * n_envs + env, as a copy."""
        rows = self.data.reshape(-1).take(index)
        mark = rows["mark"]
        records = self.episodes.table.take(mark >> ID_SHIFT)
        obs, next_obs = (
            self._observation(rows["obs"], records),
            self._observation(rows["next_obs"], records),
        )
        ended, failed = mark & TERMINATED > 0, mark & FAILED > 0
        return Transitions(
            obs, next_obs, rows["action"], rows["reward"], ended, failed, rows["info"], records
        )

    def achieved(self, index: np.ndarray) -> np.ndarray:
        """Return what transitions achieved: their next achieved goals, as a copy."""
        return self.data.reshape(-1)["next_obs"][
            "observation" if self.compact else "achieved_goal"
        ][index]

    def failed(self, index: np.ndarray) -> np.ndarray:
        """Return whether episodes failed at transitions, by index."""
        return (
            self.data.reshape(-1)["mark"][index] & FAILED > 0
        )  # `take` would copy the marks of all rows first

    def get_state(self) -> dict[str, np.ndarray]:
        """Return everything as arrays, the filled part of the rows uncopied."""
        return {"rows": self.data[: self.episodes.steps], "compact": np.array(self.compact)}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Restore a state of as many rows and envs."""
        self._allocate(bool(state["compact"]))
        self.data[: len(state["rows"])] = state["rows"]

    def _allocate(self, compact: bool) -> None:
        self.compact = compact
        left_out = {"achieved_goal", "desired_goal"} if compact else set()
        observed = [(key, *form) for key, form in self.formats.items() if key not in left_out]
        fields = [("obs", observed), ("next_obs", observed), ("action", *self._action)]
        numbers = [
            ("info", np.float64, (self._n_info,)),
            ("reward", np.float32),
            ("mark", np.uint32),
        ]
        dtype = np.dtype([*fields, *numbers])
        self.data = np.zeros((self.episodes.capacity, self.episodes.n_envs), dtype)

    def _widen(self) -> None:
        narrow = self.data
        self._allocate(compact=False)
        for name in ("action", "info", "reward", "mark"):
            self.data[name] = narrow[name]
        records = self.episodes.table[narrow["mark"] >> ID_SHIFT]
        for name in ("obs", "next_obs"):
            for key in narrow[name].dtype.names or ():
                self.data[name][key] = narrow[name][key]
            self.data[name]["achieved_goal"] = narrow[name]["observation"]
            self.data[name]["desired_goal"] = records["goal"]

    def _observation(self, stored: np.ndarray, records: np.ndarray) -> Observation:
        entries = {key: stored[key] for key in stored.dtype.names or ()}
        if self.compact:
            entries |= {"achieved_goal": entries["observation"], "desired_goal": records["goal"]}
        return {key: entries[key] for key in self.formats}
