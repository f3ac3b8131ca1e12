"""Metrics of evaluation episodes: each is declared once, by its task.

Evaluation, `episodes.csv`, the store, the frames of `parking_exp.results` and the tables of reports
use them. `env.metrics` adds metrics of a user's own package, by dotted paths. A store only has
their keys and values, so reading it does not import that package.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from parking_exp.dotted_paths import import_object
from parking_exp.errors import ConfigError

EPISODE_SEED = "scene"
"""Column of the seed from which an evaluation episode started, in `episodes.csv` and in frames."""


@dataclass(frozen=True)
class Episode:
    """An evaluation episode that has ended."""

    outcome: str
    steps: int  # policy steps
    total_reward: float  # undiscounted
    end: Any  # the state at its end, from `EvaluationBatch.ending`
    info: Mapping[str, Any]  # what `EvaluationBatch.info` says at its last step


@dataclass(frozen=True)
class Metric:
    """A metric of evaluation episodes, reported as the rate of a bool or the mean of a number."""

    name: str  # names its column in `episodes.csv`; outcomes share the column `outcome`
    # Its value, computed from an episode that has ended.
    of: Callable[[Episode], bool | int | float]
    label: str  # heading in tables
    unit: str = ""  # shown behind the label
    dtype: Literal["bool", "int64", "float64"] = "float64"  # the column's dtype in frames
    column: str | None = None  # in `Results.runs`; None: `NAME_rate` or the name
    # For metrics of this package. Metrics of users are always in both.
    in_curves: bool = False  # whether `Results.curves` has it
    in_reports: bool = False  # whether reports have its mean over seeds
    is_outcome: bool = False  # whether it is the share of episodes that ended like this
    colour: str | None = None  # colour of its curve in curves.png; None: no curve
    note: str = ""  # its definition, beside its rate on the terminal

    @property
    def is_rate(self) -> bool:
        """Whether it is a rate, the share of episodes in which it is true."""
        return self.dtype == "bool"

    @property
    def key(self) -> str:
        """Name in the summary of an evaluation, e.g. `success_rate`.

        The store puts the phase before it: `final/success_rate`.
        """
        return f"{self.name}_{'rate' if self.is_rate else 'mean'}"

    @property
    def run_column(self) -> str:
        """Name of its rate or mean over the final episodes in `Results.runs`."""
        return self.column or (self.key if self.is_rate else self.name)

    @property
    def heading(self) -> str:
        """Label and unit."""
        unit = "%" if self.is_rate else self.unit
        return f"{self.label} ({unit})" if unit else self.label

    def values(self, episodes: Any) -> Any:
        """Return its value in each row of a frame of episodes."""
        return episodes["outcome"] == self.name if self.is_outcome else episodes[self.name]


def rate(name: str, of: Callable[[Episode], bool], *, colour: str, **options: Any) -> Metric:
    """Return a metric of which the store, curves and reports have the rate."""
    fields = {"in_curves": True, "in_reports": True, "colour": colour, **options}
    return Metric(name, of, name.capitalize(), "", "bool", **fields)


def outcome_rate(name: str, colour: str) -> Metric:
    """Return the rate of an outcome."""
    return rate(name, lambda e: e.outcome == name, colour=colour, is_outcome=True)


# Okabe and Ito's palette, distinguishable with any colour vision. STEPS has a column of its own,
# since `steps` of `Results.runs` are env steps of training.
SUCCESS = outcome_rate("success", "#009E73")
TIMEOUT = outcome_rate("timeout", "#56B4E9")
FAILURE_COLOUR = "#D55E00"
STEPS = Metric(
    "steps", lambda e: e.steps, "Steps per episode", "", "int64", column="episode_steps",
    in_curves=True, in_reports=True
)  # fmt: skip
RETURN = Metric(
    "return", lambda e: e.total_reward, "Return", column="episode_return", in_curves=True
)
GYMNASIUM_METRICS: tuple[Metric, ...] = (
    SUCCESS,
    outcome_rate("failure", FAILURE_COLOUR),
    TIMEOUT,
    STEPS,
    RETURN,
)
"""Metrics of any goal environment."""


def outcome(failure: str, failed: bool, is_success: bool) -> str:
    """Return the outcome of an episode; a failure, named `failure`, takes precedence."""
    if failed:
        return failure
    if is_success:
        return "success"
    return "timeout"


def episode_columns(metrics: Sequence[Metric]) -> list[str]:
    """Return the columns of an episodes table; `episodes.csv` has phase and step before them."""
    return [EPISODE_SEED, "outcome", *(metric.name for metric in metrics if not metric.is_outcome)]


def load_metrics(paths: Iterable[str], known: Sequence[Metric]) -> tuple[Metric, ...]:
    """Return metrics of a user's own package, by their dotted paths.

    Args:
        paths: the dotted paths of the metrics.
        known: other metrics, whose names are taken.

    Raises:
        ConfigError: there is no such metric, or its name can't be used.
    """
    metrics: list[Metric] = []
    taken = {"run_id", "phase", "step", *episode_columns(known), *(each.name for each in known)}
    for number, path in enumerate(paths):
        assignment = f"env.metrics.{number}={path}"
        metric = import_object(path, assignment)
        if not isinstance(metric, Metric):
            raise ConfigError(f"{assignment} is not a parking_exp.tasks.metrics.Metric")
        if not metric.name.isidentifier():
            raise ConfigError(f"{assignment}: its name {metric.name!r} is not an identifier")
        if metric.name in taken:
            raise ConfigError(f"{assignment}: there is a metric or column {metric.name} already")
        taken.add(metric.name)
        metrics.append(metric)
    return tuple(metrics)
