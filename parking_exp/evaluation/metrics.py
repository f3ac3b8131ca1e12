"""The registry of metrics: each is declared once, here.

Evaluation, `episodes.csv`, the store, the frames of `parking_exp.results` and the tables of reports read it. To add a
metric, add an entry to METRICS: every evaluation then computes it, and runs that were evaluated before lack it (NaN).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from parking_exp.envs.outcomes import OUTCOMES, Outcome, Pose


@dataclass(frozen=True)
class Episode:
    """An evaluation episode that has ended.

    Attributes:
        outcome: success, crash or timeout.
        steps: its length in policy steps.
        total_reward: undiscounted sum of its rewards.
        end: the car relative to its goal slot at the end.
    """

    outcome: Outcome
    steps: int
    total_reward: float
    end: Pose


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A metric of evaluation episodes, of which an evaluation has the rate (of a bool) or the mean (of a number).

    Attributes:
        name: its column in `episodes.csv`; outcomes share the column `outcome`.
        of: its value, computed from an episode that has ended.
        dtype: of the column in frames.
        label: heading in tables.
        unit: shown behind the label; empty for none.
        higher_is_better: None where neither is.
        column: in `Results.runs`; None: `NAME_rate` or the name.
        in_curves: whether `Results.curves` has it.
        in_reports: whether reports have its mean over seeds.
    """

    name: str
    of: Callable[[Episode], bool | int | float]
    dtype: Literal["bool", "int64", "float64"] = "float64"
    label: str
    unit: str = ""
    higher_is_better: bool | None = None
    column: str | None = None
    in_curves: bool = False
    in_reports: bool = False

    @property
    def is_rate(self) -> bool:
        """Whether an evaluation has the share of episodes in which it is true."""
        return self.dtype == "bool"

    @property
    def key(self) -> str:
        """Name in the summary of an evaluation, e.g. `success_rate`; the store has it as `certified/success_rate`."""
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
        return episodes["outcome"] == self.name if self.name in OUTCOMES else episodes[self.name]


def _rate(name: str, of: Callable[[Episode], bool], *, higher_is_better: bool) -> Metric:
    """Return a metric of which the store, curves and reports have the rate."""
    return Metric(
        name=name,
        of=of,
        dtype="bool",
        label=name.capitalize(),
        higher_is_better=higher_is_better,
        in_curves=True,
        in_reports=True,
    )


def _ended_as(name: Outcome) -> Callable[[Episode], bool]:
    return lambda episode: episode.outcome == name


METRICS: tuple[Metric, ...] = (
    *(_rate(name, _ended_as(name), higher_is_better=name == "success") for name in OUTCOMES),
    _rate("parked", lambda episode: episode.end.parked, higher_is_better=True),
    Metric(
        name="steps",
        of=lambda episode: episode.steps,
        dtype="int64",
        label="Steps an episode",
        higher_is_better=False,
        column="episode_steps",  # `steps` are the env steps trained
        in_curves=True,
        in_reports=True,
    ),
    Metric(
        name="return",
        of=lambda episode: episode.total_reward,
        label="Return",
        higher_is_better=True,
        column="episode_return",
        in_curves=True,
    ),
    Metric(
        name="distance_m",
        of=lambda episode: episode.end.distance_m,
        label="Distance at the end",
        unit="m",
        higher_is_better=False,
    ),
    Metric(
        name="heading_error_rad",
        of=lambda episode: abs(episode.end.heading_error_rad),
        label="Heading error at the end",
        unit="rad",
        higher_is_better=False,
    ),
    Metric(
        name="speed_mps",
        of=lambda episode: abs(episode.end.speed_mps),
        label="Speed at the end",
        unit="m/s",
        higher_is_better=False,
    ),
)

RANKING = ("success", "crash", "steps")
"""By which metrics the best model is chosen: the second where the first is equal, and so on."""

EPISODE_COLUMNS = ["scene", "outcome", *(metric.name for metric in METRICS if metric.name not in OUTCOMES)]
"""Columns of an episodes table; `episodes.csv` has phase and step before them."""

DTYPES: dict[str, str] = {metric.name: metric.dtype for metric in METRICS if metric.name not in OUTCOMES}
"""Types of its columns, but for scene and outcome."""
