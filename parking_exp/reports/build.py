"""Compute the data of a report from result frames."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import pandas as pd

from parking_exp import __version__
from parking_exp.envs.geometry import N_SLOTS
from parking_exp.errors import RunNotFoundError, plural
from parking_exp.reports import findings, warnings
from parking_exp.reports.comparisons import Family, compare_pairs
from parking_exp.reports.curves import RunEvaluations
from parking_exp.reports.effects import importance, interactions, main_effects
from parking_exp.reports.factors import design
from parking_exp.reports.lot_map import sample
from parking_exp.reports.provenance import provenance
from parking_exp.reports.report_data import (
    Cell,
    Design,
    Factor,
    Importance,
    Interaction,
    MainEffect,
    Provenance,
    ReportData,
)
from parking_exp.reports.selection import Group, choose, group, one_cell, relabelled
from parking_exp.reports.summaries import real_share, shared_horizons, summarise
from parking_exp.results.frames import Results

MOST_PROBLEMS = 5
SHOWN_WHOLE, SHOWN = 16, 12  # cells in pictures: all of up to 16, else the 12 best


@dataclass(frozen=True)
class Question:
    """What is asked of the results.

    Attributes:
        experiments: their names.
        cells: labels, names, patterns and conditions, see `selection.choose`; none: all.
        baseline: of one cell that the others are compared with.
        quick: whether unfinished runs count, as far as they are.
        command: how it was typed.
    """

    experiments: Sequence[str]
    cells: Sequence[str] = ()
    baseline: str | None = None
    quick: bool = False
    command: str = ""


def build(results: Results, question: Question, unsynced: Sequence[str] = ()) -> ReportData:
    """Return everything that a report says.

    Args:
        results: of the experiments.
        question: which of them.
        unsynced: a sentence for each thing that kept the store from being brought up to date.

    Raises:
        ConfigError: a cell or baseline that there is not.
        RunNotFoundError: none of the runs is done, and `quick` is not asked for.
    """
    chosen = _choose(results.runs, question)
    groups, factors, baseline = chosen.groups, chosen.factors, chosen.baseline
    evaluations = RunEvaluations.of(results)
    horizons = shared_horizons(groups, evaluations)
    cells = [summarise(one, number, evaluations, horizons, question.quick) for number, one in enumerate(groups)]
    shown = _shown(cells, baseline)
    cells, problems = _with_lot_maps(cells, shown, groups, results, evaluations)
    kind = design(factors, [one.settings for one in groups])
    parts = _factor_parts(kind, cells, groups, factors, evaluations)
    family = compare_pairs(cells, baseline)
    origin = provenance(groups, chosen.left_out, results.uri)
    return ReportData(
        title=" and ".join(question.experiments),
        experiments=list(question.experiments),
        made=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        quick=question.quick,
        command=question.command,
        design=kind,
        factors=factors,
        cells=cells,
        shown=shown,
        baseline=baseline,
        family=family.words,
        pairs=family.pairs,
        effects=parts.effects,
        interactions=parts.interactions,
        importance=parts.importance,
        exploratory=any(cell.success.n < warnings.ENOUGH_SEEDS for cell in cells),
        claims=warnings.together(
            findings.claims(cells, family),
            findings.about_factors(kind, factors, parts.effects, parts.interactions, parts.importance),
        ),
        warnings=_warnings(groups, cells, origin, family, [*unsynced, *results.problems, *problems]),
        missing=warnings.together(
            warnings.missing(cells), warnings.without_runs(question.experiments, results.runs["experiment"])
        ),
        provenance=origin,
        notes=_notes(results, chosen, cells, shown, crossed=bool(parts.effects)),
        reference=family.reference,
    )


@dataclass(frozen=True)
class _Chosen:
    """The cells of a report.

    Attributes:
        groups, factors: the cells, and what sets them apart.
        baseline: id of one of them.
        left_out: labels of cells that were not asked for.
        pruned: how many cells are left out since a search has pruned all of their runs.
    """

    groups: list[Group]
    factors: list[Factor]
    baseline: str | None
    left_out: list[str]
    pruned: int


def _choose(runs: pd.DataFrame, question: Question) -> _Chosen:
    everything, _ = group(runs)
    asked = choose(everything, question.cells) if question.cells else everything
    reference = one_cell(everything, question.baseline, preferred=asked) if question.baseline else None
    if reference is not None and not any(one is reference for one in asked):
        asked = [reference, *asked]
    if not question.quick:
        _refuse_nothing_done(asked, question)
        if reference is not None and not len(reference.done):
            raise RunNotFoundError(
                f"baseline={question.baseline}: of its {plural(len(reference.runs), 'run')}, none is done"
            )
    left_out = [one.label for one in everything if not any(one is chosen for chosen in asked)]
    kept = [one for one in asked if one is reference or set(one.runs["status"]) != {"pruned"}] or asked
    pruned = len(asked) - len(kept)
    asked = kept
    groups, factors = relabelled(asked)
    place = next((number for number, one in enumerate(asked) if one is reference), None)
    return _Chosen(groups, factors, None if place is None else f"c{place}", left_out, pruned)


@dataclass(frozen=True)
class _FactorParts:
    effects: Sequence[MainEffect] = ()
    interactions: Sequence[Interaction] = ()
    importance: Sequence[Importance] = ()


def _factor_parts(
    kind: Design, cells: Sequence[Cell], groups: Sequence[Group], factors: Sequence[Factor], evaluations: RunEvaluations
) -> _FactorParts:
    if kind == "search":
        return _FactorParts(importance=importance(cells, factors))
    if kind != "factorial":
        return _FactorParts()
    shares = {cell.id: real_share(one, evaluations) for cell, one in zip(cells, groups, strict=True)}
    return _FactorParts(main_effects(cells, factors), interactions(cells, factors, shares))


def _with_lot_maps(
    cells: Sequence[Cell], shown: Sequence[str], groups: Sequence[Group], results: Results, evaluations: RunEvaluations
) -> tuple[list[Cell], list[str]]:
    """Return the cells, those that are shown with trajectories, and what is wrong with some recordings."""
    found, problems = [], []
    for cell, one in zip(cells, groups, strict=True):
        if cell.id not in shown:
            found.append(cell)
            continue
        runs = [(seed.seed, seed.run_id) for seed in cell.seeds]
        vehicles = one.config.get("env.vehicles_count")
        parked = vehicles if type(vehicles) is int and 0 < vehicles < N_SLOTS else 0
        lot_map = sample(runs, results, evaluations.final, parked)
        found.append(replace(cell, paths=lot_map.paths, failures=lot_map.failures))
        problems += lot_map.problems
    return found, problems


def _shown(cells: Sequence[Cell], baseline: str | None) -> list[str]:
    """Return the cells that pictures show, in the order of the report."""
    if len(cells) <= SHOWN_WHOLE:
        return [cell.id for cell in cells]
    ranked = sorted(cells, key=lambda cell: (cell.id != baseline, -(cell.success.value or -1.0)))
    best = {cell.id for cell in ranked[:SHOWN]}
    return [cell.id for cell in cells if cell.id in best]


def _refuse_nothing_done(groups: Sequence[Group], question: Question) -> None:
    if any(len(one.done) for one in groups):
        return
    runs = sum(len(one.runs) for one in groups)
    raise RunNotFoundError(
        f"experiment={','.join(question.experiments)}: of its {plural(runs, 'run')}, none is done; "
        "report=quick shows what there is so far"
    )


def _warnings(
    groups: Sequence[Group], cells: Sequence[Cell], origin: Provenance, family: Family, problems: Sequence[str]
) -> list[str]:
    return warnings.together(
        warnings.warnings(groups, cells, origin),
        warnings.same_runs(groups),
        warnings.narrow_pairs(cells, family.pairs),
        _few(problems),
    )


def _few(problems: Sequence[str]) -> list[str]:
    """Return problems with single runs, the first of many."""
    more = len(problems) - MOST_PROBLEMS
    rest = [f"Runs with such problems besides: {more}."] if more > 0 else []
    return [*problems[:MOST_PROBLEMS], *rest]


def _notes(
    results: Results, chosen: _Chosen, cells: Sequence[Cell], shown: Sequence[str], *, crossed: bool
) -> list[str]:
    notes = []
    if len(shown) < len(cells):
        best = f"the {len(shown)} with the highest success"
        notes.append(f"Pictures show {best} of {len(cells)} cells; tables have all.")
    if chosen.left_out:
        notes.append(
            f"By what was asked for, {plural(len(chosen.left_out), 'more cell')} of the experiments "
            f"{'was' if len(chosen.left_out) == 1 else 'were'} left out; fewer pairs make smaller p."
        )
    if chosen.pruned:
        were, are = ("was", "it is") if chosen.pruned == 1 else ("were", "they are")
        trials = plural(chosen.pruned, "trial")
        notes.append(f"{trials} of the search {were} pruned before a run was done; {are} not among the cells.")
    if any(cell.seeds and not cell.paths for cell in cells if cell.id in shown):
        notes.append(
            "Some cells have no trajectories to be drawn: their runs are older than these, or lost them, or the export "
            "has only those of the cells that its own report drew."
        )
    if outside := [cell.label for cell in cells if None in cell.settings.values()] if crossed else []:
        notes.append(f"Not part of the main effects, without a value of every factor: {warnings.named(outside)}.")
    if results.ignored:
        others = plural(results.ignored, "more run")
        notes.append(f"The store has {others} that this package did not make, and that the report leaves out.")
    return notes
