"""The warnings of a report, in sentences: few seeds, mixed conditions, missing runs."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from parking_exp.config.cell_labels import Setting, differing_keys, setting
from parking_exp.errors import plural, quoted_label
from parking_exp.reports.cell_selection import CellRuns
from parking_exp.reports.report_data import Cell, Provenance
from parking_exp.tasks.registry import TRAINING_ONLY

ENOUGH_SEEDS = 10
FEW_NAMES = 4
MIXED = {
    "total_timesteps": "Budgets are mixed: cells were trained for {} env steps.",
    "evaluation.final_n_scenes": (
        "Evaluations are mixed: final models were evaluated in {} episodes."
    ),
    "evaluation.first_scene": "Evaluations are mixed: their episodes begin at seeds {}.",
    "evaluation.n_scenes": "Evaluations are mixed: those during training had {} episodes.",
    "evaluation.every_n_steps": (
        "Evaluations are mixed: every {} env steps, which changes times to 90 %."
    ),
}
"""Config keys that should be the same in all cells, and the warning where they are not."""


def list_names(names: Sequence[str]) -> str:
    """List labels and the like, the first few of many; one that has commas itself is in quotes."""
    few = [quoted_label(name) for name in names[:FEW_NAMES]]
    last = f"{len(names) - FEW_NAMES} more" if len(names) > FEW_NAMES else few.pop()
    return f"{', '.join(few)} and {last}" if few else last


def find_incomparable(
    runs: Sequence[CellRuns], cells: Sequence[Cell], origin: Provenance
) -> Iterator[str]:
    """Yield what makes numbers hard to compare."""
    if few := [cell.success.n for cell in cells if cell.success.n < ENOUGH_SEEDS]:
        some = f"{len(few)} of {plural(len(cells), 'cell')}"
        yield (
            f"Exploratory: fewer than {ENOUGH_SEEDS} finished seeds in {some} (the fewest: "
            f"{min(few)})."
        )
    yield from _find_mixed(runs, origin)
    for note in dict.fromkeys(cell.note for cell in cells if cell.note):
        yield f"{list_names([cell.label for cell in cells if cell.note == note])}: {note}"
    for cell in runs:
        if cell.n_repeated:
            yield (
                f"{quoted_label(cell.label)}: {plural(cell.n_repeated, 'run')} left out: another "
                "has the same seed."
            )
        if blank := int(cell.done["success_rate"].isna().sum()):
            yield (
                f"{quoted_label(cell.label)}: {plural(blank, 'run')} left out: no final success "
                "rate."
            )
    # What ends a cell's name is a hash of its config.
    for name in dict.fromkeys(cell.name for cell in runs):
        if len(same := [cell.label for cell in runs if cell.name == name]) > 1:
            yield (
                f"{list_names(same)} have the same config: runs with equal seeds are duplicates, "
                "not replicates."
            )


def find_missing(
    cells: Sequence[Cell], experiments: Iterable[str], stored: Iterable[str]
) -> Iterator[str]:
    """Yield which runs have no result, and which experiments have no runs."""
    total = sum((Counter(cell.counts) for cell in cells), Counter())
    waiting = {"running": "under way", "failed": "failed", "pending": "interrupted or not started"}
    if stages := [f"{total[stage]} {words}" for stage, words in waiting.items() if total[stage]]:
        yield f"Runs done: {total['done']} of {total.total()}; {', '.join(stages)}."
    if empty := [cell.label for cell in cells if not cell.counts["done"]]:
        yield f"No run is done of {list_names(empty)}."
    known = set(stored)
    yield from (f"Experiment {name} has no runs." for name in experiments if name not in known)


def _find_mixed(runs: Sequence[CellRuns], origin: Provenance) -> Iterator[str]:
    for package, versions in origin.versions.items():
        if len(versions) > 1:
            yield f"Versions are mixed: {package} {list_names(list(versions))}."
    if len(origin.commits) > 1:
        yield f"Commits are mixed: {list_names(list(origin.commits))}."
    if any(commit.endswith("+") for commit in origin.commits):
        yield "Some runs were made from files that differ from their commit (marked +)."
    if len(origin.machines) > 1:
        yield (
            "Machines are mixed, so that CPU-seconds do not compare: "
            f"{list_names(list(origin.machines))}."
        )
    for key, words in MIXED.items():
        values = list(dict.fromkeys(value for cell in runs for value in _values_of_runs(cell, key)))
        if len(values) > 1:
            yield words.format(_list_values(values))
    keys = [key for key in differing_keys([cell.config for cell in runs]) if key.startswith("env.")]
    if mixed := [key for key in keys if key not in TRAINING_ONLY]:
        yield (
            f"Tasks are mixed: cells differ in {list_names(mixed)}; their rates are not of the "
            "same episodes."
        )
    if len({tuple(cell.done["seed"]) for cell in runs if len(cell.done)}) > 1:
        yield "Cells do not have the same seeds."


def _values_of_runs(cell: CellRuns, key: str) -> list[Setting]:
    """Return the values of a config key; the runs of a cell may differ in the settings of their
    final evaluation.
    """
    if key == "evaluation.final_n_scenes":
        return [int(number) for number in cell.runs["n_scenes"].dropna()]
    return [cell.config.get(key)]


def _list_values(values: Sequence[Setting]) -> str:
    """List config values; of more than two numbers, the smallest and the largest."""
    numbers = sorted(value for value in values if isinstance(value, int))
    if len(values) == len(numbers) > 1:
        return f"{numbers[0]:,} {'and' if len(numbers) == 2 else 'to'} {numbers[-1]:,}"
    return list_names([setting(value) for value in values])
