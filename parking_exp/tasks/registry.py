"""Registry of tasks: the `env` group and the metrics of all of them, and the task and report of
each.
"""

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from parking_exp.tasks.gymnasium_config import GymnasiumConfig
from parking_exp.tasks.metrics import GYMNASIUM_METRICS, Metric
from parking_exp.tasks.parking import parking_metrics
from parking_exp.tasks.parking.parking_config import ParkingConfig

if TYPE_CHECKING:
    from parking_exp.tasks.task import Task, TaskReport

EnvConfig = Annotated[ParkingConfig | GymnasiumConfig, Field(discriminator="task")]
"""The `env` group: the config of one of the tasks, chosen by its key `task`."""
TASKS = ("parking", "gymnasium")
METRICS: tuple[Metric, ...] = tuple(dict.fromkeys((*parking_metrics.METRICS, *GYMNASIUM_METRICS)))
"""The metrics of all tasks. Those that a task does not have are missing for its runs."""
OUTCOMES = tuple(metric.name for metric in METRICS if metric.is_outcome)
FAILURES = tuple(name for name in OUTCOMES if name not in ("success", "timeout"))
"""Outcomes of episodes that ended badly; each task has one of them."""
TRAINING_ONLY = frozenset(
    f"env.{key}" for key in ("name", *ParkingConfig.training_keys, *GymnasiumConfig.training_keys)
)
"""Config keys of tasks that do not change the episodes of an evaluation."""
DTYPES: dict[str, str] = {metric.name: metric.dtype for metric in METRICS if not metric.is_outcome}
"""Types of the columns of an episodes table, but for seed and outcome."""


def make_task(config: EnvConfig) -> "Task":
    """Return the task that an `env` group describes."""
    if isinstance(config, GymnasiumConfig):
        from parking_exp.tasks.gymnasium_task import GymnasiumTask

        return GymnasiumTask(config)
    from parking_exp.tasks.parking.parking_task import ParkingTask

    return ParkingTask(config)


def task_reports(tasks: Iterable[str]) -> "Iterator[TaskReport]":
    """Yield the parts of reports that are specific to some tasks, given by name."""
    if "parking" in tasks:
        from parking_exp.tasks.parking.parking_report import PARKING_REPORT

        yield PARKING_REPORT
