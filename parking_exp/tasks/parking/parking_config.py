"""The `env` group of parking: highway-env's options under their own names, lots, and some more."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

from omegaconf import OmegaConf
from pydantic import Field, PositiveFloat, model_validator

from parking_exp.config_model import (
    Bounds,
    ConfigModel,
    Duration,
    NonEmptyText,
    Pixels,
    Range,
    left_out,
)
from parking_exp.tasks.parking.lot_config import LotConfig, VehiclesCount, bounds
from parking_exp.tasks.task_config import TaskConfig

ENV_ID = "parking-v0"
DEFAULT_FEATURES = ["x", "y", "vx", "vy", "cos_h", "sin_h"]
LotName = Annotated[str, Field(pattern=r"^\w+$")]
DEFAULT_SCALES = [100, 100, 5, 5, 1, 1]
OUR_KEYS = {
    "task",
    "name",
    "metrics",
    "simulator",
    "reward",
    "training_duration",
    "training_success_goal_reward",
    "standing_reward",
    "obstacles",
    "lot",
    "lots",
    "level",
    "levels",
}
OUR_OBSERVATION_KEYS = {"vehicles_count", "rays", "rays_range_m"}
RAYS_RANGE_M = 10.0  # the default of the config and of the wrapper
MAX_VEHICLES = 26  # slots but for those of start and goal


class ObservationConfig(ConfigModel):
    """highway-env's `observation` options, and what is seen beside the car."""

    # stored, so that highway-env accepts the `env` section of most configs.
    type: Literal["KinematicsGoal"]
    features: list[str]
    scales: list[PositiveFloat]
    normalize: bool
    vehicles_count: Annotated[int, Field(ge=0, le=100)] = 0
    rays: int = left_out(0, ge=0, le=360)
    rays_range_m: float = left_out(RAYS_RANGE_M, gt=0, le=1000)


# highway-env's own ranges, where the config has none [m/s2, rad, m/s].
RANGES = {
    "acceleration_range": (-5.0, 5.0),
    "steering_range": (-math.pi / 4, math.pi / 4),
    "speed_range": (-40.0, 40.0),
}


class ActionConfig(ConfigModel):
    """highway-env's `action` options."""

    type: Literal["ContinuousAction"]
    acceleration_range: Range | None
    steering_range: Range | None
    speed_range: Range | None
    longitudinal: Literal[True]
    lateral: Literal[True]
    dynamical: Literal[False]
    clip: bool

    @property
    def ranges(self) -> list[Sequence[float]]:
        """The ranges of acceleration and steering [m/s2, rad]."""
        return [self.range_of("acceleration_range"), self.range_of("steering_range")]

    def range_of(self, name: str) -> Sequence[float]:
        """Return a range by its name, or highway-env's own."""
        limits: Sequence[float] = getattr(self, name) or RANGES[name]
        return limits

    def limit(self, name: str) -> float:
        """Return how far a range goes in both directions; at most 0 if it has only one."""
        low, high = self.range_of(name)
        return min(-low, high)


class ParkingConfig(TaskConfig):
    """The `env` group of parking, on highway-env's lot or on others."""

    simulators: ClassVar[tuple[str, ...]] = ("vectorized", "highway_env")
    agent_keys: ClassVar[tuple[str, ...]] = ("observation",)
    training_keys: ClassVar[tuple[str, ...]] = (
        "simulator",
        "reward",
        "collision_reward",
        "standing_reward",
        "training_duration",
        "training_success_goal_reward",
        "observation.vehicles_count",
        "observation.rays",
        "observation.rays_range_m",
    )

    task: Literal["parking"]
    simulator: Literal["vectorized", "highway_env"]
    reward: Literal["dense", "sparse"]
    training_duration: Duration | None
    training_success_goal_reward: PositiveFloat | None
    obstacles: Annotated[int, Field(ge=0, le=50)] = 0
    lot: LotConfig | None = left_out(None)  # None: highway-env's own lot
    # Each scene is on one of these lots, and `lot` is None.
    lots: dict[LotName, LotConfig] | None = left_out(None)
    # `lot` takes its numbers from one of the levels, by interpolation.
    level: NonEmptyText | None = left_out(None)
    levels: Annotated[dict[str, dict[str, Any]] | None, Field(exclude=True)] = None

    observation: ObservationConfig
    action: ActionConfig
    reward_weights: Annotated[
        list[Annotated[float, Field(ge=0)]], Field(min_length=6, max_length=6)
    ]
    success_goal_reward: PositiveFloat
    collision_reward: float
    standing_reward: float = left_out(0.0, le=0)
    steering_range: PositiveFloat
    simulation_frequency: Annotated[int, Field(ge=1, le=1000)]
    # `episode_steps` counts duration x policy_frequency steps.
    policy_frequency: Annotated[int, Field(ge=1, le=100)]
    duration: Duration
    vehicles_count: VehiclesCount
    add_walls: bool
    other_vehicles_type: Literal["highway_env.vehicle.behavior.IDMVehicle"]
    neighbour_vehicles_connected_lanes: bool
    screen_width: Pixels
    screen_height: Pixels
    centering_position: Bounds
    scaling: PositiveFloat
    show_trajectories: bool
    render_agent: bool
    offscreen_rendering: bool | None
    real_time_rendering: bool

    @model_validator(mode="before")
    @classmethod
    def _complete_lots(cls, data: Any) -> Any:
        """Complete each of the `lots` by the keys that they share, which are in `lot`."""
        if not isinstance(data, Mapping) or "lots" not in data:
            return data
        lots = data["lots"]
        if not lots:
            raise ValueError("lots: name one or more, or choose an env that has one lot")
        shared = data.get("lot") or {}
        if not isinstance(lots, Mapping) or not isinstance(shared, Mapping):
            return data
        complete = dict(lots)
        for name, lot in lots.items():
            if isinstance(lot, Mapping):
                complete[name] = OmegaConf.to_container(OmegaConf.merge(shared, lot))
        return {**data, "lot": None, "lots": complete}

    @property
    def lot_configs(self) -> dict[str, LotConfig]:
        """The lots of scenes by the keys of their sections; none for highway-env's own lot."""
        if self.lots:
            return {f"env.lots.{name}": lot for name, lot in self.lots.items()}
        if self.lot is not None:
            return {"env.lot": self.lot}
        return {}

    def for_training(self) -> Self:
        """Return the config with `training_duration` and `training_success_goal_reward` applied."""
        changes = {}
        if self.training_duration is not None:
            changes["duration"] = self.training_duration
        if self.training_success_goal_reward is not None:
            changes["success_goal_reward"] = self.training_success_goal_reward
        return self.model_copy(update=changes)

    def highway_options(self) -> dict[str, Any]:
        """Return the `config` for `gym.make(ENV_ID, config=...)`."""
        options = self.model_dump(exclude=OUR_KEYS)
        options["observation"] = self.observation.model_dump(exclude=OUR_OBSERVATION_KEYS)
        options["action"] = self.action.model_dump(exclude_none=True)
        options["vehicles_count"] = self.vehicles_range[1]
        return options

    @property
    def vehicles_range(self) -> tuple[int, int]:
        """The lowest and the highest number of parked cars of a scene."""
        lots = self.lot_configs.values()
        if not lots:
            return bounds(self.vehicles_count)
        ranges = [lot.vehicles_range(self.vehicles_count) for lot in lots]
        return min(low for low, _ in ranges), max(high for _, high in ranges)

    @property
    def frames_per_step(self) -> int:
        """Simulation frames of a policy step."""
        return self.simulation_frequency // self.policy_frequency

    @property
    def episode_steps(self) -> int:
        """The most policy steps of an episode, counted by adding floats like highway-env."""
        time = 0.0
        steps = 0
        while time < self.duration:
            time += 1 / self.policy_frequency
            steps += 1
        return steps

    def problems(self) -> Iterator[str]:
        """Yield a sentence for each rule between keys that is violated."""
        for name, value in (("features", DEFAULT_FEATURES), ("scales", DEFAULT_SCALES)):
            if getattr(self.observation, name) != value:
                yield f"env.observation.{name} has one legal value: {value}"
        stricter = self.training_success_goal_reward
        if stricter is not None and stricter > self.success_goal_reward:
            yield (
                f"env.training_success_goal_reward={stricter} is above env.success_goal_reward="
                f"{self.success_goal_reward}: agents would learn to stop short of the goal"
            )
        if self.policy_frequency > self.simulation_frequency:
            yield f"env.policy_frequency={self.policy_frequency} is above env.simulation_frequency"
        lots = self.lot_configs
        if not lots and self.vehicles_range[1] > MAX_VEHICLES:
            yield f"env.vehicles_count: highway-env's own lot has room for {MAX_VEHICLES}"
        if self.standing_reward and not lots:
            yield (
                f"env.standing_reward={self.standing_reward:g}: highway-env's own lot has none; "
                "set it to 0, or choose another lot, such as env=parking_parallel"
            )
        if lots and self.obstacles:
            yield (
                f"env.obstacles={self.obstacles}: only highway-env's own lot has obstacles; "
                "set it to 0"
            )
        for key, lot in lots.items():
            vehicles = lot.vehicles_range(self.vehicles_count)
            yield from lot.problems(key, vehicles, walls=self.add_walls)

    def change_problems(self, changes: Mapping[str, Any]) -> Iterator[str]:
        """Yield a sentence for each change of a key that a stored run does not have.

        It has neither the numbers of other levels nor the section that its lots shared.
        """
        if "level" in changes:
            yield (
                f"env.level={changes['level']}: a run keeps the numbers of its own level only; "
                f"add env={self.name}"
            )
        if self.lots and "lot" in changes:
            sections = ", ".join(self.lot_configs)
            yield f"env.lot: a run keeps its lots one by one; change {sections}"
        if self.lots and "lots" in changes:
            unknown = [name for name in changes["lots"] or () if name not in self.lots]
            names = ", ".join(self.lots)
            for name in unknown:
                yield f"env.lots.{name}: the run has no such lot; choose from {names}"

    def model_problems(self, features: str, buffer: Any) -> Iterator[str]:
        """Yield a sentence if the buffer can't relabel on the lot; all else is supported."""
        if self.lot_configs and buffer.class_name == "HerReplayBuffer":
            yield (
                f"buffer._target_={buffer.target} does not know the sizes of slots, on which the "
                f"reward of env={self.name} depends; use "
                "buffer._target_=parking_exp.buffers.HerBuffer"
            )
