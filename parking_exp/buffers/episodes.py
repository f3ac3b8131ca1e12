"""Which stored transitions belong to which episode, kept up as they come, so that nothing is ever searched for.

Every env writes into the same row of a ring at each step. Steps are counted from the start and never wrap; a step's
row is its number modulo the capacity. In each env the whole episodes that are still stored lie one after another, so
that the interval from `tail` to `head` says which transitions may be drawn.
"""

import numpy as np

NONE = -1
RECORD = np.dtype([("start", np.int64), ("length", np.int64)])


class Episodes:
    """Episodes in a ring of `capacity` rows, one transition of each of `n_envs` envs in a row.

    A transition's index is row * n_envs + env. An episode has a slot in `table`, which is used again when the first of
    its transitions is overwritten.

    Attributes:
        steps: rows written since the start.
        tail, head: of each env, the steps between which its whole episodes lie, shape (n_envs,).
        current: slots of the episodes under way, or NONE between two episodes, shape (n_envs,).
        table: step at which each episode started and its length, 0 while it is under way.
    """

    def __init__(self, capacity: int, n_envs: int) -> None:
        self.capacity, self.n_envs = capacity, n_envs
        self.steps = 0
        self.tail, self.head = np.zeros(n_envs, np.int64), np.zeros(n_envs, np.int64)
        self.current = np.full(n_envs, NONE)
        self.table = np.zeros(2 * n_envs, RECORD)
        self._unused = list(range(2 * n_envs))[::-1]

    def __len__(self) -> int:
        """How many transitions are stored, whole episodes or not."""
        return min(self.steps, self.capacity) * self.n_envs

    def start(self, env: int) -> int:
        """Start an episode, and return its slot."""
        if not self._unused:
            n = len(self.table)
            self.table = np.concatenate([self.table, np.zeros(n, RECORD)])
            self._unused = list(range(n, 2 * n))[::-1]
        slot = self._unused.pop()
        self.table[slot] = (self.steps, 0)
        self.current[env] = slot
        return slot

    def overwrite(self, slots: np.ndarray) -> None:
        """Forget the episodes whose first transition the next row is written over; `slots` are that row's."""
        oldest = self.steps - self.capacity
        if oldest < 0:
            return
        for env in np.flatnonzero(self.tail == oldest):
            slot = int(slots[env])
            if slot == self.current[env]:  # it alone fills the ring: its beginning is lost
                self.table["start"][slot] += 1
                self.tail[env] += 1
                self.head[env] += 1
            else:
                self.tail[env] += self.table["length"][slot]
                self._unused.append(slot)

    def finish(self, env: int) -> None:
        """End an episode with the last row."""
        record = self.table[self.current[env]]
        record["length"] = self.steps - record["start"]
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
        """Draw from everything that is stored, episodes under way included; return indices."""
        return rng.integers(len(self), size=number)

    def index(self, step: np.ndarray, env: np.ndarray) -> np.ndarray:
        """Return the indices of transitions."""
        index: np.ndarray = step % self.capacity
        index *= self.n_envs
        index += env
        return index

    @property
    def slots(self) -> int:
        """How many slots are to be saved: those after them are free."""
        free = np.zeros(len(self.table), bool)
        free[self._unused] = True
        return int(np.flatnonzero(~free)[-1]) + 1 if not free.all() else 1

    def get_state(self) -> dict[str, np.ndarray]:
        """Return everything as arrays."""
        return {
            "steps": np.array(self.steps),
            "tail": self.tail.copy(),
            "head": self.head.copy(),
            "current": self.current.copy(),
            "table": self.table[: self.slots].copy(),
            "unused": np.array(self._unused, np.int32),
            "room": np.array(len(self.table)),
        }

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """Restore a state."""
        self.steps = int(state["steps"])
        self.tail, self.head, self.current = state["tail"].copy(), state["head"].copy(), state["current"].copy()
        self.table = np.zeros(int(state["room"]), RECORD)
        self.table[: len(state["table"])] = state["table"]
        self._unused = state["unused"].tolist()
