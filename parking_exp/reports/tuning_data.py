"""Dataclasses of what a report says of a hyperparameter search."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from parking_exp.reports.report_data import Factor, Interval, Setting


@dataclass(frozen=True)
class Objective:
    """An objective of a search.

    Attributes:
        name: e.g. `success_auc`.
        higher_is_better: whether it is maximised.
        is_rate: whether it lies in 0 ... 1; else it is a cost [CPU-s].
        missed_from: mean over seeds from which on some of them never held 95 %; None for rates.
    """

    name: str
    higher_is_better: bool
    is_rate: bool
    missed_from: float | None = None

    def missed(self, value: float) -> bool:
        """Whether a mean over seeds says that some of them never held 95 %, and is no cost."""
        return self.missed_from is not None and value >= self.missed_from


@dataclass(frozen=True)
class Trial:
    """A trial of a search.

    Attributes:
        number: 0 is the config as it stands.
        label: its number and what it changes in that config.
        state: done, pruned, failed, running, or pending.
        settings: value of each parameter that it has, by `Factor.key`.
        values: of the objectives, means over tuning seeds; none before it is done.
        best: of each objective, the best value of all trials up to this one; none before one is done.
        by_seed: values of each tuning seed, shape (seeds, objectives).
        env_steps, cpu_s, cost: of all its runs; the cost is in CPU-seconds of an idle core. None where not known.
        seconds: from its begin to its end.
        reason: why it failed.
    """

    number: int
    label: str
    state: str
    settings: Mapping[str, Setting]
    values: Sequence[float] = ()
    best: Sequence[float] = ()
    by_seed: Sequence[Sequence[float]] = ()
    env_steps: int | None = None
    cpu_s: float | None = None
    cost: float | None = None
    seconds: float | None = None
    reason: str | None = None


@dataclass(frozen=True)
class Budget:
    """Env steps that trials took. Runs that several trials have count once.

    Attributes:
        done, pruned: env steps of trials that are done, and of pruned ones.
        n_done, n_pruned: how many trials these are.
        saved: env steps that the pruned trials did not take; None where it is not known how many they would have taken.
    """

    done: int
    pruned: int
    n_done: int
    n_pruned: int
    saved: int | None


@dataclass(frozen=True)
class Retested:
    """A trial that was trained again on fresh seeds.

    Attributes:
        number, label: of the trial.
        tuning, test: its objective on each tuning seed and on each test seed.
        tuning_mean, test_mean: with intervals; without a value where a cost has seeds that never held 95 %.
        difference: tuning minus test, with Welch's interval; without a value where one of the means has none.
        tuning_missed, test_missed: seeds that never held 95 %; 0 for rates.
    """

    number: int
    label: str
    tuning: Sequence[float]
    test: Sequence[float]
    tuning_mean: Interval
    test_mean: Interval
    difference: Interval
    tuning_missed: int = 0
    test_missed: int = 0


@dataclass(frozen=True)
class Tuning:
    """The hyperparameter search of an experiment.

    Attributes:
        experiment: its name.
        sampler, pruner: of the search.
        n_trials: how many it is to have.
        objectives: one or several.
        tuning_seeds, test_seeds: those of all trials, and those of the trials that were trained again.
        parameters: what it tries, in the order of its space, with the values that trials had.
        trials: those that have begun, or wait to, by number.
        budget: env steps of trials that are done and of pruned ones.
        front: numbers of the trials that no other beats in all objectives; none for a single objective.
        importance: parameter -> share of the importances of all, by PED-ANOVA; empty where too few trials are done.
        retested: trials that were trained again on the test seeds, best first.
        retested_on: the objective that these are compared by.
        notes: sentences about what is left out, and why.
    """

    experiment: str
    sampler: str
    pruner: str | None
    n_trials: int
    objectives: Sequence[Objective]
    tuning_seeds: Sequence[int]
    test_seeds: Sequence[int]
    parameters: Sequence[Factor]
    trials: Sequence[Trial]
    budget: Budget
    front: Sequence[int] = ()
    importance: Mapping[str, float] = field(default_factory=dict)
    retested: Sequence[Retested] = ()
    retested_on: Objective | None = None
    notes: Sequence[str] = ()

    @property
    def done(self) -> list[Trial]:
        """The trials that are done."""
        return [trial for trial in self.trials if trial.values]
