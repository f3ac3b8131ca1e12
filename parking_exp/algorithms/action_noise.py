"""Exploration noise of actions, made from a config."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from hydra.utils import instantiate
from numpy.typing import DTypeLike
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise, VectorizedActionNoise
from stable_baselines3.common.vec_env import VecEnv


class EpsilonRandomActionNoise(NormalActionNoise):
    """Sample normal noise, or with probability `epsilon` uniform noise in [-2, 2].

    HER's authors add random actions (Plappert et al. 2018, arXiv:1802.09464, appendix), because
    normal noise alone seldom leads a robot's gripper to a box. Noise can't replace an action that
    it does not know. So it is uniform in [-2, 2], and Stable-Baselines3 clips the sum to [-1, 1].
    Half of the sums are then uniform in [-1, 1]. The others lie at a bound.

    Args:
        mean: the mean of the normal noise, shape (actions,).
        sigma: its standard deviation, shape (actions,).
        epsilon: probability of a random action at each step, in [0, 1].
        dtype: the type of the noise.
    """

    def __init__(
        self, mean: np.ndarray, sigma: np.ndarray, epsilon: float, dtype: DTypeLike = np.float32
    ) -> None:
        super().__init__(mean, sigma, dtype)
        self.epsilon = epsilon

    def __call__(self) -> np.ndarray:
        """Return noise of shape (actions,)."""
        noise = super().__call__()
        if np.random.random() < self.epsilon:
            return np.random.uniform(-2, 2, noise.shape).astype(noise.dtype)
        return noise


class VectorizedNormalNoise(VectorizedActionNoise):
    """Normal noise of several envs, sampled in one call. The numbers are Stable-Baselines3's."""

    base_noise: NormalActionNoise

    def __call__(self) -> np.ndarray:
        """Return noise of shape (n_envs, actions)."""
        base = self.base_noise
        shape = (self.n_envs, len(base._mu))
        return np.random.normal(base._mu, base._sigma, shape).astype(base._dtype)


def make_action_noise(node: Mapping[str, Any], env: VecEnv) -> ActionNoise:
    """Make action noise from a node with a `_target_`.

    `mean` and `sigma` become arrays. A single number applies to all dimensions of the action.
    """
    arrays = {}
    for name in {"mean", "sigma"} & node.keys():
        value = np.array(node[name], np.float64)
        arrays[name] = np.broadcast_to(value, env.action_space.shape or ())
    make_noise = instantiate({**node, "_partial_": True, "_convert_": "all"})
    noise: ActionNoise = make_noise(**arrays)
    if env.num_envs > 1 and type(noise) is NormalActionNoise:
        return VectorizedNormalNoise(noise, env.num_envs)
    return noise
