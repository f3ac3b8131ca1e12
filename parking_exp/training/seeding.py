"""Derive the seeds of a run's independent random generators from its one seed."""

from dataclasses import dataclass

import numpy as np

from parking_exp.config.schema import TRAINING_SCENES_START


@dataclass(frozen=True)
class Seeds:
    """Seeds of one run's random generators."""

    policy: int  # weights, exploration and minibatches (Python, NumPy and torch), below 2**31
    training_scenes: int  # of the first training env; env i gets this + i. At least 2**31: no evaluation scene
    certified_scenes: int  # draws the scenes of the final evaluation that are certified


def derive_seeds(seed: int) -> Seeds:
    """Derive a run's seeds."""
    policy, scenes, certified = np.random.SeedSequence(seed).generate_state(3).tolist()
    return Seeds(policy % 2**31, TRAINING_SCENES_START + scenes % 2**31, certified)
