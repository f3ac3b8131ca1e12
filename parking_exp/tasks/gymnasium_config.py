"""The `env` group of any goal environment that is registered with Gymnasium."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field

from parking_exp.config_model import ConfigModel, Name, Positive

ENV_ID = r"^([A-Za-z_][\w.]*:)?([\w-]+/)?[\w.-]+$"


class GymnasiumConfig(ConfigModel):
    """The `env` group of a Gymnasium environment."""

    simulators: ClassVar[tuple[str, ...]] = ("gymnasium",)
    simulator: ClassVar[str] = "gymnasium"

    task: Literal["gymnasium"]
    name: Name
    id: Annotated[str, Field(pattern=ENV_ID)]
    kwargs: dict[str, Any]
    max_episode_steps: Positive | None
    vectorization: Literal["sync", "async"]
    success_key: str | None
    failure_key: str | None

    def for_training(self) -> Self:
        """Return the config of training envs, which is the same."""
        return self

    def episode_steps(self) -> int | None:
        """Return the longest episode in steps; None where only the registered environment knows."""
        return self.max_episode_steps

    @property
    def class_paths(self) -> dict[str, str]:
        """Keys that name what making an env imports: an `id` with a module before a colon."""
        colon = ":" in self.id
        return {"id": self.id} if colon else {}

    @property
    def action_size(self) -> None:
        """Number of dimensions of an action: only the environment knows."""

    def problems(self) -> Iterator[str]:
        """Yield what is wrong with the keys, without importing the environment: nothing."""
        yield from ()

    def model_problems(self, features: str, *, relabels: bool) -> Iterator[str]:
        """Yield what is wrong with the policy's features."""
        if features != "raw":
            yield f"algorithm.features={features} is of parking-v0; use algorithm.features=raw"
