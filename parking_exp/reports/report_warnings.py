"""The warnings of a report, in sentences: few seeds, mixed conditions, missing runs."""

from collections.abc import Iterable, Iterator

from parking_exp.config.settings import Setting, display_setting
from parking_exp.phrases import list_names, plural, quoted_label
from parking_exp.reports.report_data import ReportData
from parking_exp.runs.run_state import describe_unfinished
from parking_exp.tasks.registry import TRAINING_ONLY

ENOUGH_SEEDS = 10
COMPARABLE = {
    "evaluation.first_scene",
    "evaluation.n_scenes",
    "evaluation.every_n_steps",
}
"""Config keys that should be the same in all cells."""


def find_caveats(report: ReportData) -> Iterator[str]:
    """Yield what limits the numbers: few seeds, mixed conditions, runs that are left out."""
    cells = report.cells
    few = [cell.success.n for cell in cells if cell.success.n < ENOUGH_SEEDS]
    if few:
        yield (
            f"Exploratory: fewer than {ENOUGH_SEEDS} finished seeds in {len(few)} of "
            f"{plural(len(cells), 'cell')} (the fewest: {min(few)}). Their intervals are "
            "compatibility intervals."
        )
    yield from _find_mixed(report)
    for cell in cells:
        label = quoted_label(cell.label)
        n_blank = sum(seed.success is None for seed in cell.seeds)
        if n_blank:
            yield f"{label}: {plural(n_blank, 'run')} left out: no final success rate."


def find_missing(report: ReportData) -> Iterator[str]:
    """Yield which runs have no result."""
    runs = report.stages
    unfinished = describe_unfinished(runs)
    if unfinished:
        yield f"Runs done: {runs['done']} of {runs.total()}; {', '.join(unfinished)}."
    empty = [cell.label for cell in report.cells if not cell.counts["done"]]
    if empty:
        yield f"No run is done of {list_names(empty)}."


def _find_mixed(report: ReportData) -> Iterator[str]:
    provenance = report.provenance
    n_episodes = []
    seeds = set()
    for cell in report.cells:
        n_episodes += [seed.n_episodes for seed in cell.seeds if seed.n_episodes]
        if cell.seeds:
            seeds.add(tuple(seed.seed for seed in cell.seeds))
    conditions: dict[str, Iterable[Setting]] = {
        **provenance.versions,
        "commits": provenance.commits,
        "machines, whose CPU-seconds cannot be compared": provenance.machines,
        "final episodes": n_episodes,
    }
    for key, values in provenance.difference.items():
        if key in COMPARABLE:
            conditions[key] = values
    budgets = [cell.total_timesteps for cell in report.cells]
    conditions["total_timesteps"] = [steps for steps in budgets if steps]  # 0: it is not trained
    for condition, seen in conditions.items():
        names = [display_setting(value) for value in dict.fromkeys(seen)]
        if len(names) > 1:
            yield f"Mixed {condition}: {list_names(names)}."
    if any(commit.endswith("+") for commit in provenance.commits):
        yield "Some runs were made from files that differ from their commit (marked +)."
    env_keys = [key for key in provenance.difference if key.startswith("env.")]
    mixed = [key for key in env_keys if key not in TRAINING_ONLY]
    if mixed:
        yield f"Mixed tasks, whose rates are not of the same episodes: {list_names(mixed)} differ."
    if len(seeds) > 1:
        yield "Cells do not have the same seeds."
