"""The warnings of a report, in sentences: few seeds, mixed conditions, missing runs."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence

from parking_exp.errors import plural, quoted_label
from parking_exp.reports.formats import setting
from parking_exp.reports.report_data import Cell, Pair, Provenance
from parking_exp.reports.selection import Group

ENOUGH_SEEDS = 10
FEW_NAMES = 4


def named(names: Sequence[str]) -> str:
    """List labels and the like, the first few of many; one that has commas itself is in quotes."""
    return _listed([quoted_label(name) for name in names])


def _listed(names: Sequence[str]) -> str:
    few = names[:FEW_NAMES]
    if len(names) > FEW_NAMES:
        return f"{', '.join(few)} and {len(names) - FEW_NAMES} more"
    return few[0] if len(few) == 1 else f"{', '.join(few[:-1])} and {few[-1]}"


def warnings(groups: Sequence[Group], cells: Sequence[Cell], origin: Provenance) -> Iterator[str]:
    """Yield what makes numbers hard to compare."""
    few = [cell for cell in cells if cell.success.n < ENOUGH_SEEDS]
    if few:
        number = min(cell.success.n for cell in few)
        yield (
            f"Exploratory: {_of(len(few), len(cells), 'cell')} fewer than {ENOUGH_SEEDS} finished seeds "
            f"(the fewest: {number})."
        )
    yield from _mixed(groups, origin)
    yield from _notes(cells)
    for group in groups:
        if group.repeated:
            yield f"{quoted_label(group.label)}: {_runs(group.repeated)} left out, since another one has the same seed."
        if len(blank := group.done[group.done["success_rate"].isna()]):
            label = quoted_label(group.label)
            yield f"{label}: {_runs(len(blank))} finished without a final success rate, and left out."


def narrow_pairs(cells: Sequence[Cell], pairs: Sequence[Pair]) -> Iterator[str]:
    """Yield which differences have intervals that are known to be too narrow, beyond what was said of the cells."""
    labels, said = {cell.id: cell.label for cell in cells}, {cell.note for cell in cells}
    found: dict[str, list[str]] = {}
    for pair in pairs:
        if pair.note and pair.note not in said:
            found.setdefault(pair.note, []).append(
                f"{quoted_label(labels[pair.a])} against {quoted_label(labels[pair.b])}"
            )
    yield from _grouped(found)


def missing(cells: Sequence[Cell]) -> Iterator[str]:
    """Yield which runs have no result. Those that a search has pruned are over, and do not count."""
    total: Counter[str] = Counter()
    for cell in cells:
        total.update(cell.counts)
    waiting = {"running": "under way", "failed": "failed", "pending": "cut off or not begun"}
    found = [f"{total[stage]} {words}" for stage, words in waiting.items() if total[stage]]
    if found:
        everything = sum(total.values()) - total["pruned"]
        are = "is" if everything == 1 else "are"
        yield f"{total['done']} of {plural(everything, 'run')} {are} done: {', '.join(found)}."
    if empty := [cell.label for cell in cells if not cell.counts["done"]]:
        yield f"No run is done of {named(empty)}."


def same_runs(groups: Sequence[Group]) -> Iterator[str]:
    """Yield which cells of different experiments have the same config: what ends their names is a hash of it."""
    found: dict[str, list[str]] = {}
    for group in groups:
        found.setdefault(group.name, []).append(group.label)
    for labels in found.values():
        if len(labels) > 1:
            yield f"{named(labels)} have the same config: equal seeds are equal runs, and they are not independent."


def without_runs(experiments: Iterable[str], having: Iterable[str]) -> Iterator[str]:
    """Yield which experiments were asked for and have no runs."""
    there = set(having)
    for name in experiments:
        if name not in there:
            yield f"Experiment {name} has no runs."


def _mixed(groups: Sequence[Group], origin: Provenance) -> Iterator[str]:
    mixed = {package: list(found) for package, found in origin.versions.items() if len(found) > 1}
    for package, found in mixed.items():
        yield f"Versions are mixed: {package} {named(found)}."
    if len(origin.commits) > 1:
        yield f"Commits are mixed: {named(list(origin.commits))}."
    if any(commit.endswith("+") for commit in origin.commits):
        yield "Some runs were made from files that differ from their commit (marked +)."
    if len(origin.machines) > 1:
        yield f"Machines are mixed, so that CPU-seconds do not compare: {named(list(origin.machines))}."
    for key, words in (
        ("total_timesteps", "Budgets are mixed: cells were trained for {} env steps."),
        ("evaluation.final_n_scenes", "Scene sets are mixed: final models were evaluated on {} scenes."),
        ("evaluation.first_scene", "Scene sets are mixed: they begin at scenes {}."),
        ("evaluation.n_scenes", "Scene sets are mixed: evaluations during training were on {} scenes."),
        (
            "evaluation.every_n_steps",
            "Evaluations are mixed: every {} env steps, which changes times to 90 %.",
        ),
        ("env.name", "Tasks are mixed: cells belong to the envs {}; their rates are not of the same scenes."),
    ):
        values = list(dict.fromkeys(group.config.get(key) for group in groups))
        if len(values) > 1:
            yield words.format(named([f"{v:,}" if isinstance(v, int) else setting(v) for v in values]))
    seeds = {tuple(group.done["seed"]) for group in groups if len(group.done)}
    if len(seeds) > 1:
        yield "Cells do not have the same seeds."


def _notes(cells: Sequence[Cell]) -> Iterator[str]:
    notes: dict[str, list[str]] = {}
    for cell in cells:
        if cell.note:
            notes.setdefault(cell.note, []).append(quoted_label(cell.label))
    yield from _grouped(notes)


def _grouped(found: Mapping[str, Sequence[str]]) -> Iterator[str]:
    for note, names in found.items():
        yield f"{_listed(names)}: {note}"


def _of(k: int, n: int, what: str) -> str:
    if k == n:
        return f"the {what} has" if n == 1 else f"all {n} {what}s have"
    return f"{k} of {n} {what}s {'has' if k == 1 else 'have'}"


def _runs(number: int) -> str:
    return "a run was" if number == 1 else f"{number} runs were"


def together(*parts: Iterable[str]) -> list[str]:
    """Return all sentences, each once."""
    return list(dict.fromkeys(sentence for part in parts for sentence in part))
