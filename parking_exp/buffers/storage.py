"""Storage of transitions: all fields of one lie together, so that reading it is one memory access."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.preprocessing import get_action_dim, get_obs_shape

TERMINATED, CRASHED, ID_SHIFT = 1, 2, 2  # bits of `mark`; above them is the id of the episode's record
Observation = dict[str, np.ndarray]


class Storage:
    """Ring buffer of `capacity` rows, each with one transition of each of `n_envs` envs.

    Storage is compact as long as it can be: it leaves out an achieved goal that is the observation itself, as in
    parking-v0, and keeps a desired goal that stays the same in an episode once for each. The first transition that is
    otherwise widens all rows.

    A transition of parking-v0 takes 112 bytes: 2 x 6 doubles, 2 + 1 floats, and a mark; its episode's goal, 48.
    """

    def __init__(self, capacity: int, n_envs: int, observation_space: spaces.Dict, action_space: spaces.Space) -> None:
        self.capacity, self.n_envs = capacity, n_envs
        shapes: dict[str, tuple[int, ...]] = get_obs_shape(observation_space)  # type: ignore[assignment]
        self.formats = {key: (space.dtype, shapes[key]) for key, space in observation_space.spaces.items()}
        self._action = (ReplayBuffer._maybe_cast_dtype(action_space.dtype), (get_action_dim(action_space),))
        dtype, shape = self.formats["desired_goal"]
        self.goals = np.zeros((0, *shape), dtype)
        self._allocate(compact=self.formats["achieved_goal"] == self.formats["observation"])

    @property
    def nbytes(self) -> int:
        """Bytes of memory, when full."""
        return self.data.nbytes + self.goals.nbytes

    def shaped(self, obs: Mapping[str, Any]) -> Observation:
        """Return observations with the types and shapes of the space, each entry (n_envs, ...)."""
        return {
            key: np.asarray(obs[key], dtype).reshape(self.n_envs, *shape)
            for key, (dtype, shape) in self.formats.items()
        }

    def start(self, record_id: int, goal: np.ndarray) -> None:
        """Keep the desired goal of an episode that starts."""
        if record_id >= len(self.goals):
            more = np.zeros((record_id // 2 + 2 * self.n_envs, *self.goals.shape[1:]), self.goals.dtype)
            self.goals = np.concatenate([self.goals[:record_id], more])
        self.goals[record_id] = goal

    def other_goals(self, obs: Observation, record_ids: np.ndarray) -> np.ndarray:
        """Return the envs whose goal is not the one their episode started with; none where storage is not compact."""
        if not self.compact:
            return np.empty(0, np.int64)
        differs = obs["desired_goal"] != self.goals.take(record_ids, axis=0)
        return np.flatnonzero(differs.reshape(self.n_envs, -1).any(axis=1))

    def write(
        self,
        row: int,
        obs: Observation,
        next_obs: Observation,
        action: np.ndarray,
        reward: np.ndarray,
        record_ids: np.ndarray,
        terminated: np.ndarray,
        crashed: np.ndarray,
    ) -> None:
        """Write a row: a transition of each env, in the episodes with these record ids."""
        if self.compact and not self._fits(obs, next_obs, record_ids):
            self._widen()
        for key in self.stored:
            self._obs[key][row] = obs[key]
            self._next_obs[key][row] = next_obs[key]
        self._fields["action"][row] = np.reshape(action, (self.n_envs, -1))
        self._fields["reward"][row] = reward
        self._fields["mark"][row] = record_ids << ID_SHIFT | crashed * CRASHED | terminated * TERMINATED

    def record_ids(self, row: int) -> np.ndarray:
        """Return the record ids of a row's episodes, shape (n_envs,)."""
        record_ids: np.ndarray = self._fields["mark"][row] >> ID_SHIFT
        return record_ids

    def end(self, row: int, env: int, terminated: bool) -> None:
        """Note how a transition ends its episode."""
        id_and_crash = self._fields["mark"][row, env] // CRASHED * CRASHED
        self._fields["mark"][row, env] = id_and_crash | terminated * TERMINATED

    def take(self, index: np.ndarray) -> "Transitions":
        """Return transitions by index, row * n_envs + env, as a copy."""
        return Transitions(self, self.data.reshape(-1).take(index))

    def achieved(self, index: np.ndarray) -> np.ndarray:
        """Return what transitions achieved: their next achieved goals, as a copy."""
        next_obs = self.data.reshape(-1)["next_obs"]
        found: np.ndarray = next_obs["observation" if self.compact else "achieved_goal"][index]
        return found

    def crashed(self, index: np.ndarray) -> np.ndarray:
        """Return whether transitions crashed, by index."""
        mark = self.data.reshape(-1)["mark"][index]  # `take` would copy the marks of all rows first
        found: np.ndarray = mark & CRASHED > 0
        return found

    def get_state(self, rows: int, n_records: int) -> dict[str, np.ndarray]:
        """Return the first rows, and the goals of the first records, as arrays, uncopied."""
        return {"rows": self.data[:rows], "goals": self.goals[:n_records], "compact": np.array(self.compact)}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Restore a state.

        Raises:
            ValueError: it is of other spaces or another number of envs; nothing has changed.
        """
        compact, rows, goals = bool(state["compact"]), state["rows"], state["goals"]
        if (
            rows.dtype != self._dtype(compact)
            or rows.shape[1] != self.n_envs
            or goals.shape[1:] != self.goals.shape[1:]
        ):
            raise ValueError("the saved buffer is of other spaces or another number of envs")
        self._allocate(compact)
        self.data[: len(rows)] = rows
        self.goals = goals.copy()

    def _allocate(self, compact: bool) -> None:
        self.compact = compact
        self.data = np.zeros((self.capacity, self.n_envs), self._dtype(compact))
        self._fields = {name: self.data[name] for name in ("action", "reward", "mark")}
        self.stored = self._stored(compact)
        self._obs, self._next_obs = ({key: self.data[name][key] for key in self.stored} for name in ("obs", "next_obs"))

    def _stored(self, compact: bool) -> list[str]:
        left_out = {"achieved_goal", "desired_goal"} if compact else set()
        return [key for key in self.formats if key not in left_out]

    def _dtype(self, compact: bool) -> np.dtype:
        observed = [(key, *self.formats[key]) for key in self._stored(compact)]
        return np.dtype(
            [
                ("obs", observed),
                ("next_obs", observed),
                ("action", *self._action),
                ("reward", np.float32),
                ("mark", np.uint32),
            ]
        )

    def _fits(self, obs: Observation, next_obs: Observation, record_ids: np.ndarray) -> bool:
        return (
            np.array_equal(obs["achieved_goal"], obs["observation"])
            and np.array_equal(next_obs["achieved_goal"], next_obs["observation"])
            and np.array_equal(next_obs["desired_goal"], self.goals.take(record_ids, axis=0))
        )

    def _widen(self) -> None:
        narrow = self.data
        self._allocate(compact=False)
        for name in ("action", "reward", "mark"):
            self.data[name] = narrow[name]
        goals = self.goals[narrow["mark"] >> ID_SHIFT]
        for name in ("obs", "next_obs"):
            for key in narrow[name].dtype.names or ():
                self.data[name][key] = narrow[name][key]
            self.data[name]["achieved_goal"] = narrow[name]["observation"]
            self.data[name]["desired_goal"] = goals


class Transitions:
    """n transitions that were taken from the storage.

    Attributes:
        actions: shape (n, actions).
        rewards: shape (n,).
        terminated, crashed: booleans, shape (n,).
        record_ids: of their episodes, shape (n,).
    """

    def __init__(self, storage: Storage, data: np.ndarray) -> None:
        self._storage, self._data = storage, data
        mark = data["mark"]
        self.actions, self.rewards = data["action"], data["reward"]
        self.terminated, self.crashed = mark & TERMINATED > 0, mark & CRASHED > 0
        self.record_ids = mark >> ID_SHIFT

    def goals(self, rows: np.ndarray) -> np.ndarray:
        """Return the desired goals that some of the transitions had in the env, by row."""
        if self._storage.compact:
            goals: np.ndarray = self._storage.goals.take(self.record_ids[rows], axis=0)
            return goals
        return self._data["obs"]["desired_goal"][rows]

    def achieved(self, number: int) -> np.ndarray:
        """Return what was achieved before each of the last transitions, `number` of them."""
        found: np.ndarray = self._data["obs"]["observation" if self._storage.compact else "achieved_goal"][-number:]
        return found

    def observations(self, virtual: np.ndarray) -> tuple[Observation, Observation]:
        """Return the Dict observations before and after the transitions; each entry has shape (n, ...).

        The last transitions get the virtual goals, which may be none.
        """
        storage, real = self._storage, len(self._data) - len(virtual)
        goals = None
        if storage.compact:
            goals = np.empty((len(self._data), *storage.goals.shape[1:]), storage.goals.dtype)
            goals[:real], goals[real:] = storage.goals.take(self.record_ids[:real], axis=0), virtual
        before, after = (self._observation(name, goals) for name in ("obs", "next_obs"))
        if goals is None:
            before["desired_goal"][real:] = after["desired_goal"][real:] = virtual
        return before, after

    def _observation(self, name: str, goals: np.ndarray | None) -> Observation:
        found: dict[str, Any] = {key: self._data[name][key] for key in self._storage.stored}
        if goals is not None:
            found |= {"achieved_goal": found["observation"], "desired_goal": goals}
        return {key: found[key] for key in self._storage.formats}
