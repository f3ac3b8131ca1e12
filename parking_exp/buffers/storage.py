"""Storage of transitions: all fields of one lie together, so that reading it is fast."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.preprocessing import get_action_dim, get_obs_shape

from parking_exp.buffers.episode_index import EpisodeIndex
from parking_exp.errors import ModelError
from parking_exp.tasks.task import Observation

# Bits of `mark`. Above them is the id of the episode's record.
TERMINATED = 1
FAILED = 2
ID_SHIFT = 2


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
    """Ring buffer of `capacity` rows, and the index of its episodes.

    A row has one transition of each of `n_envs` envs. Storage is compact while achieved goals equal
    observations, as in parking-v0, and desired goals are constant within an episode. It stores no
    achieved goals then, and one desired goal in the record of each episode. The first transition
    that violates this widens all rows.

    A transition of parking-v0 takes 112 bytes: 2 x 6 doubles, 2 + 1 floats, and a mark. The record
    of its episode takes 56. If K vehicles make the observation wider than a goal, a transition
    takes 304 + 80 K bytes.
    """

    def __init__(
        self,
        capacity: int,
        n_envs: int,
        observation_space: spaces.Dict,
        action_space: spaces.Space,
        n_info: int = 0,
    ) -> None:
        shapes: Any = get_obs_shape(observation_space)
        self.formats = {key: (box.dtype, shapes[key]) for key, box in observation_space.items()}
        self.episodes = EpisodeIndex(capacity, n_envs, self.formats["desired_goal"])
        self._other_fields: list[Any] = [
            ("action", np.float32, (get_action_dim(action_space),)),
            ("info", np.float64, (n_info,)),
            ("reward", np.float32),
            ("mark", np.uint32),
        ]
        self._allocate(compact=self.formats["achieved_goal"] == self.formats["observation"])

    def write(
        self,
        obs: Observation,
        next_obs: Observation,
        action: np.ndarray,
        reward: np.ndarray,
        terminated: np.ndarray,
        failed: np.ndarray,
        info: np.ndarray,
    ) -> None:
        """Write the next row: a transition of each env, in the episodes under way."""
        row = self.episodes.steps % self.episodes.capacity
        self.episodes.overwrite(self.data["mark"][row] >> ID_SHIFT)
        if self.compact and not (self._is_compact(obs) and self._is_compact(next_obs)):
            self._widen()
        rows = self.data[row]
        for key in rows["obs"].dtype.names or ():
            shape = rows["obs"][key].shape
            rows["obs"][key] = np.reshape(obs[key], shape)
            rows["next_obs"][key] = np.reshape(next_obs[key], shape)
        rows["action"] = np.reshape(action, rows["action"].shape)
        rows["reward"] = reward
        rows["info"] = info
        record_ids = self.episodes.current
        rows["mark"] = record_ids << ID_SHIFT | failed * FAILED | terminated * TERMINATED
        self.episodes.steps += 1

    def take(self, index: np.ndarray) -> Transitions:
        """Return transitions by index, row * n_envs + env, as a copy."""
        rows = self.data.reshape(-1).take(index)
        mark = rows["mark"]
        records = self.episodes.table.take(mark >> ID_SHIFT)
        return Transitions(
            self._observation(rows["obs"], records),
            self._observation(rows["next_obs"], records),
            rows["action"],
            rows["reward"],
            mark & TERMINATED > 0,
            mark & FAILED > 0,
            rows["info"],
            records,
        )

    def achieved(self, index: np.ndarray) -> np.ndarray:
        """Return what transitions achieved: their next achieved goals, as a copy."""
        key = "observation" if self.compact else "achieved_goal"
        return self.data.reshape(-1)["next_obs"][key][index]

    def failed(self, index: np.ndarray) -> np.ndarray:
        """Return whether episodes failed at transitions, by index."""
        # `take` would copy the marks of all rows first.
        return self.data.reshape(-1)["mark"][index] & FAILED > 0

    def get_state(self) -> dict[str, np.ndarray]:
        """Return everything as arrays, uncopied."""
        rows = self.data[: self.episodes.steps]
        return {"rows": rows, "compact": np.array(self.compact), **self.episodes.get_state()}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Restore a state of as many rows and envs.

        Raises:
            ModelError: its transitions have other fields.
        """
        self._allocate(bool(state["compact"]))
        rows = state["rows"]
        if rows.dtype != self.data.dtype:
            raise ModelError("the stored replay buffer has transitions with other fields")
        self.data[: len(rows)] = rows
        self.episodes.set_state(state)

    def _allocate(self, compact: bool) -> None:
        self.compact = compact
        observed = [(key, *form) for key, form in self.formats.items()]
        if compact:
            left_out = ("achieved_goal", "desired_goal")
            observed = [field for field in observed if field[0] not in left_out]
        dtype = np.dtype([("obs", observed), ("next_obs", observed), *self._other_fields])
        self.data = np.zeros((self.episodes.capacity, self.episodes.n_envs), dtype)

    def _is_compact(self, obs: Observation) -> bool:
        """Return whether observations of the episodes under way may be stored compactly."""
        goals = self.episodes.table["goal"][self.episodes.current]
        return np.array_equal(obs["achieved_goal"], obs["observation"]) and np.array_equal(
            obs["desired_goal"], goals
        )

    def _widen(self) -> None:
        narrow = self.data
        self._allocate(compact=False)
        for name, *_ in self._other_fields:
            self.data[name] = narrow[name]
        goals = self.episodes.table["goal"][narrow["mark"] >> ID_SHIFT]
        for name in ("obs", "next_obs"):
            for key in narrow[name].dtype.names or ():
                self.data[name][key] = narrow[name][key]
            self.data[name]["achieved_goal"] = narrow[name]["observation"]
            self.data[name]["desired_goal"] = goals

    def _observation(self, stored: np.ndarray, records: np.ndarray) -> Observation:
        entries = {key: stored[key] for key in stored.dtype.names or ()}
        if self.compact:
            entries["achieved_goal"] = entries["observation"]
            entries["desired_goal"] = records["goal"]
        return {key: entries[key] for key in self.formats}
