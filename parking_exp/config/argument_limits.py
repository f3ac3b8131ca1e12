"""Ranges and choices of well-known arguments of third-party classes, which their signatures do not
state.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, NonNegativeFloat, NonNegativeInt, PositiveFloat

from parking_exp.config_model import Count, Share


def _check_initial_value(coefficient: str) -> str:
    initial_value = float(coefficient.removeprefix("auto").removeprefix("_") or 1)
    if not 0 < initial_value < math.inf:
        raise ValueError("the initial value must be above 0, and finite")
    return coefficient


# Arguments of `HerBuffer` that say how transitions are relabelled.
RELABEL_OPTIONS = ("relabel_collision", "relabel_terminated", "goal_velocity")
# Arguments that have no effect without virtual goals.
HER_OPTIONS = ("n_sampled_goal", *RELABEL_OPTIONS)

Decay = Annotated[float, Field(ge=0, lt=1)]
AutomaticCoefficient = Annotated[
    str, Field(pattern=r"^auto(_\d+(\.\d*)?(e-?\d+)?)?$"), AfterValidator(_check_initial_value)
]
LIMITS: dict[str, Any] = {
    "learning_rate": PositiveFloat,
    "learning_starts": NonNegativeInt,
    "batch_size": Annotated[int, Field(ge=1, le=1_000_000)],
    "tau": Share,
    "gamma": Share,
    "train_freq": Count | Annotated[tuple[Count, Literal["step", "episode"]], Field(strict=False)],
    "gradient_steps": Literal[-1] | Count,  # -1: as many as steps
    "policy_delay": Count,
    "target_update_interval": Count,
    "target_policy_noise": NonNegativeFloat,
    "target_noise_clip": NonNegativeFloat,
    "ent_coef": PositiveFloat | AutomaticCoefficient,
    "target_entropy": float | Literal["auto"],
    "stats_window_size": Count,
    "top_quantiles_to_drop_per_net": NonNegativeInt,
    "n_sampled_goal": Count,
    "n_critics": Annotated[int, Field(ge=1, le=100)],
    "n_quantiles": Annotated[int, Field(ge=1, le=10_000)],
    "weight_decay": NonNegativeFloat,
    "eps": NonNegativeFloat,
    "betas": Annotated[list[Decay], Field(min_length=2, max_length=2)],
    **dict.fromkeys(("policy_kwargs", "optimizer_kwargs", "features_extractor_kwargs"), dict),
}
# By class, arguments whose names mean something else elsewhere.
NOISE = {
    "mean": float | list[float],
    "sigma": NonNegativeFloat | list[NonNegativeFloat],
    "dtype": Literal["float32", "float64"],
}
CLASS_LIMITS: dict[str, dict[str, Any]] = {
    "LinearSchedule": {"start": PositiveFloat, "end": NonNegativeFloat, "end_fraction": Share},
    "ConstantSchedule": {"val": PositiveFloat},
    "NormalActionNoise": NOISE,
    "EpsilonRandomActionNoise": {**NOISE, "epsilon": Annotated[float, Field(ge=0, le=1)]},
    "OrnsteinUhlenbeckActionNoise": {**NOISE, "theta": NonNegativeFloat, "dt": PositiveFloat},
}
