"""Build a Stable-Baselines3 model from a config: the one place where third-party classes are
instantiated.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import chain
from typing import Any

import torch
from gymnasium import spaces
from hydra.utils import get_class, instantiate
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.save_util import recursive_getattr
from stable_baselines3.common.torch_layers import CombinedExtractor
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from parking_exp.algorithms.action_noise import make_action_noise
from parking_exp.algorithms.mirrored_policies import MIRRORED
from parking_exp.algorithms.normalization import NormalizedExtractor, Normalizer
from parking_exp.buffers import HerBuffer
from parking_exp.config.constructor_arguments import CLASS_ARGUMENTS, POLICY, policy_class, takes
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError, ModelError
from parking_exp.tasks.feature_extractors import SymmetricFeatures
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.task import Policy, Task


def build_model(
    config: RunConfig, env: VecEnv, seed: int, *, for_training: bool = True
) -> OffPolicyAlgorithm:
    """Build the model that a config describes.

    Args:
        config: the run.
        env: training envs, or one env of the same spaces; the HER buffer relabels with their
            `goal_reward`, if any.
        seed: of weights, exploration and minibatches.
        for_training: False skips the replay buffer, for a model that only predicts.

    Raises:
        ConfigError: the library refuses an argument, or the algorithm would lose weights when it is
            saved.
    """
    target, arguments, task = (
        config.algorithm.target,
        config.algorithm.arguments,
        make_task(config.env),
    )
    train_freq, gradient_steps = config.update_rounds()
    node: dict[str, Any] = {
        "policy": POLICY,
        **arguments,
        "_target_": target,
        "_convert_": "all",
        "_partial_": True,
        "gradient_steps": gradient_steps,
        "buffer_size": config.buffer.buffer_size if for_training else env.num_envs,
        "seed": seed,
        "device": config.device,
    }
    for name in ("policy_kwargs", "train_freq", "action_noise"):
        node.pop(name, None)
    # Hydra would copy objects into its config.
    build = instantiate(node)
    objects: dict[str, Any] = {
        "env": env,
        "train_freq": train_freq,
        "policy_kwargs": _policy_kwargs(config, task, env),
    }
    if issubclass(
        objects["policy_kwargs"].get("features_extractor_class", type), SymmetricFeatures
    ):
        objects["policy"] = MIRRORED[policy_class(get_class(target))]
    if for_training:
        objects["replay_buffer_class"] = get_class(config.buffer.target)
        objects["replay_buffer_kwargs"] = config.buffer.arguments
        if issubclass(objects["replay_buffer_class"], HerBuffer) and env.has_attr("goal_reward"):
            (objects["replay_buffer_kwargs"]["reward"],) = env.get_attr("goal_reward", 0)
    else:
        objects["replay_buffer_class"] = NoReplayBuffer
    _skip_compiler_import()
    try:
        if (noise := arguments.get("action_noise")) is not None:
            objects["action_noise"] = make_action_noise(noise, env)
        model = build(**objects)
    except (TypeError, ValueError, KeyError, AssertionError) as error:
        raise ConfigError(f"algorithm: {target} refuses its arguments: {error}") from error
    if unsaved := _unsaved_weights(model):
        raise ConfigError(f"algorithm._target_={target}: its files would lose {', '.join(unsaved)}")
    return model


class NoReplayBuffer(DictReplayBuffer):
    """The buffer of a model that only predicts: training with it is refused."""

    def add(self, *_: Any) -> None:
        """Refuse a transition."""
        raise ModelError(
            "this model only predicts, since it has no replay buffer; parking_exp.train() trains a "
            "run, and "
            "Stable-Baselines3's load() reads models/final.zip of its directory"
        )


def greedy_policy(model: OffPolicyAlgorithm) -> Policy:
    """Return the model's policy without exploration."""
    return lambda observation: model.predict(observation, deterministic=True)[0]


def _skip_compiler_import() -> None:
    """Keep torch from importing its compiler when the first optimizer is made: 1.1 to 4 s of CPU
    time of every run.

    torch imports it to exclude some methods of optimizers from compilation unless they have this
    mark, see `torch._compile._disable_dynamo`.
    """
    for name in ("add_param_group", "load_state_dict", "state_dict", "zero_grad"):
        plain = getattr(getattr(torch.optim.Optimizer, name), "__wrapped__", None)
        if plain is not None and not hasattr(plain, "__dynamo_disable"):
            setattr(plain, "__dynamo_disable", plain)


def _unsaved_weights(model: OffPolicyAlgorithm) -> list[str]:
    """Return the networks, optimizers and tensors of a model that its `_get_torch_save_params()`
    does not name.
    """
    saved = [recursive_getattr(model, name) for name in chain(*model._get_torch_save_params())]
    if not saved:  # such as the classes of sbx
        return ["all weights"]
    parts = {
        id(part)
        for value in saved
        for part in (value.modules() if isinstance(value, nn.Module) else [value])
    }
    kinds = (nn.Module, torch.optim.Optimizer, torch.Tensor)
    return [
        name
        for name, value in vars(model).items()
        if isinstance(value, kinds) and id(value) not in parts
    ]


def _policy_kwargs(config: RunConfig, task: Task, env: VecEnv) -> dict[str, Any]:
    policy_kwargs: dict[str, Any] = {"net_arch": list(config.algorithm.net_arch)}
    if (features := task.features(config.algorithm.features)) is not None:
        extractor, arguments = features
        policy_kwargs |= {
            "features_extractor_class": extractor,
            "features_extractor_kwargs": arguments,
        }
    elif config.algorithm.normalize:
        assert isinstance(env.observation_space, spaces.Dict)
        policy_kwargs["features_extractor_class"] = NormalizedExtractor
        policy_kwargs["features_extractor_kwargs"] = {
            "normalizer": Normalizer(env.observation_space)
        }
    elif (policy := policy_class(get_class(config.algorithm.target))) is None or takes(
        policy, "features_extractor_class"
    ):
        # The default of a MultiInputPolicy, except CrossQ's.
        policy_kwargs["features_extractor_class"] = CombinedExtractor
    custom = config.algorithm.arguments.get("policy_kwargs") or {}
    classes = {name: _class(value) for name, value in custom.items() if name in CLASS_ARGUMENTS}
    rest = instantiate(
        {name: value for name, value in custom.items() if name not in classes}
        | {"_convert_": "all"}
    )
    return policy_kwargs | rest | classes


def _class(value: Any) -> Any:
    """Return the class that a dotted path names, or a class with the arguments of a `_target_`
    node.
    """
    if isinstance(value, Mapping):
        return instantiate({**value, "_convert_": "all", "_partial_": True})
    return get_class(value) if isinstance(value, str) else value


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
