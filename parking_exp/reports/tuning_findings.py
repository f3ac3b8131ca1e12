"""Sentences of a report about a hyperparameter search: its values, trials, pruning and re-runs."""

from collections.abc import Iterator, Sequence

from parking_exp.errors import plural
from parking_exp.reports import formats
from parking_exp.reports.report_data import Interval, ReportData
from parking_exp.reports.tuning_data import Budget, Objective, Tuning
from parking_exp.tuning.objectives import describe
from parking_exp.tuning.trials import STATES


def named(label: str) -> str:
    """Return a trial's label as it stands in a sentence."""
    return f"“{label}”"


def value_text(objective: Objective, value: float, n_seeds: int) -> str:
    """Write a trial's value: `93.1 %`, `41.5 CPU-s`, or how many of its seeds never held 95 %."""
    return formats.rate_text(value) if objective.is_rate else describe(objective.name, value, n_seeds)


def mean_text(objective: Objective, interval: Interval, missed: int, n_seeds: int) -> str:
    """Write a re-run trial's mean with its interval, or how many of its seeds never held 95 %."""
    if missed:
        return f"{missed} of {n_seeds} seeds never hold 95 %"
    if objective.is_rate:
        return formats.rate_interval(interval)
    return _cost_text(interval)


def difference_text(objective: Objective, difference: Interval) -> str:
    """Write tuning minus test, in percentage points or CPU-seconds, with its interval; nothing where it has none."""
    if difference.value is None:
        return ""
    return formats.points_interval(difference) if objective.is_rate else _cost_text(difference, "+")


def _cost_text(interval: Interval, sign: str = "") -> str:
    ends = (interval.value, interval.low, interval.high)
    value, low, high = ("" if one is None else f"{one:{sign},.1f}".replace("-", "−") for one in ends)  # noqa: RUF001
    return f"{value} CPU-s" + (f" [{low}, {high}]" if low and high else "")


def claims(tuning: Tuning) -> Iterator[str]:
    """Yield which of the trials that were trained again does best on fresh seeds, and how it did on those of tuning."""
    objective = tuning.retested_on
    if not tuning.retested or objective is None:
        return
    best = tuning.retested[0]
    value = mean_text(objective, best.test_mean, best.test_missed, len(best.test))
    again = f"Of the {plural(len(tuning.retested), 'trial')} trained again on fresh seeds"
    yield f"{again}, {named(best.label)} does best: {objective.name} {value}."


def search_text(report: ReportData) -> list[str]:
    """Return the paragraphs about a search: its trials, what pruning saved, what is left out."""
    tuning = report.tuning
    if tuning is None:
        return []
    found = {state: sum(trial.state == state for trial in tuning.trials) for state in STATES}
    found["pending"] += tuning.n_trials - len(tuning.trials)
    states = ", ".join(f"{number} {state}" for state, number in found.items() if number)
    names = " and ".join(objective.name for objective in tuning.objectives)
    which = f"The objective is {names}" if len(tuning.objectives) == 1 else f"The objectives are {names}"
    seeds = plural(len(tuning.tuning_seeds), "tuning seed")
    how = f"sampler {tuning.sampler}, pruner {tuning.pruner or 'none'}"
    told = f"{plural(tuning.n_trials, 'trial')} ({how}): {states}. {which}, mean over {seeds}."
    return [told, *_pruning(tuning.budget), *tuning.notes]


def _pruning(budget: Budget) -> Iterator[str]:
    """Yield what pruning saved."""
    if not budget.n_pruned:
        return
    if budget.saved is None:
        yield f"{plural(budget.n_pruned, 'pruned trial')} took {budget.pruned:,} env steps."
        return
    whole, everything = budget.pruned + budget.saved, budget.done + budget.pruned + budget.saved
    share = f"{100 * budget.saved / everything:.0f} %" if everything else "nothing"
    yield (
        f"Pruning saved {budget.saved:,} env steps, {share} of what the trials would have taken: "
        f"{plural(budget.n_pruned, 'pruned trial')} took {budget.pruned:,} of {whole:,}."
    )


def retest_text(report: ReportData) -> list[str]:
    """Return the paragraphs about the trials that were trained again on fresh seeds."""
    tuning = report.tuning
    if tuning is None or tuning.retested_on is None:
        return []
    objective, best = tuning.retested_on, tuning.retested[0]
    zero = " and trial 0, the config as it stands," if any(one.number == 0 for one in tuning.retested) else ""
    told = [
        f"The best trials{zero} were trained again on {_seeds(best.test)} that no trial was chosen by. On tuning seeds "
        "the best are too good on average, the more so the more trials there are."
    ]
    if difference := difference_text(objective, best.difference):
        told.append(f"{named(best.label)}: tuning minus test {difference}.")
    for one in tuning.retested:
        if one.tuning_missed or one.test_missed:
            told.append(
                f"{named(one.label)}: 95 % are never held by {one.tuning_missed} of {_seeds(one.tuning)} of "
                f"tuning and {one.test_missed} of {_seeds(one.test)} of the test."
            )
    return told


def _seeds(values: Sequence[float]) -> str:
    return plural(len(values), "seed")
