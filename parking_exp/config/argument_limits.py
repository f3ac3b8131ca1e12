"""Ranges and choices of well-known arguments of third-party classes, which their signatures do not state."""

from typing import Annotated, Any, Literal

from pydantic import Field

from parking_exp.config_model import Count, Positive, PositiveFloat, Share

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
    "ent_coef": PositiveFloat | Annotated[str, Field(pattern=r"^auto(_\d+(\.\d*)?(e-?\d+)?)?$")],
    "target_entropy": float | Literal["auto"],
    "n_sampled_goal": Positive,
    "goal_selection_strategy": GoalStrategy,
    **RELABEL_OPTIONS,
    "n_critics": Annotated[int, Field(ge=1, le=100)],
    "n_quantiles": Annotated[int, Field(ge=1, le=10_000)],
    **dict.fromkeys(("policy_kwargs", "optimizer_kwargs", "features_extractor_kwargs"), dict),
}
