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
    """An evaluation episode that has ended."""

    outcome: Outcome
    steps: int  # policy steps
    total_reward: float  # undiscounted
    end: Pose  # of the car, relative to its goal slot


@dataclass(frozen=True)
class Metric:
    """A metric of evaluation episodes, of which an evaluation has the rate (of a bool) or the mean (of a number)."""

    name: str  # of its column in `episodes.csv`; outcomes share the column `outcome`
    of: Callable[[Episode], bool | int | float]  # its value, computed from an episode that has ended
    label: str  # heading in tables
    unit: str = ""  # shown behind the label
    dtype: Literal["bool", "int64", "float64"] = "float64"  # of the column in frames
    higher_is_better: bool | None = None  # None where neither is
    column: str | None = None  # in `Results.runs`; None: `NAME_rate` or the name
    in_curves: bool = False  # whether `Results.curves` has it
    in_reports: bool = False  # whether reports have its mean over seeds

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
    return Metric(name, of, name.capitalize(), "", "bool", higher_is_better, in_curves=True, in_reports=True)


def _ended_as(name: Outcome) -> Callable[[Episode], bool]:
    return lambda episode: episode.outcome == name


# In `Results.runs`, `steps` are the env steps trained.
METRICS: tuple[Metric, ...] = (
    *(_rate(name, _ended_as(name), higher_is_better=name == "success") for name in OUTCOMES),
    _rate("parked", lambda episode: episode.end.parked, higher_is_better=True),
    Metric(
        "steps", lambda episode: episode.steps, "Steps an episode", "", "int64", higher_is_better=False,
        column="episode_steps", in_curves=True, in_reports=True
    ),
    Metric(
        "return", lambda episode: episode.total_reward, "Return", higher_is_better=True, column="episode_return",
        in_curves=True
    ),
    Metric(
        "distance_m", lambda episode: episode.end.distance_m, "Distance at the end", "m", higher_is_better=False
    ),
    Metric(
        "heading_error_rad", lambda episode: abs(episode.end.heading_error_rad), "Heading error at the end", "rad",
        higher_is_better=False
    ),
    Metric(
        "speed_mps", lambda episode: abs(episode.end.speed_mps), "Speed at the end", "m/s", higher_is_better=False
    ),
)  # fmt: skip

RANKING = ("success", "crash", "steps")
"""By which metrics the best model is chosen: the second where the first is equal, and so on."""

EPISODE_COLUMNS = ["scene", "outcome", *(metric.name for metric in METRICS if metric.name not in OUTCOMES)]
"""Columns of an episodes table; `episodes.csv` has phase and step before them."""

DTYPES: dict[str, str] = {metric.name: metric.dtype for metric in METRICS if metric.name not in OUTCOMES}
"""Types of its columns, but for scene and outcome."""

TRAJECTORIES_FILE = "trajectories.npz"
CAR_COLUMNS = ("x_m", "y_m", "heading_rad", "speed_mps")
"""Columns of that file, which `Recorder` writes and `results` reads; speed is signed."""
