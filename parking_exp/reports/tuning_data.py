"""Dataclasses of a report's hyperparameter search."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from parking_exp.reports.report_data import Interval
from parking_exp.tuning.trials import TrialRow


@dataclass(frozen=True)
class Retested:
    """A trial that was trained again on fresh seeds.

    Attributes:
        number, label: of the trial.
        n_tuning, n_test: number of tuning seeds and of fresh seeds.
        tuning, test: mean objective on each, with its interval.
        difference: tuning minus test, with Welch's interval.
    """

    number: int
    label: str
    n_tuning: int
    n_test: int
    tuning: Interval
    test: Interval
    difference: Interval


@dataclass(frozen=True)
class Tuning:
    """The hyperparameter search of an experiment.

    Attributes:
        experiment: its name.
        sampler, pruner: of the search.
        n_trials: number of trials requested.
        objectives: names; all are maximised.
        n_seeds: number of tuning seeds of each trial.
        parameters: name -> Optuna's distribution, as `optuna.distributions.distribution_to_json` describes it.
        trials: those that have begun or are enqueued, by number.
        retested: trials that were trained again on fresh seeds, best first.
        notes: what is left out, and why.
    """

    experiment: str
    sampler: str
    pruner: str | None
    n_trials: int
    objectives: Sequence[str]
    n_seeds: int
    parameters: Mapping[str, Mapping[str, Any]]
    trials: Sequence[TrialRow]
    retested: Sequence[Retested] = ()
    notes: Sequence[str] = ()
