"""Goal-selection strategies of HER: future, final, episode, random (Andrychowicz et al. 2017,
section 4.5).
"""

from collections.abc import Callable

import numpy as np

from parking_exp.buffers.episode_index import EpisodeIndex

Strategy = Callable[[np.random.Generator, EpisodeIndex, np.ndarray, np.ndarray], np.ndarray]


def future(
    rng: np.random.Generator, episodes: EpisodeIndex, index: np.ndarray, record: np.ndarray
) -> np.ndarray:
    """Take goals from the rest of the same episode, the transition itself included, as
    Stable-Baselines3 does.

    `index` are transitions and `record` their episodes in `episodes.table`, both of shape (n,).
    Returns the indices of the transitions whose next achieved goals become the virtual goals, shape
    (n,).
    """
    row, env = np.divmod(index, episodes.n_envs)
    passed = (row - record["start"]) % episodes.capacity
    return episodes.index(record["start"] + rng.integers(passed, record["length"]), env)


def final(
    rng: np.random.Generator, episodes: EpisodeIndex, index: np.ndarray, record: np.ndarray
) -> np.ndarray:
    """Take the last goal of the same episode; see `future`."""
    last = record["length"].astype(np.int64) - 1
    return episodes.index(record["start"] + last, index % episodes.n_envs)


def episode(
    rng: np.random.Generator, episodes: EpisodeIndex, index: np.ndarray, record: np.ndarray
) -> np.ndarray:
    """Take goals from anywhere in the same episode; see `future`."""
    return episodes.index(record["start"] + rng.integers(record["length"]), index % episodes.n_envs)


def random(
    rng: np.random.Generator, episodes: EpisodeIndex, index: np.ndarray, record: np.ndarray
) -> np.ndarray:
    """Take goals from all stored transitions, episodes under way included; see `future`."""
    return episodes.draw_stored(rng, len(index))


STRATEGIES: dict[str, Strategy] = {
    "future": future,
    "final": final,
    "episode": episode,
    "random": random,
}
"""Values of `buffer.goal_selection_strategy`. A new one: a name in `config.argument_limits`, a
function of that name here, and a file in conf/buffer."""
