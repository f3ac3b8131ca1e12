"""Registry of tasks: the `env` group and metrics of all, and the task and report of each."""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Discriminator, Tag

from parking_exp.dotted_paths import import_object
from parking_exp.errors import ConfigError, class_and_message
from parking_exp.tasks.custom_config import CLASS_PATH, CustomConfig
from parking_exp.tasks.gymnasium_config import GymnasiumConfig
from parking_exp.tasks.metrics import GYMNASIUM_METRICS, Metric, load_metrics
from parking_exp.tasks.parking import parking_metrics
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.task_config import TaskConfig

if TYPE_CHECKING:
    from parking_exp.tasks.task import Task, TaskReport

CUSTOM = "a class"
"""Tag of configs whose `task` is the dotted path of a class."""
ENV_CONFIGS: dict[Any, type[TaskConfig]] = {"parking": ParkingConfig, "gymnasium": GymnasiumConfig}
"""The `env` groups of our own tasks, by their key `task`."""


def _config_tag(env: Any) -> str | None:
    """Return which config an `env` group has: one of ours by its name, or any class's."""
    task = env.get("task") if isinstance(env, Mapping) else getattr(env, "task", None)
    if isinstance(task, str) and re.match(CLASS_PATH, task):
        return CUSTOM
    return task if task in tuple(ENV_CONFIGS) else None


EnvConfig = Annotated[
    Annotated[ParkingConfig, Tag("parking")]
    | Annotated[GymnasiumConfig, Tag("gymnasium")]
    | Annotated[CustomConfig, Tag(CUSTOM)],
    Discriminator(
        _config_tag,
        custom_error_type="task",
        custom_error_message="it is neither 'parking', 'gymnasium' nor the dotted path of a class",
    ),
]
"""The `env` group: the config of one of the tasks, chosen by its key `task`."""
TASKS = (*ENV_CONFIGS, CUSTOM)
METRICS: tuple[Metric, ...] = tuple(dict.fromkeys((*parking_metrics.METRICS, *GYMNASIUM_METRICS)))
"""The metrics of all tasks. Those that a task does not have are missing for its runs."""
OUTCOMES = tuple(metric.name for metric in METRICS if metric.is_outcome)
FAILURES = tuple(name for name in OUTCOMES if name not in ("success", "timeout"))
"""Outcomes of episodes that ended badly; each task has one of them."""
METRIC_KEYS = {metric.key for metric in METRICS}
ADDED_KEY = re.compile(r"\w+_(rate|mean)")
TRAINING_KEYS = ["name", "metrics"]
for _config in ENV_CONFIGS.values():
    TRAINING_KEYS += _config.training_keys
TRAINING_ONLY = frozenset(f"env.{key}" for key in TRAINING_KEYS)
"""Config keys of tasks that do not change the episodes of an evaluation."""
DTYPES: dict[str, str] = {metric.name: metric.dtype for metric in METRICS if not metric.is_outcome}
"""Types of the columns of an episodes table, but for seed and outcome."""


def added_metrics(names: Iterable[str], prefix: str = "") -> list[str]:
    """Return the keys of metrics of users among names of a store or a frame, sorted."""
    keys = {name.removeprefix(prefix) for name in names if name.startswith(prefix)}
    return sorted(key for key in keys - METRIC_KEYS if ADDED_KEY.fullmatch(key))


def make_task(config: EnvConfig) -> "Task":
    """Return the task that an `env` group describes, with the metrics that the user adds.

    Raises:
        ConfigError: the class of another package can't be made, or a metric can't be used.
    """
    task = _make_task(config)
    added = load_metrics(config.metrics or (), [*METRICS, *task.metrics])
    task.metrics = (*task.metrics, *added)
    return task


def _make_task(config: EnvConfig) -> "Task":
    if isinstance(config, GymnasiumConfig):
        from parking_exp.tasks.gymnasium_task import GymnasiumTask

        return GymnasiumTask(config)
    if isinstance(config, CustomConfig):
        return _make_custom(config)
    from parking_exp.tasks.parking.parking_task import ParkingTask

    return ParkingTask(config)


def _make_custom(config: CustomConfig) -> "Task":
    from parking_exp.tasks.task import Task

    setting = f"env.task={config.task}"
    task_class = import_object(config.task, setting)
    if not (isinstance(task_class, type) and issubclass(task_class, Task)):
        raise ConfigError(f"{setting}: it is not a subclass of {Task.__module__}.Task")
    try:
        return task_class(**config.kwargs)
    except Exception as error:  # whatever a constructor raises
        raise ConfigError(f"{setting}: {class_and_message(error)}") from error


def task_reports(tasks: Iterable[str]) -> "Iterator[TaskReport]":
    """Yield the parts of reports that are specific to some tasks, given by name."""
    if "parking" in tasks:
        from parking_exp.tasks.parking.parking_report import PARKING_REPORT

        yield PARKING_REPORT
