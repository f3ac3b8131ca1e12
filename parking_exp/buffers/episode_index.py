"""Index of the episodes in a replay buffer, updated with each transition, so that sampling never searches.

Every env writes into the same row of a ring at each step. Steps are counted from the start and never wrap; a step's
row is its number modulo the capacity. In each env the whole episodes that are still stored lie one after another, so
that the interval from `tail` to `head` says which transitions may be drawn.
"""

import numpy as np

NONE = -1
RECORD = np.dtype([("start", np.int32), ("length", np.int32)])


class EpisodeIndex:
    """Episodes in a ring of `capacity` rows, one transition of each of `n_envs` envs in a row.

    A transition's index is row * n_envs + env. An episode has a record in `table`, at its record id, which is used
    again when the last of its transitions is overwritten.

    Attributes:
        steps: rows written since the start.
        tail, head: of each env, the steps between which its whole episodes lie, shape (n_envs,).
        current: record ids of the episodes under way, or NONE between two episodes, shape (n_envs,).
        table: row in which each episode started and its length, 0 while it is under way.
    """

    def __init__(self, capacity: int, n_envs: int) -> None:
        self.capacity, self.n_envs = capacity, n_envs
        self.steps = 0
        self.tail, self.head = np.zeros(n_envs, np.int64), np.zeros(n_envs, np.int64)
        self.current = np.full(n_envs, NONE)
        self.table = np.zeros(0, RECORD)
        self._unused, self._n_unused = np.zeros(0, np.int32), 0  # a stack, and how much of it counts

    def __len__(self) -> int:
        """Return the number of stored transitions, of whole episodes or not."""
        return min(self.steps, self.capacity) * self.n_envs

    @property
    def nbytes(self) -> int:
        """Bytes of memory."""
        return self.table.nbytes + self._unused.nbytes

    def start(self, env: int) -> int:
        """Start an episode with the next row, and return its record id."""
        if not self._n_unused:
            self._grow()
        self._n_unused -= 1
        record_id = int(self._unused[self._n_unused])
        self.table[record_id] = (self.steps % self.capacity, 0)
        self.current[env] = record_id
        return record_id

    def overwrite(self, record_ids: np.ndarray) -> None:
        """Forget the transitions that the next row overwrites; `record_ids` are that row's.

        An episode is whole until its first transition is overwritten, and has its record until its last is.
        """
        oldest = self.steps - self.capacity
        if oldest < 0:
            return
        for env in np.flatnonzero(self.tail <= oldest + 1):
            record_id = int(record_ids[env])
            alone = record_id == self.current[env]  # an episode that fills the ring: it loses its beginning
            if self.tail[env] == oldest:
                if alone:
                    self.table["start"][record_id] = (oldest + 1) % self.capacity
                    self.head[env] += 1
                self.tail[env] += 1 if alone else self.table["length"][record_id]
            if self.tail[env] == oldest + 1 and not alone:
                self._unused[self._n_unused] = record_id
                self._n_unused += 1

    def finish(self, env: int) -> None:
        """End an episode with the last row."""
        self.table["length"][self.current[env]] = self.steps - self.head[env]
        self.head[env] = self.steps
        self.current[env] = NONE

    def draw(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """Draw transitions of whole episodes, all with the same probability; return their indices.

        Raises:
            RuntimeError: no episode has ended yet.
        """
        ends = np.add.accumulate(self.head - self.tail)
        if not ends[-1]:
            raise RuntimeError(
                "HER can't sample before the first episode has ended; give a learning_starts of at least "
                "the longest episode x n_envs"
            )
        drawn = rng.integers(ends[-1], size=number)
        env = ends.searchsorted(drawn, side="right")
        step = drawn - ends.take(env)
        step += self.head.take(env)
        return self.index(step, env)

    def draw_stored(self, rng: np.random.Generator, number: int) -> np.ndarray:
        """Draw from everything that is stored, episodes under way included; return indices.

        Raises:
            RuntimeError: nothing is stored.
        """
        if not self.steps:
            raise RuntimeError("there is nothing to sample yet; give a learning_starts above 0")
        return rng.integers(len(self), size=number)

    def index(self, step: np.ndarray, env: np.ndarray) -> np.ndarray:
        """Return the indices of transitions."""
        index: np.ndarray = step % self.capacity
        index *= self.n_envs
        index += env
        return index

    @property
    def n_records(self) -> int:
        """Number of records that must be saved: those after them are unused."""
        free = np.zeros(len(self.table), bool)
        free[self._unused[: self._n_unused]] = True
        taken = np.flatnonzero(~free)
        return int(taken[-1]) + 1 if len(taken) else 0

    def get_state(self) -> dict[str, np.ndarray]:
        """Return everything as arrays."""
        return {
            "capacity": np.array(self.capacity),
            "steps": np.array(self.steps),
            "tail": self.tail.copy(),
            "head": self.head.copy(),
            "current": self.current.copy(),
            "table": self.table[: self.n_records].copy(),
            "unused": self._unused[: self._n_unused].copy(),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore a state of as many rows and envs."""
        self.steps = int(state["steps"])
        self.tail, self.head, self.current = state["tail"].copy(), state["head"].copy(), state["current"].copy()
        # A record is used or unused: together that is how many there are.
        self._n_unused = len(state["unused"])
        taken, beyond = len(state["table"]), state["unused"][state["unused"] >= len(state["table"])]
        self.table = np.zeros(taken + len(beyond), RECORD)
        self.table[:taken] = state["table"]
        self._unused = np.zeros(len(self.table), np.int32)
        self._unused[: self._n_unused] = state["unused"]

    def _grow(self) -> None:
        """Add half as many records again, to be used from the lowest on."""
        n = len(self.table)
        more = n // 2 + 2 * self.n_envs
        self.table = np.concatenate([self.table, np.zeros(more, RECORD)])
        self._unused = np.zeros(n + more, np.int32)
        self._unused[:more] = np.arange(n + more - 1, n - 1, -1)
        self._n_unused = more
