"""Build a Stable-Baselines3 model from a config: the one place where third-party classes are instantiated."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from hydra.utils import get_class, get_object, instantiate
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.torch_layers import CombinedExtractor
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from parking_exp.algorithms.features import EgoFrameExtractor, FineEgoFrameExtractor, MirroredEgoFrameExtractor
from parking_exp.algorithms.mirrored_policies import MIRRORED
from parking_exp.algorithms.noise import VectorizedNormalNoise
from parking_exp.buffers import HerBuffer
from parking_exp.config.constructor_arguments import (
    CLASS_ARGUMENTS,
    POLICY,
    ignored_features,
    not_mirrored,
    policy_class,
    takes,
)
from parking_exp.config.schema import RunConfig
from parking_exp.envs.interface import Policy
from parking_exp.envs.reward import GoalReward
from parking_exp.envs.training_envs import is_parking
from parking_exp.errors import ConfigError


def build_model(config: RunConfig, env: VecEnv, seed: int, *, for_training: bool = True) -> OffPolicyAlgorithm:
    """Build the model that a config describes.

    Args:
        config: the run.
        env: training envs, or one env of the same spaces.
        seed: of weights, exploration and minibatches.
        for_training: False skips the replay buffer, for a model that only predicts.

    Raises:
        ConfigError: the library refuses an argument, or its policy ignores the features.
    """
    arguments = config.algorithm.arguments
    train_freq, gradient_steps = config.update_rounds()
    node: dict[str, Any] = {
        "policy": POLICY,
        **arguments,
        "_target_": config.algorithm.target,
        "_convert_": "all",
        "_partial_": True,
        "gradient_steps": gradient_steps,
        "buffer_size": config.buffer.buffer_size if for_training else env.num_envs,
        "seed": seed,
        "device": config.device,
    }
    for name in ("policy_kwargs", "train_freq", "action_noise"):
        node.pop(name, None)
    # Objects are given to the partial afterwards: Hydra would copy them into its config.
    build = instantiate(node)
    objects: dict[str, Any] = {"env": env, "train_freq": train_freq, "policy_kwargs": _policy_kwargs(config)}
    if config.algorithm.features == "ego_mirrored":
        objects["policy"] = _mirrored_policy(config)
    if (noise := arguments.get("action_noise")) is not None:
        objects["action_noise"] = _action_noise(noise, env.num_envs)
    if for_training:
        objects["replay_buffer_class"] = get_class(config.buffer.target)
        objects["replay_buffer_kwargs"] = config.buffer.arguments
        if issubclass(objects["replay_buffer_class"], HerBuffer) and is_parking(env):
            objects["replay_buffer_kwargs"]["reward"] = GoalReward.of(config.env.for_training())
    _skip_compiler_import()
    try:
        model = build(**objects)
    except (TypeError, ValueError, KeyError, AssertionError) as error:
        raise ConfigError(f"algorithm: {config.algorithm.target} refuses its arguments: {error}") from error
    if config.algorithm.features != "raw" and not _computes_ego_features(model):
        raise ConfigError(ignored_features(config.algorithm))
    return model


def greedy_policy(model: OffPolicyAlgorithm) -> Policy:
    """Return the model's policy without exploration."""
    return lambda observation: model.predict(observation, deterministic=True)[0]


def _skip_compiler_import() -> None:
    """Keep torch from importing its compiler when the first optimizer is made: 1.1 s of a run's start (torch 2.13).

    torch imports it to mark some methods of optimizers as never to be compiled, at their first call, unless they are
    marked: `torch._compile._disable_dynamo`. The mark set here is the plain method. Another torch ignores it.
    """
    for name in ("add_param_group", "load_state_dict", "state_dict", "zero_grad"):
        plain = getattr(getattr(torch.optim.Optimizer, name), "__wrapped__", None)
        if plain is not None and not hasattr(plain, "__dynamo_disable"):
            setattr(plain, "__dynamo_disable", plain)


def _computes_ego_features(model: OffPolicyAlgorithm) -> bool:
    """Whether a network of the model has the features extractor; policies of other libraries may not take it."""
    networks = [one for one in vars(model).values() if isinstance(one, nn.Module)]
    return any(isinstance(module, EgoFrameExtractor) for network in networks for module in network.modules())


def _mirrored_policy(config: RunConfig) -> type:
    """Return the policy that mirrors the steering with its features."""
    policy = MIRRORED.get(policy_class(get_class(config.algorithm.target)) or object)
    if policy is None:
        raise ConfigError(not_mirrored(config.algorithm))
    return policy


def _policy_kwargs(config: RunConfig) -> dict[str, Any]:
    policy_kwargs: dict[str, Any] = {"net_arch": list(config.algorithm.net_arch)}
    if config.algorithm.features == "ego":
        policy_kwargs["features_extractor_class"] = EgoFrameExtractor
        policy_kwargs["features_extractor_kwargs"] = {"scales": list(config.env.observation.scales)}
    elif config.algorithm.features in ("ego_fine", "ego_mirrored"):
        policy_kwargs["features_extractor_class"] = FineEgoFrameExtractor
        policy_kwargs["features_extractor_kwargs"] = {
            "scales": list(config.env.observation.scales),
            "reward_weights": list(config.env.reward_weights),
        }
        if config.algorithm.features == "ego_mirrored":
            policy_kwargs["features_extractor_class"] = MirroredEgoFrameExtractor
            policy_kwargs["features_extractor_kwargs"]["steering"] = config.env.action.lateral
    elif (policy := policy_class(get_class(config.algorithm.target))) is None or takes(
        policy, "features_extractor_class"
    ):
        # What a MultiInputPolicy has by default, except CrossQ's.
        policy_kwargs["features_extractor_class"] = CombinedExtractor
    given = config.algorithm.arguments.get("policy_kwargs") or {}
    classes = {name: _class(value) for name, value in given.items() if name in CLASS_ARGUMENTS}
    rest = instantiate({name: value for name, value in given.items() if name not in classes} | {"_convert_": "all"})
    return policy_kwargs | rest | classes


def _class(value: Any) -> Any:
    """Return the class that a dotted path or a `_target_` node names; with the node's arguments, if it has any."""
    if isinstance(value, str):
        return get_class(value)
    if not isinstance(value, Mapping):
        return value
    found = get_object(value["_target_"])
    is_class = isinstance(found, type)
    if is_class and not set(value) - {"_target_", "_partial_"}:
        return found
    return instantiate({**value, "_convert_": "all", "_partial_": is_class})


def _action_noise(node: Mapping[str, Any], n_envs: int) -> ActionNoise:
    """Make action noise; it wants arrays where YAML has lists."""
    arrays = {name: np.array(value, np.float64) for name, value in node.items() if isinstance(value, list)}
    rest = {name: value for name, value in node.items() if name not in arrays}
    noise: ActionNoise = instantiate({**rest, "_partial_": True, "_convert_": "all"})(**arrays)
    return VectorizedNormalNoise(noise, n_envs) if n_envs > 1 and type(noise) is NormalActionNoise else noise


@contextmanager
def torch_settings(config: RunConfig) -> Iterator[None]:
    """Give torch the threads and the float32 matmul precision of a run within a block."""
    threads, before = torch.get_num_threads(), torch.get_float32_matmul_precision()
    if config.torch_threads is not None:
        torch.set_num_threads(config.torch_threads)
    try:
        torch.set_float32_matmul_precision(config.precision)
        yield
    finally:
        torch.set_num_threads(threads)
        torch.set_float32_matmul_precision(before)
