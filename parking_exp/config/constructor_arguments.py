"""Check the arguments of third-party classes against their signatures, nested ones included.

Nested are nodes with a `_target_`, `policy_kwargs`, and the arguments of optimizer and features extractor. The classes
are imported for it, and torch with them, so everything that can be checked without them is checked first.
"""

import inspect
from collections.abc import Mapping, Set
from types import NoneType
from typing import Any, get_args

from parking_exp.config.limits import has_limit
from parking_exp.config.schema import AlgorithmConfig, RunConfig, ThirdParty
from parking_exp.config.targets import CLASS_ARGUMENTS, UnknownTarget, class_path, find
from parking_exp.errors import suggestion

# What the classes of the sections derive from, and what that is called.
BASES = {
    "algorithm": ("stable_baselines3.common.off_policy_algorithm.OffPolicyAlgorithm", "an off-policy algorithm"),
    "buffer": ("stable_baselines3.common.buffers.ReplayBuffer", "a replay buffer"),
}
POLICY = "MultiInputPolicy"
HYDRA_KEYS = {"_target_", "_partial_", "_convert_", "_recursive_", "_args_"}
SIMPLE_TYPES = {int, float, bool, str, NoneType}
# May be null although the library's annotation has no None: the run computes them.
NULLABLE = {"train_freq", "gradient_steps"}

# Arguments that the run sets, and the key that they come from.
SetByRun = Mapping[str, str | None]
OF_ALGORITHM: SetByRun = {
    "env": "env",
    "seed": "seed",
    "device": "device",
    "buffer_size": "buffer.buffer_size",
    "optimize_memory_usage": None,
    "n_steps": None,
    "policy": None,
    "replay_buffer_class": "buffer._target_",
    "replay_buffer_kwargs": "buffer",
    "tensorboard_log": "tracking.tensorboard",
    "verbose": "tracking.stdout",
    "_init_setup_model": None,
}
OF_BUFFER: SetByRun = {
    "buffer_size": "buffer.buffer_size",
    "observation_space": "env",
    "action_space": "env",
    "env": "env",
    "n_envs": "n_envs",
    "device": "device",
    "optimize_memory_usage": None,
    "reward": "env",
}
OF_POLICY: SetByRun = {
    "observation_space": "env",
    "action_space": "env",
    "lr_schedule": "algorithm.learning_rate",
    "use_sde": "algorithm.use_sde",
}
OF_OPTIMIZER: SetByRun = {"params": "algorithm.net_arch", "lr": "algorithm.learning_rate"}
OF_EXTRACTOR: SetByRun = {"observation_space": "env"}


def check_arguments(run: RunConfig) -> list[str]:
    """Return what is wrong with the arguments of the algorithm, of its policy and of the buffer."""
    return [
        *_check_section("algorithm", run.algorithm, OF_ALGORITHM),
        *_check_section("buffer", run.buffer, OF_BUFFER),
    ]


def ignored_features(algorithm: AlgorithmConfig) -> str:
    """Return the error that an algorithm's policy has no features extractor."""
    return (
        f"algorithm.features={algorithm.features}: the policy of {algorithm.target} has no features extractor and "
        "would ignore it; set algorithm.features=raw"
    )


def not_mirrored(algorithm: AlgorithmConfig) -> str:
    """Return the error that an algorithm's policy cannot mirror its steering."""
    return (
        f"algorithm.features=ego_mirrored: the policy of {algorithm.target} does not mirror its steering; "
        "set algorithm.features=ego_fine"
    )


def policy_class(algorithm: type) -> type | None:
    """Return the policy class that an algorithm has for goal observations; None where it does not say."""
    return getattr(algorithm, "policy_aliases", {}).get(POLICY)


def takes(call: Any, name: str) -> bool:
    """Return whether a class or function may be given an argument."""
    parameters, is_open = _parameters(call)
    return is_open or name in parameters


def _check_section(key: str, section: ThirdParty, set_by_run: SetByRun) -> list[str]:
    """Check a section's class and its arguments."""
    base, words = BASES[key]
    try:
        found = find(section.target)
    except UnknownTarget as error:
        return [f"{key}._target_={section.target}: {error}"]
    if not isinstance(found, type) or not issubclass(found, find(base)):
        return [f"{key}._target_={section.target} is not {words} of Stable-Baselines3"]
    siblings = set(type(section).model_fields) - {"target"}
    problems = _check_call(key, found, section.target, section.arguments, set_by_run, siblings)
    if not problems and isinstance(section, AlgorithmConfig):
        problems = _check_policy(section, found)
    return problems


def _check_policy(algorithm: AlgorithmConfig, algorithm_class: type) -> list[str]:
    """Check `policy_kwargs` against the policy's own constructor."""
    key, given = "algorithm.policy_kwargs", algorithm.arguments.get("policy_kwargs") or {}
    if not isinstance(given, Mapping):
        return [f"{key}={given!r} is not a group of keys"]
    # A mapping, of `pi` and `qf`, says what algorithm.net_arch cannot.
    if "net_arch" in given and not isinstance(given["net_arch"], Mapping):
        return [f"{key}.net_arch takes the place of algorithm.net_arch; use algorithm.net_arch"]
    own = [name for name in given if str(name).startswith("features_extractor")]
    if own and algorithm.features != "raw":
        return [
            f"{key}.{own[0]} takes the place of algorithm.features={algorithm.features}; set algorithm.features=raw"
        ]
    policy = policy_class(algorithm_class)
    if policy is None:
        return []
    if algorithm.features != "raw" and not takes(policy, "features_extractor_class"):
        return [ignored_features(algorithm)]
    mirrored = find("stable_baselines3.SAC"), find("stable_baselines3.TD3")
    if algorithm.features == "ego_mirrored" and not issubclass(algorithm_class, mirrored):
        return [not_mirrored(algorithm)]
    if problems := _check_call(key, policy, POLICY, given, OF_POLICY):
        return problems
    optimizer = given.get("optimizer_class", "torch.optim.Adam")
    extractor = given.get("features_extractor_class", "stable_baselines3.common.torch_layers.CombinedExtractor")
    return [
        *_check_kwargs(f"{key}.optimizer_kwargs", optimizer, given.get("optimizer_kwargs"), OF_OPTIMIZER),
        *_check_kwargs(
            f"{key}.features_extractor_kwargs", extractor, given.get("features_extractor_kwargs"), OF_EXTRACTOR
        ),
    ]


def _check_kwargs(key: str, value: object, given: object, set_by_run: SetByRun) -> list[str]:
    """Check keyword arguments that a class argument is called with, beside others."""
    if given is None:
        return []
    if not isinstance(given, Mapping):
        return [f"{key}={given!r} is not a group of keys"]
    target = class_path(value)
    try:
        call = find(target)
    except UnknownTarget as error:
        return [f"{key}: {target}: {error}"]
    return _check_call(key, call, str(target), given, set_by_run, partial=True)


def _check_call(
    key: str,
    call: Any,
    name: str,
    given: Mapping[str, Any],
    set_by_run: SetByRun,
    siblings: Set[str] = frozenset(),
    *,
    partial: bool = False,
) -> list[str]:
    """Check the arguments of a call; a `partial` one gets more. `siblings` are the valid keys that are no arguments."""
    parameters, is_open = _parameters(call)
    choices, problems = (parameters.keys() - set_by_run.keys()) | siblings, []
    for argument, value in given.items():
        if argument in set_by_run:
            source = set_by_run[argument]
            problems.append(f"{key}.{argument} is set by the run itself" + (f"; use {source}" if source else ""))
        elif argument in parameters:
            problems += _check_value(f"{key}.{argument}", value, name, parameters[argument])
        elif not is_open:
            problems.append(f"{key}.{argument}: {name} has no such argument{suggestion(argument, choices)}")
    if not partial:
        problems += [
            f"{key}.{argument} is missing; {name} needs it"
            for argument, parameter in parameters.items()
            if parameter.default is parameter.empty and argument not in {*given, *set_by_run}
        ]
    return problems


def _check_value(key: str, value: Any, call: str, parameter: inspect.Parameter) -> list[str]:
    """Check a value's type where the annotation is simple; numbers with a known range have been checked already."""
    if parameter.name in CLASS_ARGUMENTS and isinstance(value, str | Mapping):
        return _check_class(key, value, CLASS_ARGUMENTS[parameter.name])
    if isinstance(value, Mapping) and "_target_" in value:
        return _check_node(key, value)
    annotation = parameter.annotation
    if value is None and parameter.name not in NULLABLE and not _takes_none(parameter):
        return [f"{key}=null: {call} needs a value"]
    kinds = set(get_args(annotation)) or {annotation}
    if has_limit(parameter.name, call) or not kinds <= SIMPLE_TYPES:
        return []
    if type(value) in kinds or (type(value) is int and float in kinds):
        return []
    return [f"{key}={value!r} has the wrong type; {call} takes {inspect.formatannotation(annotation)}"]


def _check_class(key: str, value: str | Mapping[str, Any], base: str) -> list[str]:
    """Check a class argument; a node may also name a function that returns the class."""
    if isinstance(value, Mapping) and (problems := _check_node(key, {**value, "_partial_": True})):
        return problems
    target = class_path(value)
    try:
        found = find(target)
    except UnknownTarget as error:
        return [f"{key}={target}: {error}"]
    fits = issubclass(found, find(base)) if isinstance(found, type) else isinstance(value, Mapping)
    return [] if fits else [f"{key}={target} is not a subclass of {base}"]


def _check_node(key: str, node: Mapping[str, Any]) -> list[str]:
    target = node.get("_target_")
    try:
        found = find(target)
    except UnknownTarget as error:
        return [f"{key}._target_={target}: {error}"]
    given = {name: value for name, value in node.items() if name not in HYDRA_KEYS}
    return _check_call(key, found, str(target), given, {}, partial=bool(node.get("_partial_")) or "_args_" in node)


def _parameters(call: Any) -> tuple[dict[str, inspect.Parameter], bool]:
    """Return the named parameters of a class or function, and whether it takes any others."""
    try:
        parameters = inspect.signature(call).parameters
    except (TypeError, ValueError):  # compiled, without a signature
        return {}, True
    variadic = {name for name, one in parameters.items() if one.kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD)}
    is_open = any(parameters[name].kind is inspect.Parameter.VAR_KEYWORD for name in variadic)
    return {name: one for name, one in parameters.items() if name not in variadic}, is_open


def _takes_none(parameter: inspect.Parameter) -> bool:
    annotation = parameter.annotation
    return annotation in (parameter.empty, Any) or any(word in str(annotation) for word in ("None", "Optional"))
