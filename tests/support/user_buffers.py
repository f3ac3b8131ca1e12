"""A replay buffer as users write it: HER with a strategy of their own."""

import numpy as np

from parking_exp.buffers import HerBuffer


class NextSecondHer(HerBuffer):
    """Virtual goals from the next five steps of the same episode: a second of parking-v0."""

    def select_goals(self, index, record):
        row, env = np.divmod(index, self.n_envs)
        passed = (row - record["start"]) % self.episodes.capacity
        last = np.minimum(passed + 5, record["length"])
        return self.episodes.index(record["start"] + self.rng.integers(passed, last), env)
