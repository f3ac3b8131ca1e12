"""Transitions in rows: everything that belongs to one lies together, so that reading it costs one trip to memory."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.preprocessing import get_action_dim, get_obs_shape

TERMINATED, CRASHED, SLOT_SHIFT = 1, 2, 2  # bits of `mark`; above them is the episode's slot
Observation = dict[str, np.ndarray]


class Rows:
    """A ring of `capacity` rows, each with one transition of each of `n_envs` envs.

    As long as they can, rows leave out what can be had elsewhere: an achieved goal that is the observation itself, as
    in parking-v0, and a desired goal that stays the same in an episode, which is kept once for each. The first
    transition that is otherwise widens all rows.

    A transition of parking-v0 takes 112 bytes: 2 x 6 doubles, 2 + 1 floats, and a mark.
    """

    def __init__(self, capacity: int, n_envs: int, observation_space: spaces.Dict, action_space: spaces.Space) -> None:
        self.capacity, self.n_envs = capacity, n_envs
        shapes: dict[str, tuple[int, ...]] = get_obs_shape(observation_space)  # type: ignore[assignment]
        self.formats = {key: (space.dtype, shapes[key]) for key, space in observation_space.spaces.items()}
        self._action = (ReplayBuffer._maybe_cast_dtype(action_space.dtype), (get_action_dim(action_space),))
        self.compact = self.formats["achieved_goal"] == self.formats["observation"]
        dtype, shape = self.formats["desired_goal"]
        self.goals = np.zeros((2 * n_envs, *shape), dtype)
        self._allocate()

    @property
    def nbytes(self) -> int:
        """Bytes of memory, when full."""
        return self.data.nbytes + self.goals.nbytes

    def write(
        self,
        row: int,
        obs: Observation,
        next_obs: Observation,
        action: np.ndarray,
        reward: np.ndarray,
        slots: np.ndarray,
        terminated: np.ndarray,
        crashed: np.ndarray,
    ) -> None:
        """Write a row: a transition of each env, in the episodes with these slots."""
        obs, next_obs = self._shaped(obs), self._shaped(next_obs)
        if self.compact and not self._fits(obs, next_obs, slots):
            self._widen()
        for key in self.stored:
            self._fields[key][row] = obs[key]
            self._fields[f"next_{key}"][row] = next_obs[key]
        self._fields["action"][row] = np.reshape(action, (self.n_envs, -1))
        self._fields["reward"][row] = reward
        self._fields["mark"][row] = slots << SLOT_SHIFT | crashed * CRASHED | terminated * TERMINATED

    def start(self, slot: int, env: int, obs: Observation) -> None:
        """Keep the desired goal of an episode that starts."""
        if slot >= len(self.goals):
            self.goals = np.concatenate([self.goals, np.zeros((slot, *self.goals.shape[1:]), self.goals.dtype)])
        self.goals[slot] = obs["desired_goal"][env]

    def slots(self, row: int) -> np.ndarray:
        """Return the slots of a row's episodes, shape (n_envs,)."""
        slots: np.ndarray = self._fields["mark"][row] >> SLOT_SHIFT
        return slots

    def end(self, row: int, env: int, terminated: bool) -> None:
        """Note how a transition ends its episode."""
        slot_and_crash = self._fields["mark"][row, env] // CRASHED * CRASHED
        self._fields["mark"][row, env] = slot_and_crash | terminated * TERMINATED

    def take(self, index: np.ndarray) -> "Transitions":
        """Return transitions by index, row * n_envs + env, as a copy."""
        return Transitions(self, self._flat.take(index))

    def achieved(self, index: np.ndarray) -> np.ndarray:
        """Return what transitions achieved: their next achieved goals, as a copy."""
        found: np.ndarray = self._flat["next_observation" if self.compact else "next_achieved_goal"][index]
        return found

    def get_state(self, rows: int, slots: int) -> dict[str, np.ndarray]:
        """Return the first rows, and the goals of the first slots, as arrays, uncopied."""
        return {"rows": self.data[:rows], "goals": self.goals[:slots], "compact": np.array(self.compact)}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Restore a state.

        Raises:
            ValueError: it does not fit: other spaces, another number of envs, or more rows.
        """
        self.compact = bool(state["compact"])
        self._allocate()
        rows = state["rows"]
        if rows.dtype != self.data.dtype or rows.shape[1] != self.n_envs or len(rows) > self.capacity:
            raise ValueError(
                f"a buffer of {self.capacity} rows x {self.n_envs} envs of {self.data.dtype.itemsize} bytes cannot "
                f"take {rows.shape[0]} x {rows.shape[1]} of {rows.dtype.itemsize}"
            )
        self.goals = state["goals"].copy()
        self.data[: len(rows)] = rows

    def _allocate(self) -> None:
        left_out = {"achieved_goal", "desired_goal"} if self.compact else set()
        self.stored = [key for key in self.formats if key not in left_out]
        observed = [(key, *self.formats[key[5:] if key.startswith("next_") else key]) for key in self._keys()]
        self.data = np.zeros(
            (self.capacity, self.n_envs),
            [*observed, ("action", *self._action), ("reward", np.float32), ("mark", np.uint32)],
        )
        self._flat = self.data.reshape(-1)
        self._fields = {name: self.data[name] for name in self.data.dtype.names or ()}

    def _keys(self) -> Iterator[str]:
        for key in self.stored:
            yield key
            yield f"next_{key}"

    def _shaped(self, obs: Observation) -> Observation:
        return {
            key: np.asarray(obs[key], dtype).reshape(self.n_envs, *shape)
            for key, (dtype, shape) in self.formats.items()
        }

    def _fits(self, obs: Observation, next_obs: Observation, slots: np.ndarray) -> bool:
        goals = self.goals.take(slots, axis=0)
        return all(
            np.array_equal(entries["achieved_goal"], entries["observation"])
            and np.array_equal(entries["desired_goal"], goals)
            for entries in (obs, next_obs)
        )

    def _widen(self) -> None:
        narrow = self._fields
        self.compact = False
        self._allocate()
        for name, values in narrow.items():
            self._fields[name][:] = values
        for prefix in ("", "next_"):
            self._fields[f"{prefix}achieved_goal"][:] = narrow[f"{prefix}observation"]
            self._fields[f"{prefix}desired_goal"][:] = self.goals[narrow["mark"] >> SLOT_SHIFT]


class Transitions:
    """Some transitions, n of them.

    Attributes:
        actions: shape (n, actions).
        rewards: shape (n,).
        terminated, crashed: booleans, shape (n,).
        slots: of their episodes, shape (n,).
    """

    def __init__(self, rows: Rows, data: np.ndarray) -> None:
        self._rows, self._data = rows, data
        mark = data["mark"]
        self.actions, self.rewards = data["action"], data["reward"]
        self.terminated, self.crashed = mark & TERMINATED > 0, mark & CRASHED > 0
        self.slots = mark >> SLOT_SHIFT

    def observations(self, prefix: str, virtual: np.ndarray) -> Observation:
        """Return the Dict observations (prefix "") or those after the transitions ("next_"); entries: shape (n, ...).

        The last transitions get the virtual goals, which may be none.
        """
        data, rows = self._data, self._rows
        found: dict[str, Any] = {key: data[prefix + key] for key in rows.stored}
        if rows.compact:
            real = len(data) - len(virtual)
            goals = np.empty((len(data), *rows.goals.shape[1:]), rows.goals.dtype)
            goals[:real], goals[real:] = rows.goals.take(self.slots[:real], axis=0), virtual
            found |= {"achieved_goal": found["observation"], "desired_goal": goals}
        elif len(virtual):
            found["desired_goal"][-len(virtual) :] = virtual
        return {key: found[key] for key in rows.formats}
