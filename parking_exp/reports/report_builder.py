"""Build the content of a report from result frames."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import chain
from typing import NamedTuple

import pandas as pd

from parking_exp import __version__
from parking_exp.config.cell_labels import Factor, can_matter, differing_keys
from parking_exp.errors import RunNotFoundError, plural
from parking_exp.reports import cell_comparisons, findings, report_warnings
from parking_exp.reports.cell_selection import (
    CellRuns,
    choose,
    find_cell,
    find_contrasts,
    group,
    match_cells,
    relabel,
)
from parking_exp.reports.cell_summaries import RunEvaluations, summarise
from parking_exp.reports.report_data import Cell, Provenance, ReportData, UnfinishedRun
from parking_exp.results.frames import Results

MAX_PROBLEMS = 5
SHOWN_WHOLE, SHOWN = 16, 12  # cells in figures: all of up to 16, else 12
VERSION = "version."
SHORT_COMMIT = 10
REASONS = {"running": "under way", "interrupted": "interrupted or not begun; rerun the sweep"}


class Selection(NamedTuple):
    """The cells of a report, labelled by what distinguishes them."""

    cells: list[CellRuns]
    factors: list[Factor]
    baseline: str | None  # id of the cell
    contrasts: cell_comparisons.Contrasts
    warnings: list[str]  # of contrasts that are left out
    left_out: list[str]  # labels of the other cells


def build_report(
    results: Results,
    experiments: Sequence[str],
    *,
    cells: Sequence[str] = (),
    baseline: str | None = None,
    contrast: str | None = None,
    quick: bool = False,
    command: str = "",
) -> ReportData:
    """Return the content of a report.

    Args:
        results: of the experiments.
        experiments: their names.
        cells: labels, names, patterns and conditions, see `cell_selection.choose`; none: all.
        baseline: label of the cell that the others are compared with.
        contrast: `FACTOR:LEVEL-LEVEL`, of which matched cells are compared, see
            `cell_selection.match_cells`.
        quick: whether the curves of unfinished runs are included.
        command: the command line that makes the report.

    Raises:
        ConfigError: there is no such cell, baseline or contrast.
        RunNotFoundError: no run is done, and `quick` is not set.
    """
    selection = _select(results, experiments, cells, baseline, contrast, quick=quick)
    groups, factors = selection.cells, selection.factors
    evaluations = RunEvaluations.of(results)
    summaries = [summarise(cell, number, evaluations, quick) for number, cell in enumerate(groups)]
    shown = _choose_shown(summaries, [selection.baseline, *chain(*selection.contrasts.pairs)])
    effects = cell_comparisons.main_effects(summaries, factors)
    family = cell_comparisons.compare_pairs(summaries, selection.baseline, selection.contrasts)
    origin = _collect_provenance(groups, selection.left_out, results.uri)
    incomparable = report_warnings.find_incomparable(groups, summaries, origin)
    report = ReportData(
        title=" and ".join(experiments),
        experiments=list(experiments),
        made=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        quick=quick,
        command=command,
        factors=factors,
        cells=summaries,
        tasks=sorted({cell.task for cell in groups}),
        shown=shown,
        baseline=selection.baseline,
        family=family.sentence,
        pairs=family.pairs,
        effects=effects,
        claims=list(findings.describe(summaries, family, factors, effects)),
        warnings=list(
            dict.fromkeys([*selection.warnings, *incomparable, *results.problems[:MAX_PROBLEMS]])
        ),
        missing=list(
            report_warnings.find_missing(summaries, experiments, results.runs["experiment"])
        ),
        provenance=origin,
        reference=family.reference,
        declared=family.declared,
    )
    return replace(report, notes=list(_write_notes(report)))


def _select(
    results: Results,
    experiments: Sequence[str],
    wanted: Sequence[str],
    baseline: str | None,
    contrast: str | None,
    *,
    quick: bool,
) -> Selection:
    """Return the wanted cells, all without any, and the baseline; both must have a finished run
    unless `quick`.
    """
    cells = group(results.runs)
    selected = choose(cells, wanted) if wanted else cells
    reference = find_cell(cells, baseline, "baseline", preferred=selected) if baseline else None
    selected = selected if reference is None or reference in selected else [reference, *selected]
    if not quick:
        _refuse_unfinished(
            selected,
            f"experiment={','.join(experiments)}",
            "; report=quick shows what there is so far",
        )
        if reference is not None:
            _refuse_unfinished([reference], f"baseline={baseline}")
    labelled, factors = relabel(selected)
    ids: dict[int, str] = {}
    for number, (cell, own) in enumerate(zip(selected, labelled, strict=True)):
        ids[id(cell)] = ids[id(own)] = f"c{number}"
    if contrast is None:
        contrasts, unknown, warnings = find_contrasts(cells)
        words = "declared contrasts"
        source = "that the experiment declares as contrasts"
    else:
        contrasts, unknown, warnings = match_cells(labelled, factors, contrast), [], []
        words = "matched pairs"
        source = f"of cells that differ in one factor alone, {contrast}"
    usable = [
        (a, b) for a, b in contrasts if {id(a), id(b)} <= ids.keys() and len(a.done) and len(b.done)
    ]
    if untested := [
        *unknown,
        *(f"{a.label} minus {b.label}" for a, b in contrasts if (a, b) not in usable),
    ]:
        warnings.append(
            f"{len(untested)} of {len(unknown) + len(contrasts)} {words} lack a selected cell with "
            "finished "
            f"runs, and p is corrected for the others only: {report_warnings.list_names(untested)}."
        )
    return Selection(
        labelled,
        factors,
        baseline=None if reference is None else ids[id(reference)],
        contrasts=cell_comparisons.Contrasts([(ids[id(a)], ids[id(b)]) for a, b in usable], source),
        warnings=warnings,
        left_out=[cell.label for cell in cells if cell not in selected],
    )


def _refuse_unfinished(cells: Sequence[CellRuns], override: str, hint: str = "") -> None:
    if not any(len(cell.done) for cell in cells):
        runs = sum(len(cell.runs) for cell in cells)
        raise RunNotFoundError(f"{override}: of its {plural(runs, 'run')}, none is done{hint}")


def _choose_shown(cells: Sequence[Cell], always: Sequence[str | None]) -> list[str]:
    """Return the ids of the cells in figures, in the order of the report: all, or the best of many.

    Those in `always` come first, then controls, which lack one of the keys.
    """
    if len(cells) <= SHOWN_WHOLE:
        return [cell.id for cell in cells]
    kept = {cell.id for cell in cells if cell.id in always}
    ranked = sorted(
        cells,
        key=lambda cell: (
            cell.id not in kept,
            None not in cell.settings.values(),
            -(cell.success.value or -1.0),
        ),
    )
    best = {cell.id for cell in ranked[: max(SHOWN, len(kept))]}
    return [cell.id for cell in cells if cell.id in best]


def _write_notes(report: ReportData) -> Iterator[str]:
    """Yield notes on what figures and main effects leave out."""
    cells = report.cells
    if len(report.shown) < len(cells):
        yield (
            f"Figures show {len(report.shown)} of {len(cells)} cells: baseline, contrasts, "
            "controls, and the best; "
            "tables have all."
        )
    if len(report.drawn_pairs) < len(report.pairs):
        yield (
            f"No figure shows the {len(report.pairs)} pairs of cells; the table has them. "
            "baseline=CELL and "
            "contrast=FACTOR:LEVEL-LEVEL compare fewer; choose these before you see the results."
        )
    if (
        outside := [cell.label for cell in cells if None in cell.settings.values()]
        if report.effects
        else []
    ):
        yield (
            "Not part of the main effects, without a value of every factor: "
            f"{report_warnings.list_names(outside)}."
        )


def _collect_provenance(cells: Sequence[CellRuns], left_out: Sequence[str], uri: str) -> Provenance:
    """Return the provenance of the cells of a report; `left_out` are labels of the experiments'
    other cells.
    """
    runs = pd.concat([cell.runs for cell in cells])
    versions = {
        str(column).removeprefix(VERSION): _count_values(runs[column])
        for column in runs
        if str(column).startswith(VERSION)
    }
    marks = runs["git_dirty"].fillna(False).map({True: "+", False: ""})
    configs = [cell.config for cell in cells]
    difference = {key: [config.get(key) for config in configs] for key in differing_keys(configs)}
    started, ended = runs["started"].dropna(), runs["ended"].dropna()
    return Provenance(
        versions={package: counts for package, counts in versions.items() if counts},
        commits=_count_values(runs["git_commit"].str[:SHORT_COMMIT] + marks),
        machines=_count_values(runs["cpu"]),
        difference=difference,
        common={
            key: value
            for key, value in configs[0].items()
            if key not in difference and can_matter(key)
        },
        unfinished=[run for cell in cells for run in _list_unfinished(cell)],
        uri=uri,
        left_out=list(left_out),
        first=started.min().isoformat(timespec="seconds") if len(started) else None,
        last=ended.max().isoformat(timespec="seconds") if len(ended) else None,
    )


def _list_unfinished(cell: CellRuns) -> list[UnfinishedRun]:
    runs = cell.runs[cell.runs["status"] != "done"].astype(object)
    return [
        UnfinishedRun(
            cell.label,
            int(run["seed"]),
            str(run["status"]),
            run["error"] or REASONS.get(str(run["status"]), "no reason is known"),
            run["run_dir"],
        )
        for run in runs.where(runs.notna(), None).to_dict("records")
    ]


def _count_values(values: pd.Series) -> dict[str, int]:
    return {str(value): count for value, count in Counter(values.dropna()).most_common()}
