"""Build the content of a report from result frames."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import chain
from typing import NamedTuple

from parking_exp import __version__
from parking_exp.config.cell_labels import Factor
from parking_exp.errors import RunNotFoundError
from parking_exp.phrases import list_names, plural
from parking_exp.reports import cell_selection, report_warnings
from parking_exp.reports.cell_comparisons import choose_family, compare_levels, compare_pairs
from parking_exp.reports.cell_selection import CellRuns
from parking_exp.reports.cell_summaries import split_by_run, summarise_cell
from parking_exp.reports.findings import describe_findings
from parking_exp.reports.provenance import collect_provenance
from parking_exp.reports.report_data import CellSummary, ReportData
from parking_exp.reports.run_checks import find_contradictions, leave_out_impossible_rates
from parking_exp.results.frames import Results

MAX_PROBLEMS = 5
SHOWN_WHOLE = 16  # figures show all cells up to this number
SHOWN = 12  # and else this many of the best


class Selection(NamedTuple):
    """The cells of a report, labelled by what distinguishes them."""

    cells: list[CellRuns]
    factors: list[Factor]
    baseline: str | None  # id of the cell
    contrasts: list[tuple[str, str]]  # ids of the cells
    warnings: list[str]  # which contrasts are left out


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
        results: the results of the experiments.
        experiments: their names.
        cells: labels, names, patterns and conditions, see `cell_selection.choose_cells`. By
            default, all cells are selected.
        baseline: label of the cell that the others are compared with.
        contrast: `FACTOR:LEVEL-LEVEL`, of which matched cells are compared, see
            `cell_selection.match_cells`.
        quick: whether the curves of unfinished runs are included.
        command: the command line that makes the report.

    Raises:
        ConfigError: there is no such cell, baseline or contrast.
        RunNotFoundError: no run is done, and `quick` is not set.
    """
    results = leave_out_impossible_rates(results)
    all_cells = cell_selection.group_runs(results.runs)
    selection = _select(all_cells, cells, baseline, contrast)
    evaluations = split_by_run(results)
    summaries = [summarise_cell(cell, evaluations, unfinished=quick) for cell in selection.cells]
    if not quick:
        hint = "; report=quick shows what there is so far"
        _refuse_unfinished(summaries, f"experiment={','.join(experiments)}", hint)
        if selection.baseline is not None:
            reference = [cell for cell in summaries if cell.id == selection.baseline]
            _refuse_unfinished(reference, f"baseline={baseline}")

    family = choose_family(summaries, selection.baseline, selection.contrasts)
    selected = {cell.identity for cell in selection.cells}
    left_out = [cell.label for cell in all_cells if cell.identity not in selected]
    report = ReportData(
        title=" and ".join(experiments),
        experiments=list(experiments),
        made=datetime.now(UTC).isoformat(timespec="seconds"),
        version=__version__,
        quick=quick,
        command=command,
        factors=selection.factors,
        cells=summaries,
        tasks=sorted({cell.task for cell in selection.cells}),
        shown=_choose_shown(summaries, selection),
        baseline=selection.baseline,
        family=family.sentence,
        pairs=compare_pairs(family.cell_pairs),
        effects=compare_levels(summaries, selection.factors),
        provenance=collect_provenance(selection.cells, left_out, results.uri),
        reference=family.reference,
        declared=family.declared,
    )
    warnings = [
        *selection.warnings,
        *report_warnings.find_caveats(report),
        *find_contradictions(selection.cells, evaluations),
        *results.problems[:MAX_PROBLEMS],
    ]
    n_unnamed = len(results.problems) - MAX_PROBLEMS
    if n_unnamed > 0:
        warnings.append(f"Problems of stored results that are not named here: {n_unnamed}.")
    return replace(
        report,
        claims=list(describe_findings(report)),
        warnings=list(dict.fromkeys(warnings)),
        missing=list(report_warnings.find_missing(report)),
        notes=list(_write_notes(report)),
    )


def _select(
    cells: Sequence[CellRuns], wanted: Sequence[str], baseline: str | None, contrast: str | None
) -> Selection:
    """Return the wanted cells, or all if none are wanted, with the baseline and the contrasts."""
    selected = cell_selection.choose_cells(cells, wanted)
    reference = None
    if baseline:
        reference = cell_selection.find_cell(cells, baseline, "baseline", preferred=selected)
        if reference not in selected:
            selected = [reference, *selected]

    labelled, factors = cell_selection.relabel(selected)
    if contrast is None:
        pairs, unknown, warnings = cell_selection.find_contrasts(cells)
    else:
        pairs = cell_selection.match_cells(labelled, factors, contrast)
        unknown = []
        warnings = []
    contrasts, unfinished = _split_contrasts(pairs, labelled)
    untested = unknown + unfinished
    if untested:
        warnings.append(_warn_of_untested(untested, len(contrasts)))
    baseline_id = labelled[selected.index(reference)].id if reference else None
    return Selection(labelled, factors, baseline_id, contrasts, warnings)


def _split_contrasts(
    pairs: Sequence[tuple[CellRuns, CellRuns]], selected: Sequence[CellRuns]
) -> tuple[list[tuple[str, str]], list[str]]:
    """Return the pairs of selected cells with finished runs, by their ids; and names of others."""
    finished = {cell.identity: cell.id for cell in selected if len(cell.done)}
    contrasts = []
    others = []
    for first, second in pairs:
        if first.identity in finished and second.identity in finished:
            contrasts.append((finished[first.identity], finished[second.identity]))
        else:
            others.append(f"{first.label} minus {second.label}")
    return contrasts, others


def _warn_of_untested(untested: Sequence[str], n_tested: int) -> str:
    text = (
        f"{len(untested)} of {n_tested + len(untested)} contrasts are not tested, since one of "
        f"their cells is not selected or has no finished run: {list_names(untested)}."
    )
    if n_tested:
        text += " p is corrected for the other contrasts only."
    return text


def _refuse_unfinished(cells: Sequence[CellSummary], override: str, hint: str = "") -> None:
    if not any(cell.counts["done"] for cell in cells):
        n_runs = sum(sum(cell.counts.values()) for cell in cells)
        raise RunNotFoundError(f"{override}: of its {plural(n_runs, 'run')}, none is done{hint}")


def _choose_shown(cells: Sequence[CellSummary], selection: Selection) -> list[str]:
    """Return the ids of the cells in figures, in the order of the report: all, or the best of many.

    Of many, the baseline, cells of contrasts, and controls, which lack one of the keys, are shown,
    too.
    """
    if len(cells) <= SHOWN_WHOLE:
        return [cell.id for cell in cells]
    best = sorted(cells, key=lambda cell: cell.success.value or 0.0, reverse=True)[:SHOWN]
    shown = {selection.baseline, *chain(*selection.contrasts)}
    shown |= {cell.id for cell in best}
    shown |= {cell.id for cell in cells if None in cell.settings.values()}
    return [cell.id for cell in cells if cell.id in shown]


def _write_notes(report: ReportData) -> Iterator[str]:
    """Yield notes on what figures and main effects leave out."""
    cells = report.cells
    if len(report.shown) < len(cells):
        yield (
            f"Figures show {len(report.shown)} of {len(cells)} cells: baseline, contrasts, "
            "controls, and the best; tables have all."
        )
    if len(report.drawn_pairs) < len(report.pairs):
        yield (
            f"No figure shows the {len(report.pairs)} pairs of cells; the table has them. "
            "baseline=CELL and contrast=FACTOR:LEVEL-LEVEL compare fewer; choose these before you "
            "see the results."
        )
    outside = [cell.label for cell in cells if None in cell.settings.values()]
    if report.effects and outside:
        yield (
            "Left out of the main effects, since they lack a value of some factor: "
            f"{list_names(outside)}."
        )
