"""Index of the episodes in a replay buffer, so that sampling never searches.

All envs write into the same row of a ring at each step. Steps are counted from the start. The row
of a step is its number modulo the capacity. In each env, the transitions of whole episodes are
those from step `tail` to step `head`.
"""

from collections.abc import Mapping

import numpy as np

NO_EPISODE = -1


class EpisodeIndex:
    """Episodes in a ring of `capacity` rows, one transition of each of `n_envs` envs in a row.

    A transition's index is row * n_envs + env. An episode has a record in `table`: the `start` row,
    the `length`, 0 while it is under way, and the first desired `goal`. A record is used again when
    the last transition of its episode was overwritten.

    Attributes:
        steps: rows written since the start.
        tail, head: the steps of each env between which its whole episodes lie, shape (n_envs,).
        current: record ids of the episodes under way, or NO_EPISODE between two episodes, shape
            (n_envs,).
    """

    def __init__(self, capacity: int, n_envs: int, goal_format: tuple) -> None:
        self.capacity = capacity
        self.n_envs = n_envs
        self.steps = 0
        self.tail = np.zeros(n_envs, np.int64)
        self.head = np.zeros(n_envs, np.int64)
        self.current = np.full(n_envs, NO_EPISODE)
        # As many records as transitions; `np.zeros` takes memory only where one is written.
        record = [("start", np.int32), ("length", np.int32), ("goal", *goal_format)]
        self.table = np.zeros((capacity + 1) * n_envs, record)
        self._n_records = 0
        self._free: list[int] = []  # ids of records to use again

    def __len__(self) -> int:
        """Return the number of stored transitions, of whole episodes or not."""
        return min(self.steps, self.capacity) * self.n_envs

    def start(self, env: int, goal: np.ndarray) -> None:
        """Start an episode with the next row."""
        if self._free:
            record_id = self._free.pop()
        else:
            record_id = self._n_records
            self._n_records += 1
        self.table[record_id] = (self.steps % self.capacity, 0, goal)
        self.current[env] = record_id

    def overwrite(self, record_ids: np.ndarray) -> None:
        """Make room for the next row if the ring is full.

        A finished episode that loses a transition is no longer sampled. An unfinished episode only
        loses its start.

        Args:
            record_ids: records of the transitions that are overwritten, shape (n_envs,).
        """
        oldest = self.steps - self.capacity
        if oldest < 0:
            return
        for env in np.flatnonzero(self.tail <= oldest + 1):
            record_id = int(record_ids[env])
            if record_id == self.current[env]:  # it fills the ring, and loses its beginning
                self.table["start"][record_id] = (oldest + 1) % self.capacity
                self.head[env] += 1
                self.tail[env] += 1
                continue
            if self.tail[env] == oldest:
                self.tail[env] += self.table["length"][record_id]
            if self.tail[env] == oldest + 1:
                self._free.append(record_id)

    def finish(self, env: int) -> None:
        """End an episode with the last row."""
        self.table["length"][self.current[env]] = self.steps - self.head[env]
        self.head[env] = self.steps
        self.current[env] = NO_EPISODE

    def sample(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """Sample transitions of whole episodes, all with the same probability; return indices.

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

    def sample_stored(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """Sample from everything that is stored, episodes under way included; return indices."""
        return rng.integers(len(self), size=number)

    def index(self, step: np.ndarray, env: np.ndarray) -> np.ndarray:
        """Return the indices of transitions."""
        index: np.ndarray = step % self.capacity
        index *= self.n_envs
        index += env
        return index

    def get_state(self) -> dict[str, np.ndarray]:
        """Return everything as arrays, uncopied."""
        return {
            "steps": np.array(self.steps),
            "tail": self.tail,
            "head": self.head,
            "current": self.current,
            "table": self.table[: self._n_records],
            "free": np.array(self._free, np.int32),
        }

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Restore a state of as many rows and envs."""
        self.steps = int(state["steps"])
        for name in ("tail", "head", "current"):
            setattr(self, name, state[name].copy())
        self._n_records = len(state["table"])
        self.table[: self._n_records] = state["table"]
        self._free = state["free"].tolist()
