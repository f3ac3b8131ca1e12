"""Two vectorized envs, side by side."""

import numpy as np


def step_alike(envs, others, actions):
    """Step both with the same actions, and check that they show the same, bit for bit; return
    rewards, dones and infos of each step.
    """
    steps = []
    for action in actions:
        observation, rewards, dones, infos = envs.step(action)
        *others_seen, _ = others.step(action)
        np.testing.assert_equal(others_seen, [observation, rewards, dones])
        steps.append((rewards, dones, infos))
    return steps
