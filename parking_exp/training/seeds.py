"""Seeds of a run's random generators, and of the episodes that are cross-checked."""

from dataclasses import dataclass

import numpy as np

from parking_exp.config.schema import RunConfig


@dataclass(frozen=True)
class RunSeeds:
    """Seeds of one run's random generators."""

    # Weights, exploration and minibatches (Python, NumPy and torch), below 2**31.
    policy: int
    # Seed of the first training env; env i gets this + i. Evaluations use none of these seeds.
    training_envs: int
    # Samples the episodes of the final evaluation that are cross-checked.
    cross_check: int


def derive_seeds(seed: int, training_seeds: range) -> RunSeeds:
    """Derive the seeds of a run's independent random generators from its one seed.

    Args:
        seed: the run's seed.
        training_seeds: the task's seeds; the first training env gets one of them.
    """
    policy, training, cross_check = np.random.SeedSequence(seed).generate_state(3).tolist()
    return RunSeeds(policy % 2**31, training_seeds[training % len(training_seeds)], cross_check)


def cross_checked_seeds(config: RunConfig) -> list[int]:
    """Return the seeds of the final episodes that are repeated on the reference simulator, sorted.

    They are sampled with the run's seed, so that a sweep covers many. On the reference itself, all
    are returned.
    """
    seeds = config.evaluation.seeds(config.evaluation.final_n_scenes)
    rng = np.random.default_rng(derive_seeds(config.seed, config.env.training_seeds).cross_check)
    return sorted(rng.choice(seeds, config.n_cross_checked, replace=False).tolist())
