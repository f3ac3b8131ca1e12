"""Check that an algorithm's models are saved and restored exactly, before it trains or is evaluated."""

import io
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from hydra.utils import get_object
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from parking_exp.algorithms.build import build_model, greedy_policy
from parking_exp.algorithms.model_files import (
    BUFFER_ENTRIES,
    PROVEN,
    apply_weights,
    class_path,
    missing,
    reachable,
    read_weights,
    unsaved,
)
from parking_exp.config.schema import RunConfig
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.errors import ConfigError, ModelError

BATCH = 32


def check_saving(config: RunConfig) -> None:
    """Save a model of a config's class, load it into another one, and compare them. Classes in `PROVEN` are passed.

    Raises:
        ConfigError: they differ in a weight or in an action, or the model can't be saved at all.
    """
    target, own_networks = config.algorithm.target, config.algorithm.arguments.get("policy_kwargs")
    if class_path(get_object(target)) in PROVEN and not own_networks:
        return
    env = make_training_envs(config.env, 1)
    try:
        model, other = (build_model(config, env, seed, for_training=False) for seed in (1, 2))
        if problem := difference(model, other, env):
            raise ConfigError(
                f"algorithm._target_={target} can't be saved and restored exactly, and would be evaluated and resumed "
                f"with other weights: {problem}"
            )
    finally:
        env.close()


def difference(model: OffPolicyAlgorithm, other: OffPolicyAlgorithm, env: VecEnv) -> str | None:
    """Load a model's file into another model of the same class, and say in what that still differs then."""
    observations = sample_observations(env.observation_space)
    before, file = model_state(other, observations), io.BytesIO()
    try:
        if names := unsaved(model):
            return missing(names)
        try:
            model.save(file, exclude=BUFFER_ENTRIES)
        except Exception as error:  # of a class that nobody here has seen
            return f"save() fails with {type(error).__name__}: {error}"
        apply_weights(read_weights(file.getvalue(), "its file", model.device), other, "its file")
    except ModelError as error:
        return str(error)
    saved, restored = model_state(model, observations), model_state(other, observations)
    if changed := sorted(name for name in {*saved, *restored} if saved.get(name) != restored.get(name)):
        return f"{', '.join(changed[:4])} changed on the way"
    if before == saved:
        return "models of two seeds are the same from the start, so that nothing shows that weights are loaded"
    return None


def model_state(model: OffPolicyAlgorithm, observations: Any) -> dict[str, Any]:
    """Return as bytes all tensors of a model, those of its optimizers, and its actions."""
    found = {"the deterministic action": _exact(greedy_policy(model)(observations))}
    for name, one in reachable(model):
        if isinstance(one, torch.Tensor):
            found[name] = _exact(one)
        else:
            found |= {
                f"{name}.{number}.{key}": _exact(value)
                for number, values in one.state_dict()["state"].items()
                for key, value in values.items()
            }
    return found


def _exact(value: Any) -> Any:
    array = value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
    return array.dtype.str, array.shape, array.tobytes()


def sample_observations(space: spaces.Space) -> Any:
    """Return a batch of random observations, always the same."""
    rng = np.random.default_rng(0)
    if isinstance(space, spaces.Dict):
        return {key: rng.standard_normal((BATCH, *(box.shape or ()))).astype(box.dtype) for key, box in space.items()}
    return rng.standard_normal((BATCH, *(space.shape or ()))).astype(space.dtype)
