"""Tables and lines about trials for a terminal."""

from collections.abc import Iterator, Sequence

from rich.table import Table

from parking_exp.errors import plural
from parking_exp.runs.state_tables import duration
from parking_exp.tuning.search_config import Dimension, SearchConfig
from parking_exp.tuning.trials import TrialRow, counts, ranked

SHOWN = 15


def space_table(search: SearchConfig) -> Table:
    """Return one row for each key of the space."""
    table = Table(box=None, pad_edge=False)
    table.add_column("key")
    table.add_column("tried")
    for key, dimension in search.space.items():
        table.add_row(key, dimension_text(dimension))
    return table


def dimension_text(dimension: Dimension) -> str:
    """Describe a dimension in a line."""
    low, high = dimension.bounds
    condition = ", ".join(f"{key}={'|'.join(map(str, values))}" for key, values in dimension.when.items())
    if dimension.choices is not None:
        text = " | ".join(map(str, dimension.choices))
    else:
        scale = {"log": ", log", "one_minus_log": ", log of 1 - x"}
        form = next(name for name in ("log", "uniform", "one_minus_log", "whole") if getattr(dimension, name))
        whole = ", whole" if form == "whole" else ""
        text = f"{low:g} … {high:g}{scale.get(form, whole)}"
    return f"{text}   if {condition}" if condition else text


def trial_table(trials: Sequence[TrialRow], search: SearchConfig, most: int = SHOWN) -> Table:
    """Return the best trials, then running and failed ones: state, value and changes."""
    table = Table(box=None, pad_edge=False)
    table.add_column("trial", justify="right")
    table.add_column("state")
    for name in search.objective:
        table.add_column(name, justify="right")
    table.add_column("changes", overflow="fold")
    best = ranked(trials)
    others = [trial for trial in trials if trial.state in ("running", "failed")]
    for trial in [*best[: max(1, most - len(others))], *others[:most]]:
        values = [f"{value:.1%}" for value in trial.values]  # none before the trial is done
        values += [""] * (len(search.objective) - len(values))
        changes = trial.reason or trial.label.partition(": ")[2]
        table.add_row(str(trial.number), trial.state, *values, changes)
    return table


def progress_lines(trials: Sequence[TrialRow], search: SearchConfig, n_trials: int) -> Iterator[str]:
    """Yield the progress of a search: trials in each state, the best so far, time left."""
    found = counts(trials)
    pending = found["pending"] + n_trials - len(trials)
    parts = [f"{number} {state}" for state, number in {**found, "pending": pending}.items() if number]
    yield f"{plural(n_trials, 'trial')}: {', '.join(parts)}"
    if best := ranked(trials):
        values = zip(search.objective, best[0].values, strict=True)
        words = ", ".join(f"{name} {value:.1%}" for name, value in values)
        yield f"best so far: {best[0].label} ({words})"
    if (left := left_s(trials, n_trials)) is not None:
        yield f"about {duration(left)} left"


def left_s(trials: Sequence[TrialRow], n_trials: int) -> float | None:
    """Estimate the time left [s] from the mean duration of the trials that are over."""
    took = [trial.seconds for trial in trials if trial.state in ("done", "pruned") and trial.seconds]
    running = sum(trial.state == "running" for trial in trials)
    over = sum(trial.state in ("done", "pruned", "failed") for trial in trials)
    if not took or over >= n_trials or not running:
        return None
    return sum(took) / len(took) * (n_trials - over) / running
