"""Ranges of well-known third-party arguments, which their signatures do not state.

They hold for any class, are checked without importing it, and leave out `_target_` nodes, such as schedules.
"""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from parking_exp.config.her_options import RELABEL_OPTIONS, GoalStrategy
from parking_exp.config.messages import problems_of
from parking_exp.config.schema import Count, NonNegative, Positive, PositiveFloat, Share

Decay = Annotated[float, Field(ge=0, lt=1)]

LIMITS: dict[str, Any] = {
    "learning_rate": PositiveFloat,
    "buffer_size": Positive,
    "learning_starts": Count,
    "batch_size": Positive,
    "tau": Share,
    "gamma": Share,
    "train_freq": Positive,
    "gradient_steps": Annotated[int, Field(ge=-1)],  # -1: as many as steps
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
    "n_critics": Annotated[int, Field(ge=1, le=100)],
    "n_quantiles": Annotated[int, Field(ge=1, le=10_000)],
    "weight_decay": NonNegative,
    "eps": NonNegative,
    "betas": Annotated[list[Decay], Field(min_length=2, max_length=2)],
}
# What is allowed of text instead of a number.
TEXT_LIMITS: dict[str, Any] = {
    "ent_coef": Annotated[str, Field(pattern=r"^auto(_\d+(\.\d*)?(e-?\d+)?)?$")],
    "target_entropy": Literal["auto"],
}
# Arguments whose names mean something else elsewhere, by the class that takes them; of lists, each entry.
CLASS_LIMITS: dict[str, dict[str, Any]] = {
    "LinearSchedule": {"start": PositiveFloat, "end": NonNegative, "end_fraction": Share},
    "ConstantSchedule": {"val": PositiveFloat},
    "NormalActionNoise": {"mean": float, "sigma": NonNegative},
    "OrnsteinUhlenbeckActionNoise": {"mean": float, "sigma": NonNegative, "theta": NonNegative, "dt": PositiveFloat},
}


def has_limit(name: str, target: str) -> bool:
    """Return whether an argument of a class has a known range."""
    return name in CLASS_LIMITS.get(target.rpartition(".")[2], LIMITS)


def check_limits(key: str, arguments: Mapping[str, Any], target: str) -> Iterator[str]:
    """Yield what is out of range in the arguments of a class, nested ones included."""
    limits = CLASS_LIMITS.get(target.rpartition(".")[2])
    for name, value in arguments.items():
        path, is_node = f"{key}.{name}", isinstance(value, Mapping) and "_target_" in value
        valid = (LIMITS if limits is None else limits).get(name)
        if isinstance(value, Mapping) and (is_node or name not in LIMITS):
            yield from check_limits(path, value, str(value.get("_target_")))
        elif value is None or not has_limit(name, target) or (name == "train_freq" and isinstance(value, list)):
            continue
        elif limits is not None and isinstance(value, list):
            for index, entry in enumerate(value):
                yield from problems_of(valid, entry, f"{path}.{index}")
        else:
            yield from problems_of(TEXT_LIMITS.get(name, valid) if isinstance(value, str) else valid, value, path)
