"""Check constructor arguments of third-party classes against their signatures and ranges.

Nested ones, too: nodes with a `_target_`, `policy_kwargs`, and the arguments of optimizer and features extractor.
"""

import re
from collections.abc import Mapping, Set
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from parking_exp.config.her_options import RELABEL_OPTIONS, GoalStrategy
from parking_exp.config.messages import no_target, sentence
from parking_exp.config.schema import (
    AlgorithmConfig,
    Count,
    NonNegative,
    Positive,
    PositiveFloat,
    RunConfig,
    Share,
    ThirdParty,
)
from parking_exp.config.signatures import Parameter, Signature, base_names, may_derive_from, policy_signature, signature
from parking_exp.config.source_lookup import UnknownTarget
from parking_exp.errors import suggestion

Decay = Annotated[float, Field(ge=0, lt=1)]

# Ranges that third-party signatures don't state. A schedule, "auto", and [number, unit] for train_freq pass.
RANGES: dict[str, Any] = {
    "learning_rate": PositiveFloat,
    "buffer_size": Positive,
    "learning_starts": Count,
    "batch_size": Positive,
    "tau": Share,
    "gamma": Share,
    "train_freq": Positive,
    "gradient_steps": Annotated[int, Field(ge=-1)],  # -1: as many as steps
    "n_steps": Annotated[int, Field(ge=1, le=1)],
    "policy_delay": Positive,
    "target_update_interval": Positive,
    "target_policy_noise": NonNegative,
    "target_noise_clip": NonNegative,
    "ent_coef": PositiveFloat,
    "target_entropy": float,
    "stats_window_size": Positive,
    "top_quantiles_to_drop_per_net": Count,
    "n_sampled_goal": Positive,
    "goal_selection_strategy": GoalStrategy,
    **RELABEL_OPTIONS,
    "policy": Literal["MultiInputPolicy"],
    "n_critics": Annotated[int, Field(ge=1, le=100)],
    "n_quantiles": Annotated[int, Field(ge=1, le=10_000)],
    "weight_decay": NonNegative,
    "eps": NonNegative,
    "betas": Annotated[list[Decay], Field(min_length=2, max_length=2)],
}
# Ranges of arguments whose names mean something else elsewhere, by the class that takes them. Of lists, each entry.
RANGES_OF: dict[str, dict[str, Any]] = {
    "LinearSchedule": {"start": PositiveFloat, "end": NonNegative, "end_fraction": Share},
    "ConstantSchedule": {"val": PositiveFloat},
    "NormalActionNoise": {"mean": float, "sigma": NonNegative},
    "OrnsteinUhlenbeckActionNoise": {"mean": float, "sigma": NonNegative, "theta": NonNegative, "dt": PositiveFloat},
}
# What the classes of the sections derive from, and what that is called.
BASES = {
    "algorithm": ("OffPolicyAlgorithm", "off-policy algorithm"),
    "buffer": ("ReplayBuffer", "replay buffer"),
}
# Arguments that are classes, and the base that these must have. In a config they are dotted paths, or `_target_` nodes.
CLASS_ARGUMENTS = {
    "activation_fn": "Module",
    "optimizer_class": "Optimizer",
    "features_extractor_class": "BaseFeaturesExtractor",
}
CLASS_LOOKUPS = ("hydra.utils.get_class", "hydra.utils.get_object")
HYDRAS_KEYS = {"_target_", "_partial_", "_convert_", "_recursive_", "_args_"}

# Arguments that the run feeds from elsewhere, and from where.
Fed = Mapping[str, str | None]
FED_TO_ALGORITHM: Fed = {
    "env": "env",
    "seed": "seed",
    "device": "device",
    "buffer_size": "buffer.buffer_size",
    "optimize_memory_usage": "buffer.optimize_memory_usage",
    "replay_buffer_class": "buffer._target_",
    "replay_buffer_kwargs": "buffer",
    "tensorboard_log": "tracking.tensorboard",
    "verbose": "tracking.stdout",
    "_init_setup_model": None,
}
FED_TO_BUFFER: Fed = {
    "observation_space": "env",
    "action_space": "env",
    "env": "env",
    "n_envs": "n_envs",
    "device": "device",
    "reward": "env",
}
FED_TO_POLICY: Fed = {
    "observation_space": "env",
    "action_space": "env",
    "lr_schedule": "algorithm.learning_rate",
    "use_sde": "algorithm.use_sde",
}
FED_TO_OPTIMIZER: Fed = {"params": "algorithm.net_arch", "lr": "algorithm.learning_rate"}
FED_TO_EXTRACTOR: Fed = {"observation_space": "env"}
# Arguments that may be null in our YAML although the library's own annotation says otherwise: we fill them in.
UNSET = {"train_freq", "gradient_steps"}


def check_arguments(run: RunConfig) -> list[str]:
    """Say what is wrong with the arguments of the algorithm, of its policy and of the buffer."""
    return [
        *_check_section("algorithm", run.algorithm, FED_TO_ALGORITHM, {"policy_kwargs", "features", "net_arch"}),
        *_check_section("buffer", run.buffer, FED_TO_BUFFER, {"buffer_size", "optimize_memory_usage"}),
    ]


def ignored_features(algorithm: AlgorithmConfig) -> str:
    """Say that an algorithm's policy computes no features of ours."""
    return (
        f"algorithm.features={algorithm.features}: the policy of {algorithm.target} has no features extractor and "
        "would ignore it; set algorithm.features=raw"
    )


def not_mirrored(algorithm: AlgorithmConfig) -> str:
    """Say that an algorithm's policy can't mirror its steering."""
    return (
        f"algorithm.features=ego_mirrored: the policy of {algorithm.target} does not mirror its steering; "
        "set algorithm.features=ego_fine"
    )


def class_path(value: object) -> object:
    """Return the dotted path that a class argument names: itself, that of its `_target_`, or what that looks up."""
    if not isinstance(value, Mapping):
        return value
    is_lookup = value.get("_target_") in CLASS_LOOKUPS and "_args_" not in value
    return value.get("path" if is_lookup else "_target_")


def _check_section(key: str, section: ThirdParty, fed: Fed, own: Set[str]) -> list[str]:
    """Check a section's constructor arguments; `own` are fields of ours that the run makes arguments of."""
    base, words = BASES[key]
    try:
        expected, fits = signature(section.target), may_derive_from(section.target, base)
    except UnknownTarget as error:
        return [no_target(f"{key}._target_", section.target, error)]
    if not fits:
        return [f"{key}._target_={section.target} is no {words} of Stable-Baselines3"]
    siblings = set(section.arguments) | set(type(section).model_fields) - {"target"}
    given = section.arguments
    problems = _check_call(key, section.target, expected, given, fed, own=own, siblings=siblings)
    if not problems and isinstance(section, AlgorithmConfig):
        problems = _check_policy(section)
    return problems


def _check_policy(algorithm: AlgorithmConfig) -> list[str]:
    """Check `policy_kwargs` against the policy's own constructor."""
    key, given = "algorithm.policy_kwargs", algorithm.arguments.get("policy_kwargs") or {}
    if not isinstance(given, Mapping):
        return [f"{key}={given!r} is not a group of keys"]
    # A mapping, of `pi` and `qf`, says what algorithm.net_arch can't.
    if "net_arch" in given and not isinstance(given["net_arch"], Mapping):
        return [f"{key}.net_arch takes the place of algorithm.net_arch; use algorithm.net_arch"]
    own = [name for name in given if str(name).startswith("features_extractor")]
    if own and algorithm.features != "raw":
        return [
            f"{key}.{own[0]} takes the place of algorithm.features={algorithm.features}; set algorithm.features=raw"
        ]
    policy = str(algorithm.arguments.get("policy"))
    expected = policy_signature(algorithm.target, policy)
    if expected is None:
        return []
    if algorithm.features != "raw" and not expected.takes("features_extractor_class"):
        return [ignored_features(algorithm)]
    if algorithm.features == "ego_mirrored" and not base_names(algorithm.target) & {"SAC", "TD3"}:
        return [not_mirrored(algorithm)]
    problems = _check_call(key, policy, expected, given, FED_TO_POLICY)
    if problems:
        return problems
    optimizer = class_path(given.get("optimizer_class", "torch.optim.Adam"))
    problems += _check_kwargs(f"{key}.optimizer_kwargs", optimizer, given.get("optimizer_kwargs"), FED_TO_OPTIMIZER)
    extractor = class_path(
        given.get("features_extractor_class", "stable_baselines3.common.torch_layers.CombinedExtractor")
    )
    name = "features_extractor_kwargs"
    return problems + _check_kwargs(f"{key}.{name}", extractor, given.get(name), FED_TO_EXTRACTOR)


def _check_kwargs(key: str, target: object, given: object, fed: Fed) -> list[str]:
    """Check keyword arguments that a class is called with, beside others."""
    if given is None:
        return []
    if not isinstance(given, Mapping):
        return [f"{key}={given!r} is not a group of keys"]
    return _check_call(key, str(target), signature(str(target)), given, fed, partial=True)


def _check_call(
    key: str,
    target: str,
    expected: Signature,
    given: Mapping[str, Any],
    fed: Fed,
    *,
    own: Set[str] = frozenset(),
    siblings: Set[str] = frozenset(),
    partial: bool = False,
) -> list[str]:
    """Check the arguments of a call; more may come with a `partial` one. `siblings` are valid names beside them."""
    problems = []
    choices = (set(expected.parameters) - set(fed) - own) | siblings
    for name, value in given.items():
        parameter = expected.parameters.get(name)
        if name in fed:
            source = fed[name]
            problems.append(f"{key}.{name} is set by the run itself" + (f"; use {source}" if source else ""))
        elif parameter is not None:
            problems += _check_value(f"{key}.{name}", name, value, target, parameter)
        elif not expected.open:
            problems.append(f"{key}.{name}: {target} has no such argument{suggestion(name, choices - {name})}")
    if not partial:
        problems += [
            f"{key}.{name} is missing; {target} needs it"
            for name, parameter in expected.parameters.items()
            if parameter.required and name not in {*given, *fed, *own}
        ]
    return problems


def _check_value(key: str, name: str, value: Any, target: str, parameter: Parameter) -> list[str]:
    if name in CLASS_ARGUMENTS and isinstance(value, str | Mapping):
        return _check_class(key, value, CLASS_ARGUMENTS[name])
    if isinstance(value, Mapping) and "_target_" in value:
        return _check_node(key, value)
    if name in UNSET and value is None:
        return []
    if not parameter.accepts(value):
        return [f"{key}={value!r} has the wrong type; {target} takes {parameter.annotation}"]
    ranges = RANGES_OF.get(target.rpartition(".")[2], RANGES)
    if name not in ranges:
        return []
    if isinstance(value, list) and ranges is not RANGES:
        return [
            problem for index, one in enumerate(value) for problem in _check_range(f"{key}.{index}", one, ranges[name])
        ]
    if (name == "train_freq" and isinstance(value, list)) or (value is None and "None" in str(parameter.annotation)):
        return []
    return _check_range(key, value, ranges[name])


def _check_class(key: str, value: str | Mapping[str, Any], base: str) -> list[str]:
    """Check a class argument; a node may also name a function that returns the class."""
    target = class_path(value)
    if not isinstance(target, str):
        return [f"{key}={value!r} is not a dotted path, PACKAGE.MODULE.CLASS"]
    is_call = isinstance(value, Mapping) and target == value["_target_"]
    if isinstance(value, Mapping) and (problems := _check_node(key, {**value, "_partial_": True})):
        return problems
    try:
        others = base_names(target) & set(CLASS_ARGUMENTS.values())
    except UnknownTarget as error:
        return [] if is_call else [no_target(key, target, error)]
    return [f"{key}={target} is no {base}"] if others and base not in others else []


def _check_node(key: str, node: Mapping[str, Any]) -> list[str]:
    target = node["_target_"]
    if not isinstance(target, str):
        return [f"{key}._target_={target!r} is not a dotted path, PACKAGE.MODULE.CLASS"]
    try:
        expected = signature(target)
    except UnknownTarget as error:
        return [no_target(f"{key}._target_", target, error)]
    given = {name: value for name, value in node.items() if name not in HYDRAS_KEYS}
    partial = bool(node.get("_partial_")) or "_args_" in node
    return _check_call(key, target, expected, given, {}, partial=partial)


def _check_range(key: str, value: Any, valid: Any) -> list[str]:
    if key in {"algorithm.ent_coef", "algorithm.target_entropy"} and isinstance(value, str):
        pattern = r"auto(_\d+(\.\d*)?(e-?\d+)?)?" if key == "algorithm.ent_coef" else "auto"
        return (
            []
            if re.fullmatch(pattern, value)
            else [f"{key}={value} is not a valid choice; choose from auto and a number"]
        )
    try:
        TypeAdapter(valid).validate_python(value, strict=True)
    except ValidationError as error:
        return [sentence(item, prefix=key) for item in error.errors()]
    return []
