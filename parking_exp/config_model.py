"""The base of all config schemas, and the types of their keys."""

from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

NAME = r"^[A-Za-z0-9][A-Za-z0-9._-]*$"
MAX_ENVS = 100_000
TRAINING_SEEDS_START = 2**31
"""Seeds of training episodes start here, unless a task has a limit of its own. Seeds of evaluation
episodes are smaller.
"""


def _check_range(bounds: list[float]) -> list[float]:
    if bounds[0] >= bounds[1]:
        raise ValueError("the lower bound must be below the upper one")
    return bounds


Item = TypeVar("Item")

NonEmptyText = Annotated[str, Field(min_length=1)]
Count = Annotated[int, Field(ge=1, le=10**12)]
Name = Annotated[str, Field(pattern=NAME, max_length=80)]
Duration = Annotated[float, Field(gt=0, le=100_000)]
Pixels = Annotated[int, Field(ge=1, le=10_000)]
Share = Annotated[float, Field(gt=0, le=1)]
Two = Annotated[list[Item], Field(min_length=2, max_length=2)]
Bounds = Two[float]
Range = Annotated[Bounds, AfterValidator(_check_range)]
RunSeed = Annotated[int, Field(ge=0, lt=2**32)]
EpisodeSeed = Annotated[int, Field(ge=0, lt=TRAINING_SEEDS_START)]
NumberOfEpisodes = Annotated[int, Field(ge=1, le=10_000_000)]
# Arguments of `HerBuffer`, which a config is checked against without importing torch.
GoalStrategy = Literal["future", "final", "episode", "random"]
RelabelCollision = Literal["keep", "sb3", "exclude"]
RelabelTerminated = Literal["sb3", "goal", "goal_and_crash", "env"]
GoalVelocity = Literal["achieved", "zero"]


def left_out(default: Any, **limits: Any) -> Any:
    """Return a field whose default is left out of stored configs and of names of evaluations."""
    return Field(default=default, exclude_if=lambda value: bool(value == default), **limits)


class ConfigModel(BaseModel):
    """A strict, frozen part of a config: unknown keys and wrong types are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
