"""Ranges of well-known third-party arguments, which their signatures do not state.

They hold for any class.
"""

from typing import Annotated, Any, Literal

from pydantic import Field

from parking_exp.config.her_options import RELABEL_OPTIONS, GoalStrategy
from parking_exp.config.schema import Count, NonNegative, Positive, PositiveFloat, Share

Decay = Annotated[float, Field(ge=0, lt=1)]

LIMITS: dict[str, Any] = {
    "learning_rate": PositiveFloat,
    "learning_starts": Count,
    "batch_size": Annotated[int, Field(ge=1, le=1_000_000)],
    "tau": Share,
    "gamma": Share,
    "train_freq": Positive | list,  # of a list, see rules
    "gradient_steps": Annotated[int, Field(ge=-1)],  # -1: as many as steps
    "policy_delay": Positive,
    "target_update_interval": Positive,
    "target_policy_noise": NonNegative,
    "target_noise_clip": NonNegative,
    "ent_coef": PositiveFloat | Annotated[str, Field(pattern=r"^auto(_\d+(\.\d*)?(e-?\d+)?)?$")],
    "target_entropy": float | Literal["auto"],
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
# Arguments whose names mean something else elsewhere, by the class that takes them.
NOISE = {"mean": float | list[float], "sigma": NonNegative | list[NonNegative]}
CLASS_LIMITS: dict[str, dict[str, Any]] = {
    "LinearSchedule": {"start": PositiveFloat, "end": NonNegative, "end_fraction": Share},
    "ConstantSchedule": {"val": PositiveFloat},
    "NormalActionNoise": NOISE,
    "OrnsteinUhlenbeckActionNoise": {**NOISE, "theta": NonNegative, "dt": PositiveFloat},
}


def limits_of(class_name: str) -> dict[str, Any]:
    """Return the types and ranges of arguments of a class."""
    return CLASS_LIMITS.get(class_name, LIMITS)
