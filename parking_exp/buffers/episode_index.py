"""Index of the episodes in a replay buffer, updated with each transition, so that sampling never
searches.

All envs write into the same row of a ring at each step. Steps are counted from the start; a step's
row is its number modulo the capacity. In each env, the transitions of whole episodes are those from
step `tail` to step `head`.
"""

from collections.abc import Mapping

import numpy as np

NO_EPISODE = -1
ARRAYS = ("tail", "head", "current", "table")


class EpisodeIndex:
    """Episodes in a ring of `capacity` rows, one transition of each of `n_envs` envs in a row.

    A transition's index is row * n_envs + env. An episode has a record in `table` (the `start` row,
    the `length`, 0 while it is under way, and the first desired `goal`), which is reused when its
    last transition is overwritten.

    Attributes:
        steps: rows written since the start.
        tail, head: of each env, the steps between which its whole episodes lie, shape (n_envs,).
        current: record ids of the episodes under way, or NO_EPISODE between two episodes, shape
            (n_envs,).
    """

    def __init__(
        self, capacity: int, n_envs: int, goal_dtype: np.dtype, goal_shape: tuple[int, ...]
    ) -> None:
        self.capacity, self.n_envs = capacity, n_envs
        self.steps = 0
        self.tail, self.head = np.zeros(n_envs, np.int64), np.zeros(n_envs, np.int64)
        self.current = np.full(n_envs, NO_EPISODE)
        self.table = np.zeros(
            0, [("start", np.int32), ("length", np.int32), ("goal", goal_dtype, goal_shape)]
        )
        self._unused: list[int] = []  # record ids

    def __len__(self) -> int:
        """Return the number of stored transitions, of whole episodes or not."""
        return min(self.steps, self.capacity) * self.n_envs

    def start(self, env: int, goal: np.ndarray) -> None:
        """Start an episode with the next row."""
        if not self._unused:  # add half as many records again
            n, more = len(self.table), len(self.table) // 2 + 2 * self.n_envs
            self.table = np.concatenate([self.table, np.zeros(more, self.table.dtype)])
            self._unused = list(range(n + more - 1, n - 1, -1))
        self.current[env] = self._unused.pop()
        self.table[self.current[env]] = (self.steps % self.capacity, 0, goal)

    def overwrite(self, record_ids: np.ndarray) -> None:
        """Remove the transitions that the next row overwrites; `record_ids` are that row's."""
        oldest = self.steps - self.capacity
        if oldest < 0:
            return
        for env in np.flatnonzero(self.tail <= oldest + 1):
            record_id = int(record_ids[env])
            alone = (
                record_id == self.current[env]
            )  # an episode that fills the ring: it loses its beginning
            if self.tail[env] == oldest:
                if alone:
                    self.table["start"][record_id] = (oldest + 1) % self.capacity
                    self.head[env] += 1
                self.tail[env] += 1 if alone else self.table["length"][record_id]
            if self.tail[env] == oldest + 1 and not alone:
                self._unused.append(record_id)

    def finish(self, env: int) -> None:
        """End an episode with the last row."""
        self.table["length"][self.current[env]] = self.steps - self.head[env]
        self.head[env] = self.steps
        self.current[env] = NO_EPISODE

    def draw(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """Draw transitions of whole episodes, all with the same probability; return their indices.

        Raises:
            RuntimeError: no episode has ended yet.
        """
        ends = np.add.accumulate(self.head - self.tail)
        if not ends[-1]:
            raise RuntimeError(
                "HER cannot sample before an episode has ended; set learning_starts to the longest "
                "episode x n_envs"
            )
        positions = rng.integers(ends[-1], size=number)
        env = ends.searchsorted(positions, side="right")
        step = positions - ends.take(env)
        step += self.head.take(env)
        return self.index(step, env)

    def draw_stored(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """Draw from everything that is stored, episodes under way included; return indices.

        Raises:
            RuntimeError: nothing is stored.
        """
        if not self.steps:
            raise RuntimeError("the replay buffer is empty; set learning_starts above 0")
        return rng.integers(len(self), size=number)

    def index(self, step: np.ndarray, env: np.ndarray) -> np.ndarray:
        """Return the indices of transitions."""
        index: np.ndarray = step % self.capacity
        index *= self.n_envs
        index += env
        return index

    def get_state(self) -> dict[str, np.ndarray]:
        """Return everything as arrays."""
        arrays = {name: getattr(self, name).copy() for name in ARRAYS}
        return arrays | {"steps": np.array(self.steps), "unused": np.array(self._unused, np.int32)}

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Restore a state of as many rows and envs."""
        for name in ARRAYS:
            setattr(self, name, state[name].copy())
        self.steps, self._unused = int(state["steps"]), state["unused"].tolist()
