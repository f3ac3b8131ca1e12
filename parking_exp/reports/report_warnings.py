"""The warnings of a report, in sentences: few seeds, mixed conditions, missing runs."""

from collections.abc import Iterable, Iterator, Sequence

from parking_exp.config.cell_labels import Setting
from parking_exp.errors import plural, quoted_label
from parking_exp.reports.report_data import ReportData
from parking_exp.tasks.registry import TRAINING_ONLY

ENOUGH_SEEDS = 10
FEW_NAMES = 4
WAITING = {"running": "under way", "failed": "failed", "pending": "interrupted or not started"}
MIXED = {
    "total_timesteps": "Budgets are mixed: cells were trained for {} env steps.",
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


def find_incomparable(report: ReportData) -> Iterator[str]:
    """Yield what makes numbers hard to compare."""
    cells = report.cells
    few = [cell.success.n for cell in cells if cell.success.n < ENOUGH_SEEDS]
    if few:
        yield (
            f"Exploratory: fewer than {ENOUGH_SEEDS} finished seeds in {len(few)} of "
            f"{plural(len(cells), 'cell')} (the fewest: {min(few)})."
        )
    yield from _find_mixed_origins(report)
    yield from _find_mixed_settings(report)
    for cell in cells:
        label = quoted_label(cell.label)
        if cell.note:
            yield f"{label}: {cell.note}"
        n_blank = sum(seed.success is None for seed in cell.seeds)
        if n_blank:
            yield f"{label}: {plural(n_blank, 'run')} left out: no final success rate."


def find_missing(report: ReportData) -> Iterator[str]:
    """Yield which runs have no result."""
    runs = report.stages
    stages = [f"{runs[stage]} {words}" for stage, words in WAITING.items() if runs[stage]]
    if stages:
        yield f"Runs done: {runs['done']} of {runs.total()}; {', '.join(stages)}."
    empty = [cell.label for cell in report.cells if not cell.counts["done"]]
    if empty:
        yield f"No run is done of {list_names(empty)}."


def _find_mixed_origins(report: ReportData) -> Iterator[str]:
    origin = report.provenance
    for package, versions in origin.versions.items():
        if len(versions) > 1:
            yield f"Versions are mixed: {package} {list_names(list(versions))}."
    if len(origin.commits) > 1:
        yield f"Commits are mixed: {list_names(list(origin.commits))}."
    if any(commit.endswith("+") for commit in origin.commits):
        yield "Some runs were made from files that differ from their commit (marked +)."
    if len(origin.machines) > 1:
        machines = list_names(list(origin.machines))
        yield f"Machines are mixed, so that CPU-seconds do not compare: {machines}."


def _find_mixed_settings(report: ReportData) -> Iterator[str]:
    n_episodes = [seed.n_episodes for cell in report.cells for seed in cell.seeds]
    if len(set(n_episodes)) > 1:
        numbers = _write_range(n_episodes)
        yield f"Evaluations are mixed: final models were evaluated in {numbers} episodes."
    difference = report.provenance.difference
    for key, words in MIXED.items():
        if key in difference:
            yield words.format(_write_range(difference[key]))
    mixed = [key for key in difference if key.startswith("env.") and key not in TRAINING_ONLY]
    if mixed:
        yield (
            f"Tasks are mixed: cells differ in {list_names(mixed)}; their rates are not of the "
            "same episodes."
        )
    if len({tuple(seed.seed for seed in cell.seeds) for cell in report.cells if cell.seeds}) > 1:
        yield "Cells do not have the same seeds."


def _write_range(values: Iterable[Setting]) -> str:
    numbers = [value for value in values if isinstance(value, int)]
    return f"{min(numbers):,} to {max(numbers):,}"
