"""Two vectorized envs, side by side."""

import numpy as np


def step_alike(envs, others, actions):
    """Step both with the same actions, and check that they show the same, bit for bit; return
    rewards, dones and infos of each step.
    """
    steps = []
    for action in actions:
        observation, rewards, dones, infos = envs.step(action)
        other_observation, other_rewards, other_dones, _ = others.step(action)
        for key, values in observation.items():
            np.testing.assert_array_equal(other_observation[key], values)
        np.testing.assert_array_equal(other_rewards, rewards)
        np.testing.assert_array_equal(other_dones, dones)
        steps.append((rewards, dones, infos))
    return steps
