"""Check the arguments of third-party classes against their signatures, nested ones included.

Nested arguments are nodes with a `_target_`, `policy_kwargs`, and the arguments of optimizer and
features extractor. Classes that `conf/` uses with the same arguments (`KNOWN_ARGUMENTS`) are not
imported. Other classes are, and torch with them, so everything else is checked first.
"""

import inspect
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field
from difflib import get_close_matches
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from parking_exp.config.argument_limits import CLASS_LIMITS, KNOWN_ARGUMENTS, LIMITS, STRICT
from parking_exp.config.schema import AlgorithmConfig, BufferConfig, RunConfig, ThirdParty
from parking_exp.dotted_paths import import_object
from parking_exp.errors import ConfigError, reason_of_invalid_value
from parking_exp.phrases import did_you_mean, suggestion

SIMILAR = 0.8  # similarity from which on a name counts as misspelt
# Base classes of the classes in a config.
ALGORITHM = "stable_baselines3.common.off_policy_algorithm.OffPolicyAlgorithm"
# Observations of goal tasks are dictionaries.
REPLAY_BUFFER = "stable_baselines3.common.buffers.DictReplayBuffer"
HER_BUFFER = "parking_exp.buffers.HerBuffer"
SCRIPTED_POLICY = "parking_exp.tasks.scripted_policy.ScriptedPolicy"
CALLBACK = "stable_baselines3.common.callbacks.BaseCallback"
TRACKER = "parking_exp.training.trackers.Tracker"
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
MIRRORED_POLICIES = "parking_exp.algorithms.mirrored_policies.MIRRORED"
PLAIN_TYPES = (int, float, bool, str, NoneType)
CHECKED_TYPES = (Literal, Annotated)  # annotations that pydantic checks as they are
HYDRA_KEYS = {"_target_", "_partial_", "_convert_", "_recursive_", "_args_"}
# By section, our own keys beside the class's arguments.
SECTION_KEYS = {"algorithm": AlgorithmConfig.model_fields, "buffer": BufferConfig.model_fields}
# By section, arguments that the run sets itself.
SET_BY_RUN = {
    "algorithm": {
        "policy", "task", "env", "seed", "device", "buffer_size", "replay_buffer_class",
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
    "buffer.demonstrator": {"task", "seed"},
    "tracking.trackers": {"config", "run_dir"},
}  # fmt: skip


@dataclass(frozen=True)
class _Signature:
    """What a class or function takes."""

    name: str = ""
    types: Mapping[str, Any] = field(default_factory=dict)  # argument -> annotation
    required: Set[str] = frozenset()
    is_open: bool = False  # takes any other arguments, too


def _signature(call: Any) -> _Signature:
    """Return the signature of a class or function."""
    name = getattr(call, "__name__", "")
    try:
        parameters = inspect.signature(call).parameters.values()
    except (TypeError, ValueError):  # compiled, without a signature
        return _Signature(name, is_open=True)
    types = {}
    required = set()
    is_open = False
    for parameter in parameters:
        if parameter.kind is parameter.VAR_KEYWORD:
            is_open = True
        elif parameter.kind is not parameter.VAR_POSITIONAL:
            types[parameter.name] = parameter.annotation
            if parameter.default is parameter.empty:
                required.add(parameter.name)
    return _Signature(name, types, required, is_open)


def class_path(value: Any) -> Any:
    """Return the dotted path of a class argument: the argument itself, or its `_target_`."""
    return value.get("_target_") if isinstance(value, Mapping) else value


def argument_problems(run: RunConfig) -> Iterator[str]:
    """Yield what is wrong with the classes that a config names, and with their arguments."""
    if run.is_trained:
        yield from _algorithm_problems(run.algorithm)
        yield from _section_problems("buffer", run.buffer, REPLAY_BUFFER)
        if run.buffer.demonstrations:
            yield from _demonstration_problems(run.buffer, run.env)
    else:
        yield from _scripted_problems(run.algorithm, run.env)
    for number, callback in enumerate(run.callbacks or ()):
        yield from _target_problems(f"callbacks.{number}", callback, CALLBACK)
    for number, tracker in enumerate(run.tracking.trackers or ()):
        yield from _target_problems(f"tracking.trackers.{number}", tracker, TRACKER)


def _section_problems(key: str, section: ThirdParty, base: str) -> list[str]:
    """Return what is wrong with the class and the arguments of a section."""
    node = {"_target_": section.target, **section.arguments}
    return list(_target_problems(key, node, base))


def _algorithm_problems(algorithm: AlgorithmConfig) -> Iterator[str]:
    """Yield what is wrong with an algorithm that is trained, and with its policy."""
    problems = _section_problems("algorithm", algorithm, ALGORITHM)
    yield from problems
    # All features suit the policies of the known algorithms.
    is_known = algorithm.target in KNOWN_ARGUMENTS
    if not problems and (not is_known or algorithm.arguments.get("policy_kwargs")):
        yield from _policy_problems(algorithm, import_object(algorithm.target))


def _scripted_problems(algorithm: AlgorithmConfig, env: Any) -> Iterator[str]:
    """Yield what is wrong with a policy that is not trained."""
    problems = _section_problems("algorithm", algorithm, SCRIPTED_POLICY)
    yield from problems
    if not problems:
        yield from import_object(algorithm.target).problems(env)


def _demonstration_problems(buffer: BufferConfig, env: Any) -> Iterator[str]:
    """Yield what is wrong with the buffer and the policy of demonstrations."""
    key = "buffer.demonstrator"
    problems = list(_target_problems(key, buffer.demonstrator, SCRIPTED_POLICY))
    if not problems:
        policy = import_object(class_path(buffer.demonstrator))
        problems = [f"{key}: {problem}" for problem in policy.problems(env)]
    yield from problems
    # A class with its own `sample` would sample no demonstrations.
    own_sample = getattr(import_object(buffer.target), "sample", None)
    if own_sample is not import_object(HER_BUFFER).sample:
        yield (
            f"buffer.demonstrations={buffer.demonstrations} needs {HER_BUFFER}, or a "
            "subclass that inherits its sample()"
        )


def policy_class(algorithm: type) -> type | None:
    """Return an algorithm's policy class for goal observations; None if it names none."""
    return getattr(algorithm, "policy_aliases", {}).get(POLICY)


def takes(call: Any, name: str) -> bool:
    """Return whether a class or function accepts an argument."""
    signature = _signature(call)
    return signature.is_open or name in signature.types


def argument_hint(key: str, node: Mapping[str, Any], option_hint: str) -> str:
    """Say what to type instead of an unknown key of a node, whose class may take other keys.

    If the class takes no similar key, return `option_hint`, unless it is empty.
    """
    section, _, name = key.rpartition(".")
    hint = did_you_mean(name, node, cutoff=SIMILAR)
    if hint:
        return hint
    try:
        signature = _signature(import_object(node["_target_"]))
    except ConfigError:
        signature = _Signature()
    arguments = signature.types.keys() - SET_BY_RUN.get(section, set())
    similar = get_close_matches(name, sorted(arguments), n=1, cutoff=SIMILAR)
    if similar and similar[0] != name:
        return f"; did you mean '++{section}.{similar[0]}'?"
    if option_hint and not similar:
        return option_hint
    return f"; write ++{key}=VALUE to add it"


def _policy_problems(algorithm: AlgorithmConfig, algorithm_class: type) -> Iterator[str]:
    """Yield what is wrong with the features and with `policy_kwargs`, the policy's arguments."""
    key = "algorithm.policy_kwargs"
    given = algorithm.arguments.get("policy_kwargs") or {}
    policy = policy_class(algorithm_class)
    net_arch = given.get("net_arch", {})
    if not isinstance(net_arch, Mapping):  # a mapping sets actor and critic apart
        yield f"{key}.net_arch overrides algorithm.net_arch; set algorithm.net_arch instead"
        return

    problem = _extractor_problem(algorithm, given)
    if problem is None and algorithm.features != "raw":
        problem = _features_problem(algorithm, policy)
    if problem is not None:
        yield problem
        return

    if policy is None:
        return
    problems = list(_argument_problems(key, _signature(policy), given))
    yield from problems
    if problems:
        return
    for name, default in DEFAULT_CLASSES.items():
        arguments = given.get(f"{name}_kwargs") or {}
        target = class_path(given.get(f"{name}_class", default))
        node = {**arguments, "_target_": target}
        yield from _target_problems(f"{key}.{name}_kwargs", node, partial=True)


def _extractor_problem(algorithm: AlgorithmConfig, given: Mapping[str, Any]) -> str | None:
    """Say which of our keys a features extractor among the policy's arguments overrides."""
    names = [name for name in given if name.startswith("features_extractor")]
    if not names:
        return None
    problem = f"algorithm.policy_kwargs.{names[0]} overrides"
    if algorithm.features != "raw":
        return f"{problem} algorithm.features; set algorithm.features=raw"
    if algorithm.normalize:
        return f"{problem} algorithm.normalize; set algorithm.normalize=false"
    return None


def _features_problem(algorithm: AlgorithmConfig, policy: type | None) -> str | None:
    """Say why a policy can't have the features, which are not raw."""
    chosen = f"algorithm.features={algorithm.features}: {algorithm.class_name}'s policy"
    if policy is not None and not takes(policy, "features_extractor_class"):
        return f"{chosen} ignores it; use raw"
    is_mirrored = algorithm.features == "ego_mirrored"
    if is_mirrored and policy not in import_object(MIRRORED_POLICIES):
        return f"{chosen} can't mirror its steering; use ego_fine"
    return None


def _target_problems(
    key: str, value: Any, base: str | None = None, *, partial: bool = False
) -> Iterator[str]:
    """Yield what is wrong with a dotted path, or with a node of a `_target_` and its arguments.

    The class must have the base.
    """
    target = class_path(value)
    given = {}
    if isinstance(value, Mapping):
        given = {name: argument for name, argument in value.items() if name not in HYDRA_KEYS}
    # Known classes are not imported. None of them is a scripted policy, so where one is needed the
    # class is imported, and refused below.
    if base != SCRIPTED_POLICY and given and set(given) in KNOWN_ARGUMENTS.get(str(target), ()):
        signature = _Signature(target.rpartition(".")[2], is_open=True)
        yield from _argument_problems(key, signature, given)
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
        gets_more = partial or bool(value.get("_partial_")) or "_args_" in value
        yield from _argument_problems(key, _signature(call), given, partial=gets_more)


def _argument_problems(
    key: str, signature: _Signature, given: Mapping[str, Any], *, partial: bool = False
) -> Iterator[str]:
    """Yield which arguments do not fit a signature; a `partial` call gets more later."""
    # Entries of a list have its name and a number.
    set_by_run = SET_BY_RUN.get(key.rstrip(".0123456789"), set())
    limits = CLASS_LIMITS.get(signature.name, LIMITS)
    settable = [name for name in signature.types if name not in set_by_run]
    for name, value in given.items():
        path = f"{key}.{name}"
        base = CLASS_ARGUMENTS.get(name)
        is_class = base is not None and value is not None
        if name in set_by_run:
            yield f"{path} is set by the run itself"
        elif name not in settable and not signature.is_open:
            known = [*settable, *SECTION_KEYS.get(key, ())]
            yield f"{path}: there is no such key{suggestion(name, known)}"
        elif is_class or (isinstance(value, Mapping) and "_target_" in value):
            yield from _target_problems(path, value, base, partial=is_class)
        else:
            annotation = signature.types.get(name, Any)
            yield from _value_problems(path, value, annotation, limits.get(name))
    if partial:
        return
    for name in settable:
        if name in signature.required and name not in given:
            yield f"{key}.{name} is missing"


def _value_problems(key: str, value: Any, annotation: Any, limit: Any) -> Iterator[str]:
    """Yield a sentence if a value is out of its range or, without a range, has the wrong type."""
    types = {annotation}
    if get_origin(annotation) not in CHECKED_TYPES:
        types = set(get_args(annotation)) or types
    if value is None and NoneType in types:
        return
    is_plain = all(part in PLAIN_TYPES or get_origin(part) in CHECKED_TYPES for part in types)
    if limit is None:
        limit = annotation if is_plain else Any
    try:
        TypeAdapter(limit, config=STRICT).validate_python(value)
    except ValidationError as error:
        reasons = [reason_of_invalid_value(problem) for problem in error.errors()]
        yield f"{key}={value!r}: {' or '.join(reasons)}"
