"""Dataclasses of a report's content, which `report.json` holds as it is; `report_builder` makes them.

Rates are shares in 0 ... 1, and None where they are not known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, cast

from parking_exp.config.cell_labels import Factor, Setting
from parking_exp.envs.outcomes import Outcome
from parking_exp.statistics import Interval, MainEffect, ParameterImportance, Proportion

if TYPE_CHECKING:
    from parking_exp.reports.search_report import Tuning

Verdict = Literal["a", "b", "same", "unknown"]
Design = Literal["single", "list", "factorial", "search"]
"""How cells differ: one cell; a list without a plan; crossed factors; many points drawn from ranges."""


@dataclass(frozen=True)
class Seed:
    """One finished run: rates over its `n_scenes` final episodes, and `low`, `high`: Wilson's interval of `success`.

    `steps_to_90` is the first env step from which three evaluations in a row had 90 %; where `reached_90` is False, the
    last one from which that could have been seen. `area` is that under its curve.
    """

    seed: int
    run_id: str
    run_dir: str | None
    success: float | None
    crash: float | None
    timeout: float | None
    parked: float | None
    n_scenes: int | None
    low: float | None
    high: float | None
    episode_steps: float | None
    cpu_s: float | None
    steps_to_90: float | None
    reached_90: bool
    cpu_s_to_90: float | None
    area: float | None
    further: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class Curve:
    """Evaluations during training: mean success with its interval at each env step, over the `n` seeds that have it.

    `seeds` are (seed, steps, rates) of each run, unfinished ones included in a quick report. Other shapes: (steps,).
    """

    step: Sequence[int]
    mean: Sequence[float | None]
    low: Sequence[float | None]
    high: Sequence[float | None]
    n: Sequence[int]
    crash: Sequence[float | None]
    seeds: Sequence[tuple[int, Sequence[int], Sequence[float | None]]]


@dataclass(frozen=True)
class Survival:
    """Time until 90 % of the scenes succeed in three evaluations in a row, over seeds: Kaplan and Meier's estimate.

    Attributes:
        unit: `env steps` or `CPU-seconds`.
        time, reached, low, high: share of seeds that have reached it by then, and its interval; from 0 on, shape (n,).
        censored: times at which the observation of a seed that has not reached it ended.
        n, k: seeds, and how many of them have reached it.
        median: None where fewer than half have.
        restricted_mean: mean time up to `horizon`, the shortest observation of all cells.
    """

    unit: str
    time: Sequence[float]
    reached: Sequence[float]
    low: Sequence[float | None]
    high: Sequence[float | None]
    censored: Sequence[float]
    n: int
    k: int
    median: float | None
    restricted_mean: Interval
    horizon: float | None


@dataclass(frozen=True)
class SlotRate:
    """Shares of outcomes in the `n` episodes of all seeds whose goal is one slot, 0 ... 27."""

    slot: int
    n: int
    success: float | None
    crash: float | None
    timeout: float | None


@dataclass(frozen=True)
class Path:
    """One episode seen from above: poses at the start and after each step; of a long one, after every fifth."""

    seed: int
    scene: int
    outcome: Outcome
    slot: int
    x_m: Sequence[float]
    y_m: Sequence[float]
    heading_rad: Sequence[float]
    steps: int
    parked_slots: Sequence[int] = ()


@dataclass(frozen=True)
class Cell:
    """One cell of the comparison.

    Attributes:
        id: `c0`, `c1`, ... in the order of the report; also what its colour follows from.
        label: what sets it apart from the others, e.g. `her_final, n_sampled_goal=8`; may hold any text.
        name: the folder of its runs.
        settings: the value of each factor.
        counts: how many runs are done, running, failed, pending; and pruned, if a search has pruned some.
        curve, survival, survival_cpu: None without evaluations during training.
        failures: (x_m, y_m, outcome) where crashes and timeouts ended, of runs that keep trajectories.
        note: a sentence about an interval that is too narrow or missing; None if all is well.
        further: means of other metrics that reports have, by name.
    """

    id: str
    label: str
    experiment: str
    name: str
    settings: Mapping[str, Setting]
    counts: Mapping[str, int]
    total_timesteps: int | None
    success: Interval
    crash: Interval
    timeout: Interval
    parked: Interval
    episode_steps: Interval
    cpu_s: Interval
    area: Interval
    reaching_90: Proportion
    seeds: Sequence[Seed] = ()
    curve: Curve | None = None
    survival: Survival | None = None
    survival_cpu: Survival | None = None
    slots: Sequence[SlotRate] = ()
    failures: Sequence[tuple[float, float, str]] = ()
    paths: Sequence[Path] = ()
    note: str | None = None
    further: Mapping[str, Interval] = field(default_factory=dict)


@dataclass(frozen=True)
class Pair:
    """Two cells compared on final success.

    Attributes:
        a, b: ids of the cells.
        difference, p, p_holm: mean of a minus mean of b, by Welch's test; corrected for the report's family.
        improvement: probability that a seed of a is better than one of b, ties counted half.
        log_rank_p, log_rank_p_holm: of the times to 90 %; None where none was reached.
        verdict: `a` or `b` is better (p_holm below 0.05), `same`: not significant, `unknown`: too few seeds.
        note: a sentence about an interval that is too narrow; None if all is well.
    """

    a: str
    b: str
    difference: Interval
    p: float | None
    p_holm: float | None
    improvement: Interval
    log_rank_p: float | None
    log_rank_p_holm: float | None
    verdict: Verdict
    note: str | None = None

    def turned(self) -> "Pair":
        """Return the same pair the other way round."""

        def mirrored(interval: Interval, total: float) -> Interval:
            ends = (interval.value, interval.high, interval.low)
            value, low, high = (None if end is None else total - end for end in ends)
            return replace(interval, value=value, low=low, high=high)

        verdict = cast(Verdict, {"a": "b", "b": "a"}.get(self.verdict, self.verdict))
        difference, improvement = mirrored(self.difference, 0.0), mirrored(self.improvement, 1.0)
        return replace(self, a=self.b, b=self.a, difference=difference, improvement=improvement, verdict=verdict)


@dataclass(frozen=True)
class Interaction:
    """Two factors crossed; grids have the shape (rows, columns), and None without runs.

    Attributes:
        given: settings of the other factors that this table is for, e.g. `env=parking_sparse`; None for all.
        residual: what the two main effects do not explain.
        real_share: measured share of real transitions in batches, where a factor is n_sampled_goal.
        p: of the F test of interaction, with Holm's correction for the tables; None where it can't be made.
    """

    row: str
    column: str
    given: str | None
    rows: Sequence[Setting]
    columns: Sequence[Setting]
    mean: Sequence[Sequence[float | None]]
    low: Sequence[Sequence[float | None]]
    high: Sequence[Sequence[float | None]]
    n: Sequence[Sequence[int]]
    residual: Sequence[Sequence[float | None]]
    real_share: Sequence[Sequence[float | None]] | None = None
    p: float | None = None


@dataclass(frozen=True)
class FailedRun:
    """A run without a result, and why."""

    label: str
    seed: int
    status: str
    reason: str
    run_dir: str | None


@dataclass(frozen=True)
class Provenance:
    """What exactly was run.

    Attributes:
        versions: package -> version -> number of runs.
        commits: commit (with `+` where files differed from it) -> number of runs; `machines`: CPU -> number of runs.
        difference: config key -> value in each cell, in the order of the cells; only keys that differ.
        common: the rest of the config, dotted key -> value.
        uri: of the store, without passwords.
        left_out: labels of the experiments' other cells.
        first, last: when the first run began and the last one ended, as ISO 8601 in UTC.
    """

    versions: Mapping[str, Mapping[str, int]]
    commits: Mapping[str, int]
    machines: Mapping[str, int]
    difference: Mapping[str, Sequence[Setting]]
    common: Mapping[str, Setting]
    unfinished: Sequence[FailedRun]
    uri: str
    left_out: Sequence[str] = ()
    first: str | None = None
    last: str | None = None


@dataclass(frozen=True)
class ReportData:
    """A whole report.

    Attributes:
        made: when, as ISO 8601 in UTC; `version` of this package.
        quick: whether it was made while a sweep may be under way.
        command: how to make it again.
        shown: ids of the cells in figures: all of them, or the first ones by success where there are too many.
        baseline: id of the cell that others are to be compared with.
        reference: id of the cell that all others are compared with: the baseline or, where cells are many, the one with
            the highest mean; None: all pairs.
        family: a sentence: which pairs were compared, and how p was corrected.
        pairs, effects, interactions, importance: empty where they make no sense.
        exploratory: fewer than 10 seeds somewhere.
        claims, warnings, missing, notes: sentences: findings, the most important first; what makes numbers hard to
            compare; what is not there (yet).
    """

    title: str
    experiments: Sequence[str]
    made: str
    version: str
    quick: bool
    command: str
    design: Design
    factors: Sequence[Factor]
    cells: Sequence[Cell]
    shown: Sequence[str]
    baseline: str | None
    family: str
    pairs: Sequence[Pair]
    effects: Sequence[MainEffect]
    interactions: Sequence[Interaction]
    importance: Sequence[ParameterImportance]
    exploratory: bool
    claims: Sequence[str]
    warnings: Sequence[str]
    missing: Sequence[str]
    provenance: Provenance
    notes: Sequence[str] = field(default_factory=tuple)
    reference: str | None = None
    tuning: "Tuning | None" = None

    def cell(self, cell_id: str) -> Cell:
        """Return a cell by its id."""
        return next(cell for cell in self.cells if cell.id == cell_id)

    @property
    def shown_cells(self) -> list[Cell]:
        """The cells that figures show."""
        return [cell for cell in self.cells if cell.id in self.shown]

    def plain(self) -> dict[str, Any]:
        """Return everything as JSON can hold it; further metrics of cells and seeds stand beside the others."""
        plain = asdict(self)
        for cell in plain["cells"]:
            cell.update(cell.pop("further"))
            for seed in cell["seeds"]:
                seed.update(seed.pop("further"))
        return plain
