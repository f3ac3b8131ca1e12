"""Build the content of a report from result frames."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime

from parking_exp import __version__
from parking_exp.envs.geometry import N_SLOTS
from parking_exp.errors import RunNotFoundError, plural
from parking_exp.reports import factor_effects, findings, warnings
from parking_exp.reports.cell_pairs import compare_pairs
from parking_exp.reports.cell_selection import CellRuns, choose, group, one_cell, relabelled
from parking_exp.reports.cell_summaries import real_share, shared_horizons, summarise
from parking_exp.reports.lot_map import sample
from parking_exp.reports.report_data import Cell, ReportData
from parking_exp.reports.report_provenance import provenance
from parking_exp.reports.run_evaluations import RunEvaluations
from parking_exp.results.frames import Results

MOST_PROBLEMS = 5
SHOWN_WHOLE, SHOWN = 16, 12  # cells in figures: all of up to 16, else the 12 best


def build_report(
    results: Results,
    experiments: Sequence[str],
    *,
    cells: Sequence[str] = (),
    baseline: str | None = None,
    quick: bool = False,
    command: str = "",
) -> ReportData:
    """Return everything that a report says.

    Args:
        results: of the experiments.
        experiments: their names.
        cells: labels, names, patterns and conditions, see `cell_selection.choose`; none: all.
        baseline: label of the cell that the others are compared with.
        quick: whether unfinished runs count, as far as they are.
        command: the command line that makes the report.

    Raises:
        ConfigError: there is no such cell or baseline.
        RunNotFoundError: none of the runs is done, and `quick` is not asked for.
    """
    all_cells = group(results.runs)
    asked = choose(all_cells, cells) if cells else all_cells
    reference = one_cell(all_cells, baseline, preferred=asked) if baseline else None
    asked = asked if reference is None or reference in asked else [reference, *asked]
    if not quick:
        _refuse_unfinished(asked, f"experiment={','.join(experiments)}", "; report=quick shows what there is so far")
        if reference is not None:
            _refuse_unfinished([reference], f"baseline={baseline}")
    kept = [cell for cell in asked if cell is reference or set(cell.runs["status"]) != {"pruned"}] or asked
    groups, factors = relabelled(kept)
    base = None if reference is None else f"c{kept.index(reference)}"
    left_out = [cell.label for cell in all_cells if cell not in asked]

    evaluations = RunEvaluations.of(results)
    horizons = shared_horizons(groups, evaluations)
    summaries = [summarise(cell, number, evaluations, horizons, quick) for number, cell in enumerate(groups)]
    shown = _shown(summaries, base)
    problems = [*results.problems]
    for number, cell in enumerate(summaries):
        if cell.id in shown:
            summaries[number] = _with_lot_map(cell, groups[number], results, evaluations, problems)
    design = factor_effects.design(factors, [cell.settings for cell in groups])
    effects, interactions, importance = [], [], []
    if design == "search":
        importance = factor_effects.importance(summaries, factors)
    elif design == "factorial":
        shares = {cell.id: real_share(runs, evaluations) for cell, runs in zip(summaries, groups, strict=True)}
        effects = factor_effects.main_effects(summaries, factors)
        interactions = factor_effects.interactions(summaries, factors, shares)
    family = compare_pairs(summaries, base)
    origin = provenance(groups, left_out, results.uri)
    return ReportData(
        title=" and ".join(experiments),
        experiments=list(experiments),
        made=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        quick=quick,
        command=command,
        design=design,
        factors=factors,
        cells=summaries,
        shown=shown,
        baseline=base,
        family=family.sentence,
        pairs=family.pairs,
        effects=effects,
        interactions=interactions,
        importance=importance,
        exploratory=any(cell.success.n < warnings.ENOUGH_SEEDS for cell in summaries),
        claims=_once(
            findings.claims(summaries, family),
            findings.about_factors(design, factors, effects, interactions, importance),
        ),
        warnings=_once(warnings.warnings(groups, summaries, family.pairs, origin), _first(problems)),
        missing=_once(warnings.missing(summaries, experiments, results.runs["experiment"])),
        provenance=origin,
        notes=[
            *_notes_on_cells(summaries, shown, bool(effects)),
            *_notes_on_others(len(left_out), len(asked) - len(kept), results.ignored),
        ],
        reference=family.reference,
    )


def _refuse_unfinished(cells: Sequence[CellRuns], asked: str, hint: str = "") -> None:
    if not any(len(cell.done) for cell in cells):
        runs = sum(len(cell.runs) for cell in cells)
        raise RunNotFoundError(f"{asked}: of its {plural(runs, 'run')}, none is done{hint}")


def _with_lot_map(
    cell: Cell, runs: CellRuns, results: Results, evaluations: RunEvaluations, problems: list[str]
) -> Cell:
    """Return a cell with trajectories; what is wrong with recordings is appended to `problems`."""
    vehicles = runs.config.get("env.vehicles_count")
    parked = vehicles if type(vehicles) is int and 0 < vehicles < N_SLOTS else 0
    finished = [(seed.seed, seed.run_id) for seed in cell.seeds]
    paths, failures, unreadable = sample(finished, results, evaluations.final, parked)
    problems += unreadable
    return replace(cell, paths=paths, failures=failures)


def _shown(cells: Sequence[Cell], baseline: str | None) -> list[str]:
    """Return the ids of the cells in figures, in the order of the report."""
    if len(cells) <= SHOWN_WHOLE:
        return [cell.id for cell in cells]
    ranked = sorted(cells, key=lambda cell: (cell.id != baseline, -(cell.success.value or -1.0)))
    best = {cell.id for cell in ranked[:SHOWN]}
    return [cell.id for cell in cells if cell.id in best]


def _once(*parts: Iterable[str]) -> list[str]:
    """Return all sentences, each once."""
    return list(dict.fromkeys(sentence for part in parts for sentence in part))


def _first(problems: Sequence[str]) -> list[str]:
    """Return problems with single runs, the first of many."""
    more = len(problems) - MOST_PROBLEMS
    rest = [f"Runs with such problems besides: {more}."] if more > 0 else []
    return [*problems[:MOST_PROBLEMS], *rest]


def _notes_on_cells(cells: Sequence[Cell], shown: Sequence[str], crossed: bool) -> Iterator[str]:
    if len(shown) < len(cells):
        best = f"the {len(shown)} with the highest success"
        yield f"Pictures show {best} of {len(cells)} cells; tables have all."
    if any(cell.seeds and not cell.paths for cell in cells if cell.id in shown):
        yield (
            "Some cells have no trajectories to be drawn: their runs are older than these, or lost them, or the export "
            "has only those of the cells that its own report drew."
        )
    if outside := [cell.label for cell in cells if None in cell.settings.values()] if crossed else []:
        yield f"Not part of the main effects, without a value of every factor: {warnings.named(outside)}."


def _notes_on_others(left_out: int, pruned: int, ignored: int) -> Iterator[str]:
    """Yield notes on what the report leaves out: cells not asked for, pruned trials, runs of other packages."""
    if left_out:
        were = "was" if left_out == 1 else "were"
        yield (
            f"By what was asked for, {plural(left_out, 'more cell')} of the experiments {were} left out; "
            "fewer pairs make smaller p."
        )
    if pruned:
        were, are = ("was", "it is") if pruned == 1 else ("were", "they are")
        trials = plural(pruned, "trial")
        yield f"{trials} of the search {were} pruned before a run was done; {are} not among the cells."
    if ignored:
        others = plural(ignored, "more run")
        yield f"The store has {others} that this package did not make, and that the report leaves out."
