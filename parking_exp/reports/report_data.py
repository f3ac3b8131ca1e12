"""Dataclasses of a report's content, which `report.json` holds as it is.

`report_builder` makes them. Rates are in 0 ... 1. None: not known.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from parking_exp.config.cell_labels import Factor
from parking_exp.config.settings import Setting
from parking_exp.statistics import Difference, Interval, MainEffect
from parking_exp.tasks.registry import FAILURES

if TYPE_CHECKING:
    from parking_exp.tuning.search import StoredSearch

MAX_DRAWN_PAIRS = 21  # all pairs of seven cells
Verdict = Literal["a", "b", "same", "unclear", "unknown"]
REVERSED: dict[Verdict, Verdict] = {"a": "b", "b": "a"}


@dataclass(frozen=True)
class RunSummary:
    """One finished run, with rates over its `n_episodes` final episodes."""

    seed: int
    run_id: str
    run_dir: str | None
    metrics: Mapping[str, float | None]  # by their names in reports
    n_episodes: int | None
    cpu_s: float | None
    reached_90: bool | None = None  # whether 90 % were held; None with too few evaluations
    steps_to_90: float | None = None  # first env step from which they were held
    cpu_s_to_90: float | None = None
    area: float | None = None  # under the learning curve

    @property
    def success(self) -> float | None:
        """Rate of the episodes that succeeded."""
        return self.metrics["success"]


@dataclass(frozen=True)
class Curve:
    """Evaluations during training over the seeds that have them, shape (steps,) each."""

    step: Sequence[int]  # env steps
    mean: Sequence[float | None]  # success, with its range over the seeds
    low: Sequence[float | None]
    high: Sequence[float | None]
    n: Sequence[int]  # seeds
    failure: Sequence[float | None]
    seeds: Sequence[tuple[int, Sequence[int], Sequence[float | None]]]  # (seed, steps, rates)


@dataclass(frozen=True)
class CellSummary:
    """The numbers of one cell over its seeds."""

    id: str  # `c0`, `c1`, ... in the order of the report; colours follow from it
    label: str  # e.g. `her_final, n_sampled_goal=8`; may hold any text
    experiment: str
    name: str  # folder of its runs
    settings: Mapping[str, Setting]  # value of each factor
    counts: Mapping[str, int]  # number of runs done, running, failed and pending
    total_timesteps: int | None
    metrics: Mapping[str, Interval]  # their means, by their names in reports
    cpu_s: Interval
    area: Interval
    lowest: float | None = None  # success of the worst seed
    iqm: float | None = None  # interquartile mean of the seeds' success
    reaching_95: int | None = None  # seeds that end at 95 % or above
    seeds: Sequence[RunSummary] = ()
    curve: Curve | None = None  # None without evaluations during training
    n_timed: int = 0  # seeds with enough evaluations to tell whether they held 90 %
    n_reached_90: int = 0  # timed seeds that held 90 %
    steps_to_90: float | None = None  # median; None where fewer than half of the seeds reach it
    cpu_s_to_90: float | None = None
    task_data: Mapping[str, Any] = field(default_factory=dict)  # what sections of its task show
    figure_data: Any = None  # what figures of its task show beside that; not in `report.json`

    @property
    def success(self) -> Interval:
        """Rate of the episodes that succeeded."""
        return self.metrics["success"]

    @property
    def failure(self) -> Interval:
        """Rate of the episodes that ended badly, whatever its task calls them."""
        rates = [self.metrics[name] for name in FAILURES if name in self.metrics]
        return rates[0] if rates else Interval(None)


@dataclass(frozen=True)
class Pair:
    """Two cells compared on final success."""

    a: str  # ids of the cells
    b: str
    difference: Difference  # mean of a minus mean of b, corrected for the pairs of the report
    # p of Mann and Whitney's test of the ranks of seeds, with the same correction.
    rank_p: float | None
    # `a` or `b`: this cell is better. `same`: neither test nor interval finds a difference.
    # `unclear`: only one of them does. `unknown`: too few seeds.
    verdict: Verdict

    def reverse(self) -> "Pair":
        """Return the comparison of b with a."""
        old = self.difference
        difference = replace(
            old, value=_negate(old.value), low=_negate(old.high), high=_negate(old.low)
        )
        verdict = REVERSED.get(self.verdict, self.verdict)
        return replace(self, a=self.b, b=self.a, difference=difference, verdict=verdict)


def _negate(value: float | None) -> float | None:
    return None if value is None else -value


@dataclass(frozen=True)
class UnfinishedRun:
    """A run without a result, and why."""

    label: str
    seed: int
    status: str
    reason: str
    run_dir: str | None


@dataclass(frozen=True)
class Provenance:
    """What exactly was run."""

    versions: Mapping[str, Mapping[str, int]]  # package -> version -> number of runs
    commits: Mapping[str, int]  # commit, with `+` where files differed from it -> number of runs
    machines: Mapping[str, int]  # CPU -> number of runs
    difference: Mapping[str, Sequence[Setting]]  # config keys that differ -> value in each cell
    common: Mapping[str, Setting]  # the other config keys -> value
    unfinished: Sequence[UnfinishedRun]
    uri: str  # the URI of the store
    left_out: Sequence[str] = ()  # labels of the experiments' other cells
    first: str | None = None  # start of the first run and end of the last one, as ISO 8601 in UTC
    last: str | None = None


@dataclass(frozen=True)
class ReportData:
    """A whole report. Claims, warnings, missing and notes are sentences."""

    title: str
    experiments: Sequence[str]
    made: str  # when, as ISO 8601 in UTC
    version: str  # the version of this package
    quick: bool  # whether it was made while runs may be under way
    command: str  # makes it again
    factors: Sequence[Factor]
    cells: Sequence[CellSummary]
    tasks: Sequence[str]  # names of the cells' tasks
    shown: Sequence[str]  # ids of the cells in figures: all or, of many, some
    baseline: str | None  # id of the cell that the user asked to compare with
    family: str  # a sentence: which pairs were compared, and how p was corrected
    pairs: Sequence[Pair]
    effects: Sequence[MainEffect]  # empty unless factors are crossed
    provenance: Provenance
    claims: Sequence[str] = ()  # findings, the most important first
    warnings: Sequence[str] = ()  # what makes numbers hard to compare
    missing: Sequence[str] = ()  # what has no result (yet)
    notes: Sequence[str] = ()
    reference: str | None = None  # id of the cell in all pairs, if any: the baseline or the best
    declared: bool = False  # whether the pairs were declared as contrasts
    tuning: "StoredSearch | None" = None  # the search; `report.json` calls it so

    @property
    def stages(self) -> Counter[str]:
        """The number of runs that are done, running, failed and pending, where there are some."""
        return sum((Counter(cell.counts) for cell in self.cells), Counter())

    @property
    def labels(self) -> dict[str, str]:
        """The label of each cell by its id."""
        return {cell.id: cell.label for cell in self.cells}

    @property
    def factor_names(self) -> dict[str, str]:
        """The name of each factor by its key."""
        return {factor.key: factor.name for factor in self.factors}

    @property
    def shown_cells(self) -> list[CellSummary]:
        """The cells that figures show."""
        return [cell for cell in self.cells if cell.id in self.shown]

    @property
    def effects_by_size(self) -> list[MainEffect]:
        """The effect of each factor, the largest first."""
        return sorted(self.effects, key=lambda effect: effect.largest.value or 0.0, reverse=True)

    @property
    def drawn_pairs(self) -> Sequence[Pair]:
        """The pairs that figures show: many pairs only if declared or with a reference."""
        chosen = self.declared or self.reference is not None
        return self.pairs if chosen or len(self.pairs) <= MAX_DRAWN_PAIRS else ()

    def plain(self) -> dict[str, Any]:
        """Return everything as JSON can hold it, with metrics beside the other numbers."""
        plain = asdict(self)
        for cell in plain["cells"]:
            del cell["figure_data"]
            cell.update(cell.pop("metrics") | cell.pop("task_data"))
            for seed in cell["seeds"]:
                seed.update(seed.pop("metrics"))
        if self.tuning is not None:
            plain["tuning"]["settings"] = self.tuning.settings.model_dump(by_alias=True)
        return plain
