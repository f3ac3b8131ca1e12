"""The `env` group of parking-v0: highway-env's options under their own names, and six of ours."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field

from parking_exp.config_model import (
    Bounds,
    ConfigModel,
    Duration,
    Name,
    Pixels,
    PositiveFloat,
    Range,
)

ENV_ID = "parking-v0"
DEFAULT_FEATURES = ["x", "y", "vx", "vy", "cos_h", "sin_h"]
DEFAULT_SCALES = [100, 100, 5, 5, 1, 1]
OURS = {"task", "name", "simulator", "reward", "training_duration", "training_success_goal_reward"}


class ObservationConfig(ConfigModel):
    """highway-env's `observation` options."""

    type: Literal["KinematicsGoal"]  # stored, so that highway-env accepts the `env` section of a run's config
    features: Annotated[list[Literal["x", "y", "vx", "vy", "cos_h", "sin_h"]], Field(min_length=1)]
    scales: list[PositiveFloat]
    normalize: bool


class ActionConfig(ConfigModel):
    """highway-env's `action` options."""

    type: Literal["ContinuousAction"]
    acceleration_range: Range | None
    steering_range: Range | None
    speed_range: Range | None
    longitudinal: bool
    lateral: bool
    dynamical: bool
    clip: bool


class ParkingConfig(ConfigModel):
    """The `env` group of parking-v0."""

    simulators: ClassVar[tuple[str, ...]] = ("vectorized", "highway_env")

    task: Literal["parking"]
    name: Name
    simulator: Literal["vectorized", "highway_env"]
    reward: Literal["dense", "sparse"]
    training_duration: Duration | None
    training_success_goal_reward: PositiveFloat | None

    observation: ObservationConfig
    action: ActionConfig
    reward_weights: Annotated[list[Annotated[float, Field(ge=0)]], Field(min_length=6, max_length=6)]
    success_goal_reward: PositiveFloat
    collision_reward: float
    steering_range: PositiveFloat
    simulation_frequency: Annotated[int, Field(ge=1, le=1000)]
    policy_frequency: Annotated[int, Field(ge=1, le=100)]  # episode_steps() counts duration x policy_frequency steps
    duration: Duration
    vehicles_count: Annotated[int, Field(ge=0, le=26)]
    add_walls: bool
    other_vehicles_type: str
    neighbour_vehicles_connected_lanes: bool
    screen_width: Pixels
    screen_height: Pixels
    centering_position: Bounds
    scaling: PositiveFloat
    show_trajectories: bool
    render_agent: bool
    offscreen_rendering: bool | None
    real_time_rendering: bool

    def for_training(self) -> Self:
        """Return the config of training envs: `training_duration` and `training_success_goal_reward` applied."""
        values = {"duration": self.training_duration, "success_goal_reward": self.training_success_goal_reward}
        return self.model_copy(update={key: value for key, value in values.items() if value is not None})

    def highway_options(self) -> dict[str, Any]:
        """Return the `config` for `gym.make(ENV_ID, config=...)`."""
        options = self.model_dump(exclude=OURS)
        options["action"] = {key: value for key, value in options["action"].items() if value is not None}
        return options

    def episode_steps(self) -> int:
        """Return the longest episode in policy steps, counted like highway-env does: by adding floats."""
        time, steps = 0.0, 0
        while time < self.duration:
            time += 1 / self.policy_frequency
            steps += 1
        return steps

    @property
    def imports(self) -> dict[str, str]:
        """Keys by which making an env imports a class, and their dotted paths."""
        return {"other_vehicles_type": self.other_vehicles_type}

    def problems(self) -> Iterator[str]:
        """Yield a sentence for each rule between keys that is violated."""
        observation, action = self.observation, self.action
        if len(observation.scales) != len(observation.features):
            yield "env.observation.scales has another length than env.observation.features; give one scale for each"
        if not (action.longitudinal or action.lateral):
            yield "env.action.longitudinal and env.action.lateral are both false; set one of them to true"
        if (stricter := self.training_success_goal_reward) is not None and stricter > self.success_goal_reward:
            yield (
                f"env.training_success_goal_reward={stricter} is above env.success_goal_reward="
                f"{self.success_goal_reward}: agents would learn to stop short of the goal"
            )
        if self.policy_frequency > self.simulation_frequency:
            yield f"env.policy_frequency={self.policy_frequency} is above env.simulation_frequency"
        if self.simulator == "vectorized" and action.dynamical:
            yield "env.action.dynamical is not simulated by env.simulator=vectorized; use env.simulator=highway_env"

    def model_problems(self, features: str, buffer: Mapping[str, Any], *, relabels: bool) -> Iterator[str]:
        """Yield what is wrong with the observation for the policy's features, and for HER if that is used."""
        observation = self.observation
        if relabels and (observation.features != DEFAULT_FEATURES or observation.scales != DEFAULT_SCALES):
            yield "env.observation: HER needs the features and scales of conf/env/parking.yaml; or use buffer=replay"
        if observation.features != DEFAULT_FEATURES and features != "raw":
            yield "algorithm.features needs the observation features of conf/env/parking.yaml; or use raw"
