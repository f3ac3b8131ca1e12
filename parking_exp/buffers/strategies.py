"""Goal-selection strategies of HER (Andrychowicz et al. 2017, section 4.5).

Each takes a random generator, the index of episodes, the indices of transitions, and the records of
their episodes in `EpisodeIndex.table`, both of shape (n,). It returns the indices of the
transitions whose next achieved goals become the virtual goals, shape (n,).
"""

from collections.abc import Callable

import numpy as np

from parking_exp.buffers.episode_index import EpisodeIndex
from parking_exp.config_model import GoalStrategy

Strategy = Callable[[np.random.Generator, EpisodeIndex, np.ndarray, np.ndarray], np.ndarray]


def future(
    rng: np.random.Generator, episodes: EpisodeIndex, index: np.ndarray, record: np.ndarray
) -> np.ndarray:
    """Take goals from the rest of the same episode.

    As in Stable-Baselines3, the transition itself is included.
    """
    row, env = np.divmod(index, episodes.n_envs)
    passed = (row - record["start"]) % episodes.capacity
    return episodes.index(record["start"] + rng.integers(passed, record["length"]), env)


def final(
    rng: np.random.Generator, episodes: EpisodeIndex, index: np.ndarray, record: np.ndarray
) -> np.ndarray:
    """Take the last goal of the same episode."""
    last = record["length"].astype(np.int64) - 1
    return episodes.index(record["start"] + last, index % episodes.n_envs)


def episode(
    rng: np.random.Generator, episodes: EpisodeIndex, index: np.ndarray, record: np.ndarray
) -> np.ndarray:
    """Take goals from anywhere in the same episode."""
    return episodes.index(record["start"] + rng.integers(record["length"]), index % episodes.n_envs)


def random(
    rng: np.random.Generator, episodes: EpisodeIndex, index: np.ndarray, record: np.ndarray
) -> np.ndarray:
    """Take goals from all stored transitions, episodes under way included."""
    return episodes.sample_stored(rng, len(index))


STRATEGIES: dict[GoalStrategy, Strategy] = {
    "future": future,
    "final": final,
    "episode": episode,
    "random": random,
}
