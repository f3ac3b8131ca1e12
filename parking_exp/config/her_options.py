"""Allowed values of the HER options: goal strategies, relabelling of collision, termination and velocity."""

from typing import Any, Literal, get_args

GoalStrategy = Literal["future", "final", "episode", "random"]
RelabelCollision = Literal["keep", "sb3", "exclude"]
RelabelTerminated = Literal["sb3", "goal", "goal_and_crash", "env"]
GoalVelocity = Literal["achieved", "zero"]

GOAL_STRATEGIES: tuple[str, ...] = get_args(GoalStrategy)
# Arguments of `HerBuffer` that say how transitions are relabelled, with their choices.
RELABEL_OPTIONS: dict[str, Any] = {
    "relabel_collision": RelabelCollision,
    "relabel_terminated": RelabelTerminated,
    "goal_velocity": GoalVelocity,
}
# Arguments that mean nothing without virtual goals.
HER_OPTIONS = ("n_sampled_goal", *RELABEL_OPTIONS)
