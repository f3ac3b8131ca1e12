"""Ranges and choices of well-known arguments of third-party classes, which their signatures do not state."""

from typing import Annotated, Any, Literal

from pydantic import Field

from parking_exp.config_model import Count, NonNegative, Positive, PositiveFloat, Share

GoalStrategy = Literal["future", "final", "episode", "random"]
RelabelCollision = Literal["keep", "sb3", "exclude"]
RelabelTerminated = Literal["sb3", "goal", "goal_and_crash", "env"]
GoalVelocity = Literal["achieved", "zero"]
# Arguments of `HerBuffer` that say how transitions are relabelled, with their choices.
RELABEL_OPTIONS: dict[str, Any] = {
    "relabel_collision": RelabelCollision,
    "relabel_terminated": RelabelTerminated,
    "goal_velocity": GoalVelocity,
}
# Arguments that have no effect without virtual goals.
HER_OPTIONS = ("n_sampled_goal", *RELABEL_OPTIONS)

Decay = Annotated[float, Field(ge=0, lt=1)]
LIMITS: dict[str, Any] = {
    "learning_rate": PositiveFloat,
    "learning_starts": Count,
    "batch_size": Annotated[int, Field(ge=1, le=1_000_000)],
    "tau": Share,
    "gamma": Share,
    "train_freq": Positive | Annotated[tuple[Positive, Literal["step", "episode"]], Field(strict=False)],
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
    **dict.fromkeys(("policy_kwargs", "optimizer_kwargs", "features_extractor_kwargs"), dict),
}
# By class, arguments whose names mean something else elsewhere.
NOISE = {"mean": float | list[float], "sigma": NonNegative | list[NonNegative]}
CLASS_LIMITS: dict[str, dict[str, Any]] = {
    "LinearSchedule": {"start": PositiveFloat, "end": NonNegative, "end_fraction": Share},
    "ConstantSchedule": {"val": PositiveFloat},
    "NormalActionNoise": NOISE,
    "EpsilonRandomActionNoise": {**NOISE, "epsilon": Annotated[float, Field(ge=0, le=1)]},
    "OrnsteinUhlenbeckActionNoise": {**NOISE, "theta": NonNegative, "dt": PositiveFloat},
}
