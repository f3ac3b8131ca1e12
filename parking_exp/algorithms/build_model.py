"""Build a Stable-Baselines3 model from a config.

Callbacks, trackers and launchers of a config are instantiated where they are used: in
`training/training_session.py`, `training/trackers.py` and `sweeps/launchers.py`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from hydra.utils import instantiate
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.save_util import recursive_getattr
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from parking_exp.algorithms.action_noise import make_action_noise
from parking_exp.algorithms.mirrored_policies import MIRRORED
from parking_exp.algorithms.normalization import NormalizedExtractor, Normalizer
from parking_exp.buffers import HerBuffer
from parking_exp.config.constructor_arguments import CLASS_ARGUMENTS, POLICY, policy_class
from parking_exp.config.schema import RunConfig
from parking_exp.dotted_paths import import_object
from parking_exp.errors import ConfigError, ModelError
from parking_exp.tasks.feature_extractors import SymmetricFeatures
from parking_exp.tasks.task import Observation, Policy, Task


def build_model(
    config: RunConfig, task: Task, env: VecEnv, seed: int, *, for_training: bool = True
) -> OffPolicyAlgorithm:
    """Build the model that a config describes.

    Args:
        config: the run's config.
        task: the run's task, or another with the same spaces.
        env: training envs, or one env of the same spaces. The HER buffer relabels with their
            `goal_reward`.
        seed: the seed of weights, exploration and minibatches.
        for_training: False skips the replay buffer, for a model that only predicts.

    Raises:
        ConfigError: the library refuses an argument, or the algorithm would lose weights when it is
            saved.
    """
    target = config.algorithm.target
    algorithm = import_object(target)
    node = dict(config.algorithm.arguments)
    custom_policy_kwargs = node.pop("policy_kwargs", None) or {}
    noise = node.pop("action_noise", None)

    arguments = instantiate({**node, "_convert_": "all"})
    features = _features_arguments(config, task, env)
    is_mirrored = issubclass(features.get("features_extractor_class", type), SymmetricFeatures)
    arguments["policy"] = MIRRORED[policy_class(algorithm)] if is_mirrored else POLICY
    arguments["policy_kwargs"] = {
        "net_arch": list(config.algorithm.net_arch or ()),
        **features,
        **_instantiate_classes(custom_policy_kwargs),
    }
    arguments["train_freq"], arguments["gradient_steps"] = config.update_round()
    arguments |= _buffer_arguments(config, env) if for_training else PREDICTION_BUFFER
    _skip_compiler_import()
    try:
        if noise is not None:
            arguments["action_noise"] = make_action_noise(noise, env)
        model = algorithm(env=env, seed=seed, device=config.device, **arguments)
    except (TypeError, ValueError, KeyError, AssertionError) as error:
        raise ConfigError(f"algorithm: {target} refuses its arguments: {error}") from error

    if unsaved := _unsaved_weights(model):
        raise ConfigError(
            f"algorithm._target_={target}: model files would lack {', '.join(unsaved)}; name them "
            "in _get_torch_save_params()"
        )
    return model


def _features_arguments(config: RunConfig, task: Task, env: VecEnv) -> dict[str, Any]:
    """Return the policy's features extractor and its arguments; {} for the policy's default."""
    features = task.features(config.algorithm.features)
    if features is None and config.algorithm.normalize:
        assert isinstance(env.observation_space, spaces.Dict)
        normalizer = Normalizer(env.observation_space)
        features = NormalizedExtractor, {"normalizer": normalizer}
    if features is None:
        return {}
    extractor, arguments = features
    return {"features_extractor_class": extractor, "features_extractor_kwargs": arguments}


def _instantiate_classes(policy_kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Return `policy_kwargs` with classes in place of dotted paths and of `_target_` nodes."""
    node = dict(policy_kwargs)
    for name in CLASS_ARGUMENTS.keys() & node.keys():
        if isinstance(node[name], Mapping):
            node[name] = {**node[name], "_partial_": True}
        else:
            node[name] = {"_target_": "hydra.utils.get_class", "path": node[name]}
    return instantiate({**node, "_convert_": "all"})


def _buffer_arguments(config: RunConfig, env: VecEnv) -> dict[str, Any]:
    """Return the arguments of an algorithm that name its replay buffer."""
    buffer_class = import_object(config.buffer.target)
    arguments = dict(config.buffer.arguments)
    if issubclass(buffer_class, HerBuffer):
        (arguments["reward"],) = env.get_attr("goal_reward", 0)
    return {
        "buffer_size": config.buffer.buffer_size,
        "replay_buffer_class": buffer_class,
        "replay_buffer_kwargs": arguments,
    }


class NoReplayBuffer(DictReplayBuffer):
    """The buffer of a model that only predicts: training with it is refused."""

    def add(self, *_: Any) -> None:
        """Refuse a transition."""
        raise ModelError(
            "this model only predicts, since it has no replay buffer; parking_exp.train() trains a "
            "run, and Stable-Baselines3's load() reads models/final.zip of its directory"
        )


PREDICTION_BUFFER = {"buffer_size": 1, "replay_buffer_class": NoReplayBuffer}


class GreedyPolicy(Policy):
    """A model's policy without exploration."""

    def __init__(self, model: OffPolicyAlgorithm) -> None:
        self.model = model

    def __call__(self, observation: Observation) -> np.ndarray:
        """Return the actions of all episodes of the batch, shape (n, actions)."""
        return self.model.predict(observation, deterministic=True)[0]


def _skip_compiler_import() -> None:
    """Keep torch from importing its compiler, which takes 1.1 to 4 s of CPU time in every run.

    Torch excludes some methods of optimizers from compilation, and imports the compiler for that
    with the first optimizer. It skips methods that have an attribute, which is set here. See
    `torch._compile._disable_dynamo`.
    """
    for name in ("add_param_group", "load_state_dict", "state_dict", "zero_grad"):
        plain = getattr(getattr(torch.optim.Optimizer, name), "__wrapped__", None)
        if plain is not None and not hasattr(plain, "__dynamo_disable"):
            setattr(plain, "__dynamo_disable", plain)


def _unsaved_weights(model: OffPolicyAlgorithm) -> list[str]:
    """Return the attributes with weights that `_get_torch_save_params()` does not name."""
    names, variables = model._get_torch_save_params()
    saved = set()
    for name in [*names, *variables]:
        part = recursive_getattr(model, name)
        saved.add(id(part))
        if isinstance(part, nn.Module):
            saved.update(map(id, part.modules()))
    kinds = (nn.Module, torch.optim.Optimizer, torch.Tensor)
    attributes = vars(model).items()
    return [
        name for name, value in attributes if isinstance(value, kinds) and id(value) not in saved
    ]
