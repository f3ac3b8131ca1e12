"""The `env` group of any goal environment that is registered with Gymnasium."""

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from parking_exp.config_model import MAX_ENVS, Count
from parking_exp.tasks.task_config import TaskConfig

ENV_ID_PATTERN = r"^([A-Za-z_][\w.]*:)?([\w-]+/)?[\w.-]+$"
SUCCESS_KEYS = ("is_success", "success")
"""Entries of `info` that tell of success, if the config names none."""


class GymnasiumConfig(TaskConfig):
    """The `env` group of a Gymnasium environment."""

    simulators: ClassVar[tuple[str, ...]] = ("gymnasium",)
    simulator: ClassVar[str] = "gymnasium"
    training_keys: ClassVar[tuple[str, ...]] = ("vectorization",)
    # Simulators in C may take 31 bits.
    training_seeds: ClassVar[range] = range(2**30, 2**31 - MAX_ENVS)

    task: Literal["gymnasium"]
    id: Annotated[str, Field(pattern=ENV_ID_PATTERN)]
    kwargs: dict[str, Any]
    max_episode_steps: Count | None
    vectorization: Literal["sync", "async"]
    success_key: str | None
    failure_key: str | None

    @property
    def episode_steps(self) -> int | None:
        """The longest episode in steps; None where only the registered environment knows."""
        return self.max_episode_steps

    def problems(self) -> Iterator[str]:
        """Yield a sentence if the failure key tells of success, and one if a window would open."""
        success_keys = (self.success_key,) if self.success_key else SUCCESS_KEYS
        if self.failure_key in success_keys:
            yield (
                f"env.failure_key={self.failure_key} tells of success; name the entry that tells "
                "of failure, or null"
            )
        mode = self.kwargs.get("render_mode")
        if mode not in (None, "rgb_array"):
            yield (
                f"env.kwargs.render_mode={mode}: envs open no windows here; leave it out, videos "
                "are made without it"
            )

    @property
    def imports(self) -> dict[str, str]:
        """Config keys that may make an env import a module or open a file, and their values."""
        unsafe = {
            f"kwargs.{key}": str(value)
            for key, value in self.kwargs.items()
            if not _is_harmless(value)
        }
        if ":" in self.id:
            unsafe["id"] = self.id
        return unsafe | super().imports


def _is_harmless(value: object) -> bool:
    """Return whether an argument can name neither a module nor a file."""
    if isinstance(value, list):
        return all(map(_is_harmless, value))
    return (
        value is None
        or isinstance(value, int | float)
        or (isinstance(value, str) and value.isidentifier())
    )
