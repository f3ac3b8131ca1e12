"""The warnings of a report, in sentences: few seeds, mixed conditions, missing runs."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

from parking_exp.errors import plural, quoted_label
from parking_exp.reports.cell_selection import CellRuns
from parking_exp.reports.formats import setting
from parking_exp.reports.report_data import Cell, Pair, Provenance

ENOUGH_SEEDS = 10
FEW_NAMES = 4
MIXED = {
    "total_timesteps": "Budgets are mixed: cells were trained for {} env steps.",
    "evaluation.final_n_scenes": "Evaluations are mixed: final models were evaluated in {} episodes.",
    "evaluation.first_scene": "Evaluations are mixed: their episodes begin at seeds {}.",
    "evaluation.n_scenes": "Evaluations are mixed: those during training had {} episodes.",
    "evaluation.every_n_steps": "Evaluations are mixed: every {} env steps, which changes times to 90 %.",
    "env.name": "Tasks are mixed: cells belong to the envs {}; their rates are not of the same episodes.",
}
"""Config keys that should be the same in all cells, and the warning where they are not."""


def named(names: Sequence[str]) -> str:
    """List labels and the like, the first few of many; one that has commas itself is in quotes."""
    return _listed([quoted_label(name) for name in names])


def _listed(names: Sequence[str]) -> str:
    few = names[:FEW_NAMES]
    if len(names) > FEW_NAMES:
        return f"{', '.join(few)} and {len(names) - FEW_NAMES} more"
    return few[0] if len(few) == 1 else f"{', '.join(few[:-1])} and {few[-1]}"


def warnings(
    runs: Sequence[CellRuns], cells: Sequence[Cell], pairs: Sequence[Pair], origin: Provenance
) -> Iterator[str]:
    """Yield what makes numbers hard to compare."""
    if few := [cell.success.n for cell in cells if cell.success.n < ENOUGH_SEEDS]:
        some = f"{len(few)} of {len(cells)} cells {'has' if len(few) == 1 else 'have'}"
        if len(few) == len(cells):
            some = "the cell has" if len(cells) == 1 else f"all {len(cells)} cells have"
        yield f"Exploratory: {some} fewer than {ENOUGH_SEEDS} finished seeds (the fewest: {min(few)})."
    yield from _mixed(runs, origin)
    labels = {cell.id: quoted_label(cell.label) for cell in cells}
    cell_notes = {cell.note for cell in cells}
    yield from _grouped((cell.note, labels[cell.id]) for cell in cells)
    for cell in runs:
        label = quoted_label(cell.label)
        if cell.n_repeated:
            yield f"{label}: {_runs(cell.n_repeated)} left out, since another one has the same seed."
        if blank := int(cell.done["success_rate"].isna().sum()):
            yield f"{label}: {_runs(blank)} finished without a final success rate, and left out."
    # What ends a cell's name is a hash of its config.
    for same in _by((cell.name, cell.label) for cell in runs).values():
        if len(same) > 1:
            yield f"{named(same)} have the same config: equal seeds are equal runs, and they are not independent."
    yield from _grouped(
        (pair.note, f"{labels[pair.a]} against {labels[pair.b]}") for pair in pairs if pair.note not in cell_notes
    )


def missing(cells: Sequence[Cell], experiments: Iterable[str], stored: Iterable[str]) -> Iterator[str]:
    """Yield which runs have no result, and which experiments have no runs. Pruned runs are over, and do not count."""
    total = sum((Counter(cell.counts) for cell in cells), Counter())
    waiting = {"running": "under way", "failed": "failed", "pending": "interrupted or not started"}
    if stages := [f"{total[stage]} {words}" for stage, words in waiting.items() if total[stage]]:
        everything = sum(total.values()) - total["pruned"]
        are = "is" if everything == 1 else "are"
        yield f"{total['done']} of {plural(everything, 'run')} {are} done: {', '.join(stages)}."
    if empty := [cell.label for cell in cells if not cell.counts["done"]]:
        yield f"No run is done of {named(empty)}."
    known = set(stored)
    yield from (f"Experiment {name} has no runs." for name in experiments if name not in known)


def _mixed(runs: Sequence[CellRuns], origin: Provenance) -> Iterator[str]:
    for package, versions in origin.versions.items():
        if len(versions) > 1:
            yield f"Versions are mixed: {package} {named(list(versions))}."
    if len(origin.commits) > 1:
        yield f"Commits are mixed: {named(list(origin.commits))}."
    if any(commit.endswith("+") for commit in origin.commits):
        yield "Some runs were made from files that differ from their commit (marked +)."
    if len(origin.machines) > 1:
        yield f"Machines are mixed, so that CPU-seconds do not compare: {named(list(origin.machines))}."
    for key, words in MIXED.items():
        values = list(dict.fromkeys(cell.config.get(key) for cell in runs))
        if len(values) > 1:
            yield words.format(named([f"{v:,}" if isinstance(v, int) else setting(v) for v in values]))
    if len({tuple(cell.done["seed"]) for cell in runs if len(cell.done)}) > 1:
        yield "Cells do not have the same seeds."


def _grouped(notes: Iterable[tuple[str | None, str]]) -> Iterator[str]:
    """Yield each note once, after the names that it is about."""
    for note, names in _by((note, name) for note, name in notes if note).items():
        yield f"{_listed(names)}: {note}"


def _by(pairs: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    values: dict[str, list[str]] = {}
    for key, value in pairs:
        values.setdefault(key, []).append(value)
    return values


def _runs(number: int) -> str:
    return "a run was" if number == 1 else f"{number} runs were"
