"""Is a config one that can run? Types and ranges, third-party arguments, and the rules between keys.

Every complaint is one sentence that names the key, what is wrong and the closest valid choice. Nothing here imports
torch or mlflow: a typo is refused in well under two seconds.
"""

import re
from collections.abc import Mapping, Set
from typing import Annotated, Any, Literal, TypeVar

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from parking_exp.config import Count, Positive, PositiveFloat, RunConfig, Share, SweepOptions, ThirdParty
from parking_exp.errors import ConfigError
from parking_exp.rules import check_rules
from parking_exp.signatures import Signature, UnknownTarget, signature
from parking_exp.wording import closest, no_target

Model = TypeVar("Model", bound=BaseModel)

# Ranges that third-party signatures don't state. Scalars only: a schedule or "auto" passes.
ARGUMENT_RANGES: dict[str, Any] = {
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
    "target_policy_noise": Annotated[float, Field(ge=0)],
    "target_noise_clip": Annotated[float, Field(ge=0)],
    "ent_coef": PositiveFloat,
    "target_entropy": float,
    "stats_window_size": Positive,
    "top_quantiles_to_drop_per_net": Count,
    "n_sampled_goal": Positive,
    "goal_selection_strategy": Literal["future", "final", "episode", "random"],
    "relabel_collision": Literal["keep", "sb3"],
    "relabel_terminated": Literal["sb3", "goal", "goal_and_crash"],
    "goal_velocity": Literal["achieved", "zero"],
    "policy": Literal["MultiInputPolicy"],
}
# Keys of a composed config that say which runs there are, and nothing about any of them.
SWEEP_KEYS = {"seeds", "cells", *SweepOptions.model_fields}
# Constructor arguments of an algorithm that the run feeds from elsewhere, and from where.
FED_TO_ALGORITHM = {
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
# Arguments that may be null in our YAML although the library's own annotation says otherwise: we fill them in.
UNSET = {"train_freq", "gradient_steps"}
FED_TO_BUFFER = {
    "observation_space": "env",
    "action_space": "env",
    "env": "env",
    "n_envs": "n_envs",
    "device": "device",
    "reward": "env",
}


def validate(config: DictConfig | Mapping[str, Any] | RunConfig) -> RunConfig:
    """Check a composed config and return it typed.

    Raises:
        ConfigError: with one sentence for each of the first five things that are wrong.
    """
    if isinstance(config, RunConfig):
        return config
    run = parse(RunConfig, config, without=SWEEP_KEYS)
    problems = [
        *_check_arguments("algorithm", run.algorithm, FED_TO_ALGORITHM),
        *_check_arguments("buffer", run.buffer, FED_TO_BUFFER, own={"buffer_size", "optimize_memory_usage"}),
    ]
    problems = problems or check_rules(run)
    if problems:
        raise ConfigError("\n".join(problems[:5]))
    return run


def parse(model: type[Model], config: DictConfig | Mapping[str, Any], without: Set[str] = frozenset()) -> Model:
    """Resolve interpolations and check a config, less some keys, against a schema.

    Raises:
        ConfigError: it doesn't fit.
    """
    try:
        node = config if isinstance(config, DictConfig) else OmegaConf.create(dict(config))
        plain: Any = OmegaConf.to_container(node, resolve=True, throw_on_missing=True)
    except OmegaConfBaseException as error:
        raise ConfigError(f"{error.full_key}: {str(error).splitlines()[0]}") from error
    return check(model, {key: value for key, value in plain.items() if key not in without})


def check(model: type[Model], plain: Mapping[str, Any]) -> Model:
    """Check plain values against a schema.

    Raises:
        ConfigError: they don't fit.
    """
    try:
        return model.model_validate(plain)
    except ValidationError as error:
        raise ConfigError("\n".join(_sentences(error, model)[:5])) from error


def _sentences(error: ValidationError, model: type[BaseModel] | None, prefix: str = "") -> list[str]:
    return [_sentence(item, model, prefix) for item in error.errors()]


def _sentence(item: Any, model: type[BaseModel] | None, prefix: str) -> str:
    parts = [str(part) for part in item["loc"] if part != "nullable"]
    key = ".".join([*([prefix] if prefix else []), *parts])
    context, value = item.get("ctx", {}), item["input"]
    match item["type"]:
        case "extra_forbidden":
            return f"{key}: there is no such key{closest(parts[-1], _keys(model, parts[:-1]))}"
        case "missing":
            return f"{key} is missing"
        case "greater_than_equal":
            return f"{key}={value} is out of range; the closest valid choice is {context['ge']}"
        case "less_than_equal":
            return f"{key}={value} is out of range; the closest valid choice is {context['le']}"
        case "less_than":
            return f"{key}={value} is out of range; the closest valid choice is {context['lt'] - 1}"
        case "greater_than":
            return f"{key}={value} is out of range; it must be greater than {context['gt']}"
        case "literal_error":
            choices = [part.strip().strip("'") for part in context["expected"].replace(" or ", ", ").split(", ")]
            hint = closest(str(value), choices) if len(choices) > 1 else f"; it can only be {choices[0]}"
            return f"{key}={value} is not a valid choice{hint}"
        case "model_type":
            return f"{key}={value!r} is not a group of keys; it holds {', '.join(_keys(model, parts))}"
        case "string_pattern_mismatch" if parts == ["device"]:
            return f"device={value!r} is not a valid choice; choose from cpu, auto, cuda, cuda:N, mps"
        case "string_pattern_mismatch":
            return f"{key}={value!r} is not valid; it must match {context['pattern']}"
    problem = item["msg"][0].lower() + item["msg"][1:]
    return f"{key}={value!r}: {problem}"


def _keys(model: type[BaseModel] | None, path: list[str]) -> list[str]:
    """Keys of the (nested) section at a path."""
    for part in path:
        field = model.model_fields.get(part) if model else None
        annotation = field.annotation if field else None
        model = annotation if isinstance(annotation, type) and issubclass(annotation, BaseModel) else None
    return list(model.model_fields) if model else []


def _check_arguments(
    key: str, section: ThirdParty, fed: Mapping[str, str | None], own: set[str] | None = None
) -> list[str]:
    """Check a section's constructor arguments, and every `_target_` node among them."""
    try:
        expected = signature(section.target)
    except UnknownTarget as error:
        return [no_target(f"{key}._target_", section.target, error)]
    problems = []
    for name in section.arguments:
        if name in fed:
            source = fed[name]
            problems.append(f"{key}.{name} is set by the run itself" + (f"; use {source}" if source else ""))
    given = {name: value for name, value in section.arguments.items() if name not in fed}
    names = set(section.arguments) | set(type(section).model_fields) - {"target"}
    supplied = set(fed) | (own or set()) | {"policy_kwargs", "features", "net_arch"}
    problems += _check_call(key, section.target, expected, given, supplied=supplied, siblings=names)
    return problems


def _check_call(
    key: str, target: str, expected: Signature, given: Mapping[str, Any], supplied: set[str], siblings: set[str]
) -> list[str]:
    problems = []
    choices = (set(expected.parameters) - supplied) | siblings
    for name, value in given.items():
        parameter = expected.parameters.get(name)
        if parameter is None:
            if not expected.open:
                problems.append(f"{key}.{name}: {target} has no such argument{closest(name, choices - {name})}")
            continue
        if isinstance(value, Mapping) and "_target_" in value:
            problems += _check_node(f"{key}.{name}", value)
        elif name in UNSET and value is None:
            continue
        elif not parameter.accepts(value):
            problems.append(f"{key}.{name}={value!r} has the wrong type; {target} takes {parameter.annotation}")
        elif name in ARGUMENT_RANGES and isinstance(value, int | float | str):
            problems += _check_range(f"{key}.{name}", name, value)
    for name, parameter in expected.parameters.items():
        if parameter.required and name not in given and name not in supplied:
            problems.append(f"{key}.{name} is missing; {target} needs it")
    return problems


def _check_node(key: str, node: Mapping[str, Any]) -> list[str]:
    target = node["_target_"]
    try:
        expected = signature(target)
    except UnknownTarget as error:
        return [no_target(f"{key}._target_", target, error)]
    given = {name: value for name, value in node.items() if name not in {"_target_", "_partial_"}}
    return _check_call(key, target, expected, given, supplied=set(), siblings=set())


def _check_range(key: str, name: str, value: float | str) -> list[str]:
    if name in {"ent_coef", "target_entropy"} and isinstance(value, str):
        fits = re.fullmatch(r"auto(_\d+(\.\d*)?(e-?\d+)?)?" if name == "ent_coef" else "auto", value)
        return [] if fits else [f"{key}={value} is not a valid choice; choose from auto and a number"]
    try:
        TypeAdapter(ARGUMENT_RANGES[name]).validate_python(value, strict=True)
    except ValidationError as error:
        return [_sentence({**item, "loc": ()}, None, key) for item in error.errors()]
    return []
