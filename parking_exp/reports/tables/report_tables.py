"""The tables of a report. Each function yields what it has; columns of rows are those of
`tables/*.csv`.
"""

from collections.abc import Iterator
from functools import partial

from parking_exp.reports import formats
from parking_exp.reports.cell_summaries import FURTHER, REPORTED
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.tables.table import (
    PERCENT,
    Column,
    Row,
    Table,
    cell_column,
    cell_record,
    column,
    interval_column,
    record,
    spread,
)
from parking_exp.statistics import Interval, Proportion

RATES = ("success", *(name for name in FURTHER if REPORTED[name].is_rate), "timeout")


def headline(report: ReportData) -> Iterator[Table]:
    """Yield the table of what each cell reached and what it cost."""
    yield Table(
        "headline",
        _list_cell_rows(report),
        [
            cell_column(),
            Column("Seeds", _count_finished, "seeds", given=True),
            column("Env steps", "total_timesteps", formats.number, given=True),
            *(
                interval_column(REPORTED[name].heading, name, paper=name != "timeout")
                for name in _select_rates(report)
            ),
            column("Lowest", "lowest", formats.percent, note="success of the worst seed"),
            column(
                "IQM",
                "iqm",
                formats.percent,
                note="interquartile mean of success over seeds",
                paper=False,
            ),
            Column(
                "Seeds ≥ 95 %",
                _count_reaching_95,
                "reaching_95_k",
                note=(
                    "how many seeds ended at 95 % or above, with the exact interval of their share"
                ),
                paper=False,
            ),
            column(
                "Steps to hold 90 %",
                "survival_median",
                formats.number,
                note="median of the env steps until 90 % were held for three evaluations",
            ),
            column(
                REPORTED["episode_steps"].heading,
                "episode_steps",
                partial(formats.number, digits=1),
                paper=False,
            ),
            column("CPU (s)", "cpu_s", formats.number),
            *(
                column(REPORTED[name].heading, name, partial(formats.number, digits=2), paper=False)
                for name in FURTHER
                if not REPORTED[name].is_rate
            ),
        ],
        f"Final evaluation: means over seeds, {PERCENT}.",
        latex=True,
    )


def times(report: ReportData) -> Iterator[Table]:
    """Yield the table of how long each cell took to hold 90 %, and of the area under its curve."""
    yield Table(
        "times",
        [row for row in _list_cell_rows(report) if "survival_n" in row],
        [
            cell_column(),
            Column("Reached", lambda row: f"{row['survival_k']}/{row['survival_n']}", "survival_k"),
            column("Median (steps)", "survival_median", formats.number),
            column("Median (CPU-s)", "median_cpu_s", formats.number),
            interval_column("AUC (%)", "area"),
        ],
        "Time until three evaluations in a row have 90 %, with medians where half of the seeds "
        "reached it; area under "
        f"the learning curve in % of the highest possible, means {PERCENT}.",
    )


def seeds(report: ReportData) -> Iterator[Table]:
    """Yield the table of the finished runs."""

    def reached(row: Row) -> str:
        steps = formats.number(row["steps_to_90"])
        return f"> {steps}" if steps and not row["reached_90"] else steps

    yield Table(
        "seeds",
        [
            {
                **cell_record(cell),
                **record(seed, without=("low", "high")),
                **spread("success", Interval(seed.success, seed.low, seed.high)),
            }
            for cell in report.cells
            for seed in cell.seeds
        ],
        [
            cell_column(),
            column("Seed", "seed"),
            interval_column(REPORTED["success"].heading, "success"),
            *(
                column(REPORTED[name].heading, name, formats.percent)
                for name in _select_rates(report)[1:]
            ),
            column("Episodes", "n_episodes", formats.number, given=True),
            Column("Steps to 90 %", reached, "steps_to_90"),
            column("CPU (s)", "cpu_s", formats.number),
            column("Run", "run_id", numeric=False),
        ],
        "Finished runs: final rates over the evaluation episodes, with Wilson's 95 % interval in "
        "brackets.",
        folded=True,
    )


def curves(report: ReportData) -> Iterator[Table]:
    """Yield the CSV of the learning curves."""
    names = ("step", "n", "success", "success_low", "success_high", "failure")
    rows = [
        {**cell_record(cell), **dict(zip(names, point, strict=True))}
        for cell in report.cells
        if (curve := cell.curve)
        for point in zip(
            curve.step, curve.n, curve.mean, curve.low, curve.high, curve.failure, strict=True
        )
    ]
    yield Table("curves", rows)


def survival(report: ReportData) -> Iterator[Table]:
    """Yield the CSV of Kaplan and Meier's estimate of the env steps to 90 %; `seeds` has which are
    censored.
    """
    rows = [
        {
            **cell_record(cell),
            **dict(zip(("step", "reached", "reached_low", "reached_high"), point, strict=True)),
        }
        for cell in report.cells
        if (curve := cell.survival)
        for point in zip(curve.times, curve.reached, curve.low, curve.high, strict=True)
    ]
    yield Table("survival", rows)


def pairs(report: ReportData) -> Iterator[Table]:
    """Yield the table of the pairs of cells that were compared."""
    labels = {cell.id: cell.label for cell in report.cells}
    rows = [
        {"a_label": labels[pair.a], "b_label": labels[pair.b], **record(pair)}
        for pair in report.pairs
    ]
    yield Table(
        "pairs",
        rows,
        [
            cell_column("A", "a", "a_label"),
            cell_column("B", "b", "b_label"),
            interval_column("A − B (points)", "difference", formats.difference_interval),  # noqa: RUF001
            column("p (Bonferroni)", "p_corrected", formats.probability),
            column(
                "p, ranks (Holm)",
                "rank_p_holm",
                formats.probability,
                note="Mann and Whitney's test of the ranks of seeds",
            ),
            column(
                "In words",
                "verdict",
                lambda verdict: formats.VERDICTS[verdict].table,
                numeric=False,
                paper=False,
            ),
        ],
        "Pairs of cells: difference of mean final success in percentage points, with simultaneous "
        "95 % intervals.",
        latex=True,
        folded=not report.drawn_pairs,
    )


def factors(report: ReportData) -> Iterator[Table]:
    """Yield the table of the difference that each factor makes."""
    names = {factor.key: factor.name for factor in report.factors}
    rows = []
    for effect in report.effects_by_size:
        high, low = effect.extremes
        rows.append(
            {
                **record(effect),
                "name": names[effect.factor],
                "highest": high.level,
                "lowest": low.level,
            }
        )
    yield Table(
        "factors",
        rows,
        [
            column("Factor", "name", numeric=False),
            column("Highest", "highest", formats.setting, numeric=False),
            column("Lowest", "lowest", formats.setting, numeric=False),
            interval_column("Highest − lowest (points)", "largest", formats.difference_interval),  # noqa: RUF001
            column("p (Bonferroni)", "p", formats.probability),
        ],
        "Factors: the levels with the highest and the lowest mean over the other factors, and "
        "their difference in "
        "percentage points, with 95 % intervals." + _warn_of_missing_combinations(report),
        latex=True,
    )


def effects(report: ReportData) -> Iterator[Table]:
    """Yield the table of each factor's levels."""
    yield Table(
        "effects",
        [
            {**record(effect), **record(level)}
            for effect in report.effects
            for level in effect.levels
        ],
        [
            column("Factor", "factor", numeric=False),
            column("Level", "level", formats.setting, numeric=False),
            interval_column("Success (%)", "effect"),
            column("Cells", "cells", formats.number),
        ],
        "Main effects: mean final success at each level over the levels of the other factors, "
        f"{PERCENT}." + _warn_of_missing_combinations(report),
        latex=True,
    )


def _warn_of_missing_combinations(report: ReportData) -> str:
    complete = all(effect.complete for effect in report.effects)
    return "" if complete else " Combinations are missing: levels are not comparable."


def config(report: ReportData) -> Iterator[Table]:
    """Yield the settings that differ between cells: a row for each cell or, if these are fewer, for
    each setting.
    """
    difference, cells = report.provenance.difference, report.cells
    if len(difference) > len(cells):
        names = {cell.id: cell.label for cell in cells}
        rows = [
            {"setting": key, **dict(zip(names, values, strict=True))}
            for key, values in difference.items()
        ]
        first = column("Setting", "setting", numeric=False)
    else:
        names = {key: key for key in difference}
        rows = [
            {**cell_record(cell), **dict(zip(names, values, strict=True))}
            for cell, *values in zip(cells, *difference.values(), strict=True)
            if difference
        ]
        first = cell_column()
    columns = [
        first,
        *(column(name, key, formats.setting, numeric=False) for key, name in names.items()),
    ]
    yield Table("config", rows, columns, "Settings that are not the same in all cells.", latex=True)


def versions(report: ReportData) -> Iterator[Table]:
    """Yield the table of versions, commits and machines."""
    origin = report.provenance
    counted = {**origin.versions, "commit": origin.commits, "machine": origin.machines}
    rows = [
        {"what": what, "version": name, "runs": n}
        for what, counts in counted.items()
        for name, n in counts.items()
    ]
    columns = [
        column("What", "what", numeric=False),
        column("Version", "version", numeric=False),
        column("Runs", "runs", formats.number, given=True),
    ]
    yield Table("versions", rows, columns, "Versions, commits and machines.")


def unfinished(report: ReportData) -> Iterator[Table]:
    """Yield the table of the runs without a result, and why."""
    columns = [
        column("Cell", "label", numeric=False),
        column("Seed", "seed"),
        column("Status", "status", numeric=False),
        column("Reason", "reason", numeric=False),
    ]
    rows = [record(run) for run in report.provenance.unfinished]
    yield Table("unfinished", rows, columns, "Runs without a result, and why.")


def common(report: ReportData) -> Iterator[Table]:
    """Yield the table of the settings that are the same in all cells."""
    rows = [{"key": key, "value": value} for key, value in report.provenance.common.items()]
    columns = [
        column("Setting", "key", numeric=False),
        column("Value", "value", formats.setting, numeric=False),
    ]
    yield Table("common", rows, columns, "Settings that are the same in all cells.", folded=True)


def _list_cell_rows(report: ReportData) -> list[Row]:
    stages = dict.fromkeys(stage for cell in report.cells for stage in cell.counts)
    return [
        {
            **cell_record(cell),
            "seeds": cell.success.n,  # a run that is done may lack its rate
            **{f"runs_{stage}": cell.counts.get(stage) for stage in stages},
            **record(cell, without=("id", "label")),
        }
        for cell in report.cells
    ]


def _select_rates(report: ReportData) -> list[str]:
    """Return the names of the rates that some cell has."""
    return [
        name
        for name in RATES
        if name not in FURTHER or any(name in cell.further for cell in report.cells)
    ]


def _count_finished(row: Row) -> str:
    done, total = (
        row["seeds"],
        sum(count or 0 for key, count in row.items() if key.startswith("runs_")),
    )
    return str(done) if done == total else f"{done} of {total}"


def _count_reaching_95(row: Row) -> str:
    return formats.share_interval(
        Proportion(*(row[f"reaching_95_{name}"] for name in ("k", "n", "low", "high")))
    )
