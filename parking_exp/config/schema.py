"""The schema of a run's config: its keys, their types and ranges; `conf/` has the values, and a
comment for each key.

Arguments of third-party classes keep the library's names, and are checked by
`config.constructor_arguments`.
"""

import re
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    NonNegativeInt,
    PositiveFloat,
    model_validator,
)

from parking_exp.config.argument_limits import OFF_POLICY_ARGUMENTS, SAC_ARGUMENTS, TD3_ARGUMENTS
from parking_exp.config.paths import (
    SQLITE,
    absolute_path,
    absolute_uri,
    default_uri,
    refuse_password,
    refuse_question_mark,
)
from parking_exp.config.run_key import result_part, short_hash
from parking_exp.config_model import (
    MAX_ENVS,
    ConfigModel,
    Count,
    EpisodeSeed,
    Name,
    NonEmptyText,
    NumberOfEpisodes,
    RunSeed,
    Share,
    Two,
    left_out,
)
from parking_exp.tasks.registry import EnvConfig

PLANNER = {"_target_": "parking_exp.tasks.parking.planning.Planner"}
STORE_URI = re.compile(r"sqlite:///[^?]+|(https?|postgresql|mysql|mssql)(\+\w+)?://.+|databricks.*")


def _check_store(uri: str) -> str:
    if not STORE_URI.fullmatch(refuse_password(uri)):
        raise ValueError(
            "it is not an MLflow store; use sqlite:///PATH, or http://HOST:PORT of a tracking "
            "server"
        )
    if uri.startswith(SQLITE):
        refuse_question_mark(Path(absolute_uri(uri)))
    return uri


def _check_output_dir(text: str) -> str:
    refuse_question_mark(absolute_path(text))
    return text


Uri = Annotated[str, AfterValidator(_check_store)]


def _check_local(path: str) -> str:
    if re.match(r"[A-Za-z][\w+.-]*:/", path):
        raise ValueError(f"{path} is a URI; files are written to local folders only, so name one")
    return path


LocalPath = Annotated[NonEmptyText, AfterValidator(_check_local)]
"""A path of this machine: `s3://bucket` would become a folder `s3:`."""


def _check_device(device: str) -> str:
    if not re.fullmatch(r"cpu|auto|cuda(:\d{1,3})?", device):
        raise ValueError(f"{device!r} is not a device; choose cpu, auto, cuda or cuda:N")
    return device


def _as_node(value: Any) -> Any:
    """Return a dotted path as a node with a `_target_`; leave other values to pydantic."""
    if isinstance(value, str):
        return {"_target_": value}
    return value


Node = Annotated[dict[str, Any], BeforeValidator(_as_node)]
"""A class with its arguments: a mapping with a `_target_`, or its dotted path alone."""


class ThirdParty(BaseModel):
    """A section with our own keys and constructor arguments of the class in `_target_`."""

    model_config = ConfigDict(extra="allow", frozen=True, strict=True, allow_inf_nan=False)

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
    # None: it is not trained.
    net_arch: Annotated[list[Annotated[int, Field(ge=1, le=10_000)]], Field(min_length=1)] | None
    policy_ema_half_life: PositiveFloat | None
    normalize: bool


DROPPED_IF_UNTRAINED = {"trained", *OFF_POLICY_ARGUMENTS, *SAC_ARGUMENTS, *TD3_ARGUMENTS}
UNTRAINED: dict[str, Any] = {
    "features": "raw",
    "net_arch": None,
    "policy_ema_half_life": None,
    "normalize": False,
}
"""Our own keys of an algorithm with `trained: false`."""


class BufferConfig(ThirdParty):
    """The `buffer` group."""

    buffer_size: Annotated[int, Field(ge=1, le=100_000_000)]  # 11 GB
    demonstrations: int = left_out(0, ge=0, le=10_000)
    demonstration_share: Share = left_out(0.25, lt=1)
    demonstrator: Node = left_out(PLANNER)


FINAL_EVALUATION = {"final_n_scenes", "n_certified_scenes", "video_episodes"}
"""Keys of `evaluation` that concern the finished model alone: a finished run is evaluated again,
not trained again.
"""


class EvaluationConfig(ConfigModel):
    """Evaluation on episodes with fixed seeds, during training and at its end."""

    every_n_steps: Count | None
    n_scenes: NumberOfEpisodes
    final_n_scenes: NumberOfEpisodes
    n_certified_scenes: Annotated[int, Field(ge=0, le=10_000_000)]
    first_scene: EpisodeSeed
    video_episodes: NonNegativeInt

    def seeds(self, n_episodes: int) -> range:
        """Return the seeds of the first `n_episodes` fixed episodes."""
        return range(self.first_scene, self.first_scene + n_episodes)


class CheckpointConfig(ConfigModel):
    """Checkpoints of the whole training state."""

    every_n_steps: Count | None
    keep_last: Count


class StoreConfig(ConfigModel):
    """A store other than the output directory's own."""

    uri: Uri | None


class TrackingConfig(ConfigModel):
    """Where metrics go."""

    mlflow: bool
    uri: Uri | None
    stdout: bool
    csv: bool
    tensorboard: bool
    log_interval: Count
    progress_bar: bool
    trackers: list[Node] | None = None


class SweepOptions(ConfigModel):
    """Keys of a sweep."""

    retry: Literal["failed"] | None
    dry_run: bool


class OutputConfig(ConfigModel):
    """The output directory, a key of each command."""

    output_dir: Annotated[LocalPath, AfterValidator(_check_output_dir)]

    @property
    def output_path(self) -> Path:
        """Absolute output directory."""
        return absolute_path(self.output_dir)


class RunConfig(OutputConfig):
    """One run, seed included."""

    experiment_name: Name
    seed: RunSeed
    total_timesteps: Annotated[int, Field(ge=0, le=10**12)]  # 0: nothing is trained
    n_envs: Annotated[int, Field(ge=1, le=MAX_ENVS)]
    # 0.001: one update in 1,000 env steps, summed over all envs.
    updates_per_step: Annotated[float, Field(ge=0.001, le=1000)]
    device: Annotated[str, AfterValidator(_check_device)]
    torch_threads: Annotated[int, Field(ge=1, le=1024)] | None
    precision: Literal["highest", "medium"]
    timeout_s: PositiveFloat | None = None
    contrasts: list[Two[str]] | None = None
    label: str | None = None
    callbacks: list[Node] | None = None
    init: NonEmptyText | None = None
    init_latest: bool = False  # in a planned run: its `init` was `latest` when it was planned
    init_buffer: bool = False
    env: EnvConfig
    algorithm: AlgorithmConfig
    buffer: BufferConfig
    evaluation: EvaluationConfig
    checkpoint: CheckpointConfig
    tracking: TrackingConfig

    @model_validator(mode="before")
    @classmethod
    def _without_training(cls, values: Any) -> Any:
        """Leave out keys of training where nothing is trained, so that they have no effect."""
        algorithm = values.get("algorithm") if isinstance(values, Mapping) else None
        if not isinstance(algorithm, Mapping):
            return values
        # Stored configs have no `trained`; `net_arch` is null instead.
        is_marked_untrained = algorithm.get("net_arch", []) is None
        if algorithm.get("trained", True) and not is_marked_untrained:
            return values
        own = {key: value for key, value in algorithm.items() if key not in DROPPED_IF_UNTRAINED}
        own.update(UNTRAINED)
        without_training = dict(values, algorithm=own, total_timesteps=0)
        without_training.pop("init", None)
        without_training.pop("init_buffer", None)
        return without_training

    @property
    def is_trained(self) -> bool:
        """Whether the algorithm learns; if not, the keys of training have no effect."""
        return self.algorithm.net_arch is not None

    def plain(self) -> dict[str, Any]:
        """Return the config as plain containers, for YAML."""
        return self.model_dump(by_alias=True)

    @property
    def store_uri(self) -> str:
        """Absolute URI of the MLflow store."""
        return absolute_uri(self.tracking.uri or default_uri(self.output_path))

    @property
    def cell_key(self) -> str:
        """Short hash of everything that can change the training or its learning curve, except the
        seed.
        """
        part = self._trained_part()
        part.pop("seed", None)
        return short_hash(part)

    @property
    def run_key(self) -> str:
        """Short hash of everything that can change the training or its learning curve, the seed
        included.
        """
        return short_hash(self._trained_part())

    def _trained_part(self) -> dict[str, Any]:
        """Return the keys that can change the training or its learning curve."""
        # Values that are defaults are left out, so that a new key does not change the hashes of
        # older runs.
        part = result_part(self.model_dump(by_alias=True, exclude_defaults=True))
        part["evaluation"] = self.evaluation.model_dump(exclude=FINAL_EVALUATION)
        return part

    @property
    def cell_name(self) -> str:
        """Readable and unique name of the cell, this config without its seed."""
        return f"{self.env.name}-{self.algorithm.name}-{self.buffer.name}-{self.cell_key}"

    @property
    def run_dir(self) -> Path:
        """Absolute run directory."""
        return self.output_path / self.experiment_name / self.cell_name / f"seed={self.seed}"

    @property
    def n_cross_checked(self) -> int:
        """Number of final episodes that are cross-checked on the task's reference simulator.

        None of them if the task has one simulator only. All if the run trains on the reference,
        whatever the config says, since nothing is simulated twice. Otherwise as many as the config
        says.
        """
        if len(self.env.simulators) == 1:
            return 0
        n_final = self.evaluation.final_n_scenes
        if self.env.simulator == self.env.reference_simulator:
            return n_final
        return min(self.evaluation.n_certified_scenes, n_final)

    @property
    def final_settings(self) -> dict[str, int]:
        """The settings of the final evaluation as they take effect; with others, a finished run is
        evaluated again.
        """
        settings = self.evaluation.model_dump(include=FINAL_EVALUATION)
        return {**settings, "n_certified_scenes": self.n_cross_checked}

    def update_round(self) -> tuple[int, int]:
        """Return `train_freq` and `gradient_steps` of the shortest round that makes
        `updates_per_step` exact.
        """
        per_vec_step = self.update_ratio * self.n_envs
        return per_vec_step.denominator, per_vec_step.numerator

    @property
    def update_ratio(self) -> Fraction:
        """`updates_per_step` as a fraction, so that 0.3 is three updates in ten steps."""
        return Fraction(self.updates_per_step).limit_denominator(1_000_000)
