"""The schema of a run's config: its keys, their types and ranges; `conf/` has the values, and a comment for each key.

Arguments of third-party classes keep the library's names, and are checked by `config.constructor_arguments`.
"""

import math
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from parking_exp.config.credentials import strip_password
from parking_exp.config.paths import absolute, default_uri, directory_path
from parking_exp.config.run_key import result_part, short_hash

ENV_ID = "parking-v0"
DEFAULT_FEATURES = ["x", "y", "vx", "vy", "cos_h", "sin_h"]
DEFAULT_SCALES = [100, 100, 5, 5, 1, 1]
# Seeds of training scenes start here; those of evaluation scenes are smaller.
TRAINING_SCENES_START = 2**31


def _check_range(bounds: list[float]) -> list[float]:
    if bounds[0] >= bounds[1]:
        raise ValueError("the lower bound must be below the upper one")
    return bounds


NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]*$"
Name = Annotated[str, Field(pattern=NAME, max_length=80)]
Uri = Annotated[str, AfterValidator(strip_password)]
Positive = Annotated[int, Field(ge=1)]
Count = Annotated[int, Field(ge=0)]
NonNegative = Annotated[float, Field(ge=0)]
PositiveFloat = Annotated[float, Field(gt=0)]
Duration = Annotated[float, Field(gt=0, le=100_000)]
Pixels = Annotated[int, Field(ge=1, le=10_000)]
Share = Annotated[float, Field(gt=0, le=1)]
Bounds = Annotated[list[float], Field(min_length=2, max_length=2)]
Range = Annotated[Bounds, AfterValidator(_check_range)]
Simulation = Literal["vectorized", "highway_env"]
Scene = Annotated[int, Field(ge=0, lt=TRAINING_SCENES_START)]
NumberOfScenes = Annotated[int, Field(ge=1, le=10_000_000)]


class ConfigModel(BaseModel):
    """A strict, frozen part of the config: unknown keys and wrong types are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


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


class EnvConfig(ConfigModel):
    """The `env` group: highway-env's options under their own names, and five of ours."""

    name: Name
    simulator: Simulation
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
        ours = {"name", "simulator", "reward", "training_duration", "training_success_goal_reward"}
        options = self.model_dump(exclude=ours)
        options["action"] = {key: value for key, value in options["action"].items() if value is not None}
        return options

    def episode_steps(self) -> int:
        """Return the longest episode in policy steps, counted like highway-env does: by adding floats."""
        time, steps = 0.0, 0
        while time < self.duration:
            time += 1 / self.policy_frequency
            steps += 1
        return steps


class ThirdParty(BaseModel):
    """A section with our own keys and constructor arguments of the class in `_target_`."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)

    name: Name
    target: Annotated[str, Field(alias="_target_")]

    @property
    def arguments(self) -> dict[str, Any]:
        """The constructor arguments."""
        return dict(self.model_extra or {})

    @property
    def class_name(self) -> str:
        """The last part of `_target_`."""
        return self.target.rpartition(".")[2]


class AlgorithmConfig(ThirdParty):
    """The `algorithm` group."""

    features: Literal["raw", "ego", "ego_fine", "ego_mirrored"]
    net_arch: Annotated[list[Annotated[int, Field(ge=1, le=10_000)]], Field(min_length=1)]
    policy_ema_half_life: PositiveFloat | None


class BufferConfig(ThirdParty):
    """The `buffer` group."""

    buffer_size: Annotated[int, Field(ge=1, le=100_000_000)]  # 11 GB


class EvaluationConfig(ConfigModel):
    """Evaluation on fixed scenes, during training and at its end."""

    every_n_steps: Positive | None
    n_scenes: NumberOfScenes
    final_n_scenes: NumberOfScenes
    n_certified_scenes: NumberOfScenes
    first_scene: Scene
    video_episodes: Count


class CheckpointConfig(ConfigModel):
    """Checkpoints of the whole training state."""

    every_n_steps: Positive | None
    keep_last: Positive


class StoreConfig(ConfigModel):
    """Another store than that of the output directory."""

    uri: Uri | None


class TrackingConfig(ConfigModel):
    """Where metrics go."""

    mlflow: bool
    uri: Uri | None
    stdout: bool
    csv: bool
    tensorboard: bool
    log_interval: Positive
    progress_bar: bool


class SweepOptions(ConfigModel):
    """Keys of a sweep."""

    retry: Literal["failed"] | None
    dry_run: bool


class RunConfig(ConfigModel):
    """One run, seed included."""

    experiment_name: Name
    output_dir: Annotated[str, Field(pattern=r"^[^?]+$")]  # a sqlite URI ends at a question mark
    seed: Annotated[int, Field(ge=0, lt=2**32)]
    total_timesteps: Positive
    n_envs: Annotated[int, Field(ge=1, le=100_000)]
    updates_per_step: Annotated[float, Field(ge=0.001, le=1000)]  # 0.001: one update in 1,000 steps of each env
    device: Annotated[str, Field(pattern=r"^(cpu|auto|cuda(:\d{1,3})?)$")]
    torch_threads: Annotated[int, Field(ge=1, le=1024)] | None
    precision: Literal["highest", "medium"]
    timeout_s: PositiveFloat | None = None
    env: EnvConfig
    algorithm: AlgorithmConfig
    buffer: BufferConfig
    evaluation: EvaluationConfig
    checkpoint: CheckpointConfig
    tracking: TrackingConfig

    def plain(self) -> dict[str, Any]:
        """Return the config as plain containers, for YAML."""
        return self.model_dump(by_alias=True)

    @property
    def output_path(self) -> Path:
        """Absolute output directory."""
        return directory_path(self.output_dir)

    @property
    def store_uri(self) -> str:
        """Absolute URI of the MLflow store."""
        return absolute(self.tracking.uri or default_uri(self.output_path))

    @property
    def cell_key(self) -> str:
        """Short hash of everything that can change a result, except the seed."""
        return short_hash({key: value for key, value in result_part(self.plain()).items() if key != "seed"})

    @property
    def run_key(self) -> str:
        """Short hash of everything that can change a result, the seed included."""
        return short_hash(result_part(self.plain()))

    @property
    def cell(self) -> str:
        """Readable and unique name of this config without its seed."""
        return f"{self.env.name}-{self.algorithm.name}-{self.buffer.name}-{self.cell_key}"

    @property
    def run_dir(self) -> Path:
        """Absolute run directory."""
        return self.output_path / self.experiment_name / self.cell / f"seed={self.seed}"

    @property
    def n_certified_scenes(self) -> int:
        """Number of final scenes that are cross-checked on highway-env; all of them if the run simulates on it."""
        n_final = self.evaluation.final_n_scenes
        return n_final if self.env.simulator == "highway_env" else min(self.evaluation.n_certified_scenes, n_final)

    def update_rounds(self) -> tuple[int | tuple[int, str], int]:
        """Return (`train_freq`, `gradient_steps`): the shortest round that makes `updates_per_step` exact.

        Values of the `algorithm` section take precedence: `train_freq: [1, episode]` does as many updates as steps (-1)
        unless `gradient_steps` is set.
        """
        train_freq, gradient_steps = map(self.algorithm.arguments.get, ("train_freq", "gradient_steps"))
        if isinstance(train_freq, list):
            number, unit = train_freq
            return (number, unit), -1 if gradient_steps is None else gradient_steps
        per_vec_step = Fraction(self.updates_per_step).limit_denominator(1000) * self.n_envs
        if train_freq is None:
            train_freq = 1 if gradient_steps is not None else per_vec_step.denominator
        if gradient_steps is None:
            gradient_steps = math.ceil(per_vec_step * train_freq)
        return train_freq, gradient_steps
