"""Save and restore the state outside the model that exact resume needs.

This is the state of random generators, envs and exploration noise, and the logger's pending values.
It is saved and restored at the beginning of a rollout: before that, `learn` resets action noise,
and gSDE samples its matrices.
"""

import random
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.distributions import StateDependentNoiseDistribution
from stable_baselines3.common.noise import ActionNoise, VectorizedActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from parking_exp.tasks import training_envs

MATRICES = ("exploration_mat", "exploration_matrices")
PENDING = ("name_to_value", "name_to_count", "name_to_excluded")


def get_state(model: OffPolicyAlgorithm) -> dict[str, Any]:
    """Return the rollout state of a model: nested dicts and lists of arrays, numbers and texts."""
    assert model.env is not None
    matrices = None
    sde = _sde(model)
    if sde is not None:
        matrices = {name: getattr(sde, name).detach().cpu().numpy() for name in MATRICES}
    accelerator = None
    if model.device.type == "cuda":
        accelerator = torch.cuda.get_rng_state(model.device).numpy()
    return {
        "envs": training_envs.get_state(model.env),
        "python": random.getstate(),
        "numpy": np.random.get_state(legacy=False),
        "torch": torch.get_rng_state().numpy(),
        "accelerator": accelerator,
        "action_space": model.action_space.np_random.bit_generator.state,
        "noise": [_noise_state(noise) for noise in _noises(model.action_noise)],
        "sde": matrices,
        "metrics": {name: dict(getattr(model.logger, name)) for name in PENDING},
    }


def set_state(model: OffPolicyAlgorithm, state: Mapping[str, Any]) -> None:
    """Restore the rollout state of a model of the same config; what follows is identical."""
    assert model.env is not None
    training_envs.set_state(model.env, state["envs"])
    # If no steps remain, `learn` was not called. Then the noise of several envs is not vectorized,
    # and is not needed.
    for env_noise, saved in zip(_noises(model.action_noise), state["noise"], strict=False):
        vars(env_noise).update(saved)
    sde = _sde(model)
    if sde is not None:
        for name in MATRICES:
            setattr(sde, name, torch.as_tensor(state["sde"][name], device=model.device))
    for name in PENDING:
        pending = getattr(model.logger, name)
        pending.clear()
        pending.update(state["metrics"][name])

    # Last, since the code above may sample from them.
    version, numbers, gauss = state["python"]
    random.setstate((version, tuple(numbers), gauss))
    np.random.set_state(state["numpy"])
    torch.set_rng_state(torch.from_numpy(state["torch"]))
    if model.device.type == "cuda":
        torch.cuda.set_rng_state(torch.from_numpy(state["accelerator"]), model.device)
    model.action_space.np_random.bit_generator.state = state["action_space"]


def _sde(model: Any) -> StateDependentNoiseDistribution | None:
    distribution = getattr(model.actor, "action_dist", None)
    return distribution if isinstance(distribution, StateDependentNoiseDistribution) else None


def _noises(noise: ActionNoise | None) -> list[ActionNoise]:
    """Return the noise of each env, or the one that all share."""
    if isinstance(noise, VectorizedActionNoise):
        return noise.noises
    return [] if noise is None else [noise]


def _noise_state(noise: ActionNoise) -> dict[str, Any]:
    """Return the numeric attributes of an action noise, such as its last value `noise_prev`."""
    numbers = (bool, int, float, np.ndarray, np.generic)
    return {name: value for name, value in vars(noise).items() if isinstance(value, numbers)}
