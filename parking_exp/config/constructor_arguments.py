"""Check the arguments of third-party classes against their signatures, nested ones included.

Nested arguments are nodes with a `_target_`, `policy_kwargs`, and the arguments of optimizer and
features extractor. This imports the classes, and torch with them, so everything that can be checked
without them is checked first.
"""

import inspect
from collections.abc import Iterator, Mapping
from importlib import import_module
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from parking_exp.config.argument_limits import CLASS_LIMITS, KNOWN_ARGUMENTS, LIMITS, STRICT
from parking_exp.config.schema import AlgorithmConfig, BufferConfig, RunConfig
from parking_exp.errors import ConfigError, one_line, suggestion

# Base classes of the sections' classes.
BASES = {
    "algorithm": "stable_baselines3.common.off_policy_algorithm.OffPolicyAlgorithm",
    # observations of goal tasks are dictionaries
    "buffer": "stable_baselines3.common.buffers.DictReplayBuffer",
}
CALLBACK = "stable_baselines3.common.callbacks.BaseCallback"
# Arguments that are classes, as dotted paths or `_target_` nodes, and their base classes.
CLASS_ARGUMENTS = {
    "activation_fn": "torch.nn.Module",
    "optimizer_class": "torch.optim.Optimizer",
    "features_extractor_class": "stable_baselines3.common.torch_layers.BaseFeaturesExtractor",
}
DEFAULT_CLASSES = {
    "optimizer": "torch.optim.Adam",
    "features_extractor": "stable_baselines3.common.torch_layers.CombinedExtractor",
}
POLICY = "MultiInputPolicy"
MIRRORED_POLICIES = (
    "stable_baselines3.sac.MultiInputPolicy",
    "stable_baselines3.td3.MultiInputPolicy",
)
PLAIN_TYPES = (int, float, bool, str, NoneType)
HYDRA_KEYS = {"_target_", "_partial_", "_convert_", "_recursive_", "_args_"}
# May be null although the library's annotation has no None: the run computes them.
NULLABLE = {"train_freq", "gradient_steps", "goal_selection_strategy"}
# By section, our own keys beside the class's arguments.
SECTION_KEYS = {"algorithm": AlgorithmConfig.model_fields, "buffer": BufferConfig.model_fields}
# By section, arguments that the run sets itself.
SET_BY_RUN = {
    "algorithm": {
        "policy", "env", "seed", "device", "buffer_size", "replay_buffer_class",
        "replay_buffer_kwargs", "n_steps", "optimize_memory_usage", "tensorboard_log", "verbose",
        "_init_setup_model",
    },
    "buffer": {
        "observation_space", "action_space", "buffer_size", "env", "n_envs", "device", "reward",
        "optimize_memory_usage",
    },
    "algorithm.policy_kwargs": {"observation_space", "action_space", "lr_schedule", "use_sde"},
    "algorithm.policy_kwargs.optimizer_kwargs": {"params", "lr"},
    "algorithm.policy_kwargs.features_extractor_kwargs": {"observation_space"},
}  # fmt: skip


def import_object(target: str) -> Any:
    """Import the class or function at a dotted path.

    Raises:
        ConfigError: it does not exist, or its module cannot be imported.
    """
    module, _, name = str(target).rpartition(".")
    try:
        return getattr(import_module(module), name)
    except Exception as error:  # whatever a module does when it is imported
        extra = "; pip install 'parking-exp[contrib]'" if module.startswith("sb3_contrib") else ""
        raise ConfigError(f"{type(error).__name__}: {one_line(error)}{extra}") from error


def class_path(value: Any) -> Any:
    """Return the dotted path that a class argument names: itself, or that of its `_target_`."""
    return value.get("_target_") if isinstance(value, Mapping) else value


def check_arguments(run: RunConfig) -> Iterator[str]:
    """Yield what is wrong with the arguments of the algorithm, of its policy and of the buffer."""
    for key, base in BASES.items():
        section = getattr(run, key)
        problems = list(_check_target(key, {"_target_": section.target, **section.arguments}, base))
        yield from problems
        if problems or not isinstance(section, AlgorithmConfig):
            continue
        # All features suit the policies of the known algorithms.
        if section.target not in KNOWN_ARGUMENTS or section.arguments.get("policy_kwargs"):
            yield from _check_policy(section, import_object(section.target))
    for number, callback in enumerate(run.callbacks or ()):
        yield from _check_target(f"callbacks.{number}", callback, CALLBACK)


def policy_class(algorithm: type) -> type | None:
    """Return an algorithm's policy class for goal observations; None if it names none."""
    return getattr(algorithm, "policy_aliases", {}).get(POLICY)


def takes(call: Any, name: str) -> bool:
    """Return whether a class or function accepts an argument."""
    parameters, is_open = _parameters(call)
    return is_open or name in parameters


def _check_policy(algorithm: AlgorithmConfig, algorithm_class: type) -> Iterator[str]:
    """Check `policy_kwargs` against the policy's own constructor."""
    key, given = "algorithm.policy_kwargs", algorithm.arguments.get("policy_kwargs") or {}
    features, policy = algorithm.features, policy_class(algorithm_class)
    if "net_arch" in given and not isinstance(
        given["net_arch"], Mapping
    ):  # a mapping sets actor and critic apart
        yield f"{key}.net_arch overrides algorithm.net_arch; set algorithm.net_arch instead"
    elif features != "raw" and (
        extractor := [name for name in given if name.startswith("features_extractor")]
    ):
        yield f"{key}.{extractor[0]} overrides algorithm.features; set algorithm.features=raw"
    elif features != "raw" and policy is not None and not takes(policy, "features_extractor_class"):
        yield f"algorithm.features={features}: {algorithm.class_name}'s policy ignores it; use raw"
    elif features == "ego_mirrored" and policy not in map(import_object, MIRRORED_POLICIES):
        yield (
            f"algorithm.features={features}: {algorithm.class_name}'s policy can't mirror its "
            "steering; use ego_fine"
        )
    elif policy is not None:
        problems = list(_check_call(key, policy, given))
        yield from problems
        for name, default in DEFAULT_CLASSES.items() if not problems else ():
            arguments, target = (
                given.get(f"{name}_kwargs") or {},
                class_path(given.get(f"{name}_class", default)),
            )
            yield from _check_target(
                f"{key}.{name}_kwargs", {**arguments, "_target_": target}, partial=True
            )


def _check_target(
    key: str, value: Any, base: str | None = None, *, partial: bool = False
) -> Iterator[str]:
    """Check a dotted path, or a node with a `_target_` and its arguments; the class must have the
    base.
    """
    target = class_path(value)
    given = {}
    if isinstance(value, Mapping):
        given = {name: argument for name, argument in value.items() if name not in HYDRA_KEYS}
    if given and set(given) in KNOWN_ARGUMENTS.get(str(target), ()):
        known = {name: inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY) for name in given}
        yield from _check_parameters(key, target.rpartition(".")[2], known, given)
        return
    assignment = f"{key}._target_={target}" if isinstance(value, Mapping) else f"{key}={target}"
    try:
        call = import_object(target)
    except ConfigError as error:
        yield f"{assignment}: {error}"
        return
    if base is not None and not (isinstance(call, type) and issubclass(call, import_object(base))):
        yield f"{assignment} is not a subclass of {base}"
    elif isinstance(value, Mapping):
        yield from _check_call(
            key, call, given, partial=partial or bool(value.get("_partial_")) or "_args_" in value
        )


def _check_call(
    key: str, call: Any, given: Mapping[str, Any], *, partial: bool = False
) -> Iterator[str]:
    """Check the arguments of a call; a `partial` call gets more later."""
    parameters, is_open = _parameters(call)
    yield from _check_parameters(
        key, getattr(call, "__name__", ""), parameters, given, is_open=is_open, partial=partial
    )


def _check_parameters(
    key: str,
    class_name: str,
    parameters: Mapping[str, inspect.Parameter],
    given: Mapping[str, Any],
    *,
    is_open: bool = False,
    partial: bool = False,
) -> Iterator[str]:
    """Check arguments against parameters; an `is_open` call takes others, too."""
    set_by_run = SET_BY_RUN.get(key, set())
    limits = CLASS_LIMITS.get(class_name, LIMITS)
    settable = {name: parameter for name, parameter in parameters.items() if name not in set_by_run}
    for name, value in given.items():
        path = f"{key}.{name}"
        if name in set_by_run:
            yield f"{path} is set by the run itself"
        elif name not in settable and not is_open:
            yield (
                f"{path}: there is no such "
                f"key{suggestion(name, [*settable, *SECTION_KEYS.get(key, ())])}"
            )
        elif (
            name in CLASS_ARGUMENTS and value is not None and not isinstance(class_path(value), str)
        ):
            yield f"{path}={value!r} is not a class; give a dotted path or a node with a _target_"
        elif isinstance(class_path(value), str) and (
            name in CLASS_ARGUMENTS or isinstance(value, Mapping)
        ):
            yield from _check_target(
                path, value, CLASS_ARGUMENTS.get(name), partial=name in CLASS_ARGUMENTS
            )
        elif name in settable:
            yield from _check_value(path, value, settable[name], limits)
    if not partial:
        required = (
            name
            for name, parameter in settable.items()
            if parameter.default is inspect.Parameter.empty
        )
        yield from (f"{key}.{name} is missing" for name in required if name not in given)


def _check_value(
    key: str, value: Any, parameter: inspect.Parameter, limits: Mapping[str, Any]
) -> Iterator[str]:
    """Check a value against its range, or else its annotation where that is a plain type."""
    annotation = parameter.annotation
    is_literal = get_origin(annotation) is Literal
    types = {annotation} if is_literal else set(get_args(annotation)) or {annotation}
    is_plain = all(part in PLAIN_TYPES or get_origin(part) is Literal for part in types)
    limit = limits.get(parameter.name, annotation if is_plain else Any)
    if value is None and (NoneType in types or parameter.name in NULLABLE):
        return
    try:
        TypeAdapter(limit, config=STRICT).validate_python(value)
    except ValidationError as error:
        reasons = [
            problem["msg"].removeprefix("Value error, ").lower() for problem in error.errors()
        ]
        yield f"{key}={value!r}: {' or '.join(reasons)}"


def _parameters(call: Any) -> tuple[dict[str, inspect.Parameter], bool]:
    """Return the named parameters of a class or function, and whether it takes any others.

    A class that takes others probably passes them on, so that those of its base classes are named
    as well.
    """
    parameters, is_open = _signature(call)
    is_passed_on = is_open and isinstance(call, type)
    for base in call.__mro__[1:] if is_passed_on else ():
        inherited, passes_on = _signature(base)
        for name, parameter in inherited.items():
            parameters.setdefault(
                name, parameter.replace(default=None)
            )  # which the class itself may give
        if not passes_on:
            break
    return parameters, is_open


def _signature(call: Any) -> tuple[dict[str, inspect.Parameter], bool]:
    try:
        parameters = inspect.signature(call).parameters
    except (TypeError, ValueError):  # compiled, without a signature
        return {}, True
    named = {
        name: p for name, p in parameters.items() if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    }
    return named, any(p.kind is p.VAR_KEYWORD for p in parameters.values())
