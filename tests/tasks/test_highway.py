"""highway-env as the reference of the cross-check."""

import numpy as np
import pytest
from support.runs import parking_envs

from parking_exp.config.compose import compose
from parking_exp.tasks.env_batch import EnvBatch
from parking_exp.tasks.parking.highway import HighwayBatch, make_parking_env

SCENES = range(3)
MAX_STEPS = 60


@pytest.mark.parametrize("option", parking_envs())
def test_what_the_cross_check_leaves_out_changes_no_bit_of_a_step(option):
    config = compose(f"env={option}").env
    batch = HighwayBatch(config, SCENES)
    plain = EnvBatch([make_parking_env(config) for _ in SCENES], SCENES, "crashed")
    rng = np.random.default_rng(0)
    bias = rng.uniform(-1, 1, (len(SCENES), 2))
    for _ in range(MAX_STEPS):
        actions = np.clip(bias + rng.normal(0, 0.3, bias.shape), -1, 1).astype(np.float32)
        ours = batch.step(actions)
        theirs = plain.step(actions)
        np.testing.assert_equal(ours, theirs)
        np.testing.assert_equal(cars(batch), cars(plain))
        going_on = ~(theirs.terminated | theirs.truncated)
        batch.keep(going_on)
        plain.keep(going_on)
        bias = bias[going_on]
        if not len(plain):
            break


def cars(batch):
    """Return position, heading and speed of all vehicles of all envs."""
    states = []
    for env in batch.envs:
        for car in env.unwrapped.road.vehicles:
            states.append((*car.position, car.heading, car.speed))
    return states
