"""Ranges and choices of well-known third-party arguments, which signatures do not state."""

import math
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
)

from parking_exp.config_model import (
    Count,
    GoalStrategy,
    GoalVelocity,
    RelabelCollision,
    RelabelTerminated,
    Share,
    Two,
)

# How values are checked against a limit.
STRICT = ConfigDict(strict=True, allow_inf_nan=False)


def _check_initial_value(coefficient: str) -> str:
    initial_value = float(coefficient.removeprefix("auto").removeprefix("_") or 1)
    if not 0 < initial_value < math.inf:
        raise ValueError("the initial value must be above 0, and finite")
    return coefficient


# Arguments of `HerBuffer` that say how transitions are relabelled.
RELABEL_OPTIONS: dict[str, Any] = {
    "relabel_collision": RelabelCollision,
    "relabel_terminated": RelabelTerminated,
    "goal_velocity": GoalVelocity,
}
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
    "train_freq": Count | None,  # rules compare both with `updates_per_step`
    "gradient_steps": Count | None,
    "policy_delay": Count,
    "target_update_interval": Count,
    "target_policy_noise": NonNegativeFloat,
    "target_noise_clip": NonNegativeFloat,
    "ent_coef": PositiveFloat | AutomaticCoefficient,
    "target_entropy": float | Literal["auto"],
    "stats_window_size": Count,
    "use_sde": bool,
    "sde_sample_freq": int,
    "use_sde_at_warmup": bool,
    "handle_timeout_termination": bool,
    "top_quantiles_to_drop_per_net": NonNegativeInt,
    "n_sampled_goal": Count,
    "goal_selection_strategy": GoalStrategy | None,
    **RELABEL_OPTIONS,
    "n_critics": Annotated[int, Field(ge=1, le=100)],
    "n_quantiles": Annotated[int, Field(ge=1, le=10_000)],
    "weight_decay": NonNegativeFloat,
    "eps": NonNegativeFloat,
    "betas": Two[Decay],
    **dict.fromkeys(("policy_kwargs", "optimizer_kwargs", "features_extractor_kwargs"), dict),
}
NOISE = {
    "mean": float | list[float],
    "sigma": NonNegativeFloat | list[NonNegativeFloat],
    "dtype": Literal["float32", "float64"],
}
# Limits in classes where names mean something else than above.
CLASS_LIMITS: dict[str, dict[str, Any]] = {
    "LinearSchedule": {"start": PositiveFloat, "end": NonNegativeFloat, "end_fraction": Share},
    "ConstantSchedule": {"val": PositiveFloat},
    "NormalActionNoise": NOISE,
    "EpsilonRandomActionNoise": {**NOISE, "epsilon": Annotated[float, Field(ge=0, le=1)]},
    "OrnsteinUhlenbeckActionNoise": {**NOISE, "theta": NonNegativeFloat, "dt": PositiveFloat},
}
# Argument names of classes as `conf/` uses them: these are checked without importing torch.
OFF_POLICY_ARGUMENTS = {
    "learning_rate", "learning_starts", "batch_size", "tau", "gamma", "train_freq",
    "gradient_steps", "action_noise", "policy_kwargs",
}  # fmt: skip
SAC_ARGUMENTS = {
    "ent_coef", "target_update_interval", "target_entropy", "stats_window_size",
    "use_sde", "sde_sample_freq", "use_sde_at_warmup",
}  # fmt: skip
TD3_ARGUMENTS = {"policy_delay", "target_policy_noise", "target_noise_clip", "stats_window_size"}
REPLAY_ARGUMENTS = {"goal_selection_strategy", "handle_timeout_termination"}
KNOWN_ARGUMENTS: dict[str, list[set[str]]] = {
    "parking_exp.algorithms.DDPG": [OFF_POLICY_ARGUMENTS],
    "parking_exp.algorithms.SAC": [OFF_POLICY_ARGUMENTS | SAC_ARGUMENTS],
    "parking_exp.algorithms.TD3": [OFF_POLICY_ARGUMENTS | TD3_ARGUMENTS],
    "parking_exp.buffers.HerBuffer": [REPLAY_ARGUMENTS, {*REPLAY_ARGUMENTS, *HER_OPTIONS}],
    "stable_baselines3.common.noise.NormalActionNoise": [{"mean", "sigma"}],
    "stable_baselines3.common.utils.LinearSchedule": [{"start", "end", "end_fraction"}],
}
