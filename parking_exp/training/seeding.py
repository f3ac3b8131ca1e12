"""Derive the seeds of a run's independent random generators from its one seed."""

from dataclasses import dataclass

import numpy as np

from parking_exp.config.schema import TRAINING_SCENES_START


@dataclass(frozen=True)
class Seeds:
    """Seeds of one run's random generators."""

    policy: int
    """Weights, exploration and minibatches (Python, NumPy and torch), below 2**31."""
    training_scenes: int
    """Seed of the first training env; env i gets this + i. At least 2**31, where no evaluation scene lies."""


def derive_seeds(seed: int) -> Seeds:
    """Derive a run's seeds."""
    policy, scenes = np.random.SeedSequence(seed).generate_state(2)
    return Seeds(policy=int(policy) % 2**31, training_scenes=TRAINING_SCENES_START + int(scenes) % 2**31)
