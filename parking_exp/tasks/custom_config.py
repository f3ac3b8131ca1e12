"""The `env` group of a task that another package has."""

from typing import Annotated, Any, ClassVar

from pydantic import Field

from parking_exp.tasks.task_config import TaskConfig

CLASS_PATH = r"^[A-Za-z_]\w*(\.[A-Za-z_]\w*)+$"


class CustomConfig(TaskConfig):
    """The `env` group of a task class of another package.

    Attributes:
        task: dotted path of the class, a `parking_exp.tasks.task.Task`.
        kwargs: arguments of its constructor.
    """

    simulators: ClassVar[tuple[str, ...]] = ("task_class",)
    simulator: ClassVar[str] = "task_class"

    task: Annotated[str, Field(pattern=CLASS_PATH)]
    kwargs: Annotated[dict[str, Any], Field(default_factory=dict)]

    @property
    def episode_steps(self) -> int | None:
        """None: only the class knows its longest episode."""

    @property
    def imports(self) -> dict[str, str]:
        """The class, which is imported when the task is made."""
        return {"task": self.task, **super().imports}
