"""Sentences of a report about a hyperparameter search."""

from collections import Counter
from collections.abc import Iterator

from parking_exp.errors import plural
from parking_exp.reports import formats
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.tuning_data import Tuning


def claims(tuning: Tuning) -> Iterator[str]:
    """Yield which of the retrained trials is best on fresh seeds, and how much it lost from its tuning seeds."""
    if tuning.retested:
        best = tuning.retested[0]
        yield (
            f"On {plural(best.n_test, 'fresh seed')}, “{best.label}” is the best of "
            f"{plural(len(tuning.retested), 'retrained trial')}: {tuning.objectives[0]} "
            f"{formats.rate_interval(best.test)}; tuning minus test {formats.points_interval(best.difference)}."
        )


def search_text(report: ReportData) -> list[str]:
    """Return the paragraphs about a search: its trials, the best of them, what is left out."""
    tuning = report.tuning
    if tuning is None:
        return []
    states = Counter(trial.state for trial in tuning.trials)
    states["pending"] += tuning.n_trials - len(tuning.trials)
    counted = ", ".join(f"{number} {state}" for state, number in states.items() if number)
    noun = "objective is" if len(tuning.objectives) == 1 else "objectives are"
    about = (
        f"{plural(tuning.n_trials, 'trial')} (sampler {tuning.sampler}, pruner {tuning.pruner or 'none'}): {counted}. "
        f"The {noun} {' and '.join(tuning.objectives)}, mean over {plural(tuning.n_seeds, 'tuning seed')}."
    )
    done = [trial for trial in tuning.trials if trial.values]
    if done and len(tuning.objectives) == 1:
        best = max(done, key=lambda trial: trial.values[0])
        about += f" The best is “{best.label}” with {formats.rate_text(best.values[0])}."
    return [about, *tuning.notes]


def retest_text(report: ReportData) -> list[str]:
    """Return the paragraph about the trials that were trained again on fresh seeds."""
    if report.tuning is None or not report.tuning.retested:
        return []
    return [
        "The best trials and trial 0, the unchanged config, were trained again on seeds that no trial was selected "
        "by. Values on tuning seeds are optimistic for the best of many trials."
    ]
