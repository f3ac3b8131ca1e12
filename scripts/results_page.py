#!/usr/bin/env python
"""Write docs/results.md, docs/full_tables.md, docs/provenance.md, their figures and the marked
parts of README from docs/results; `--check` only compares.
"""

import re
import shutil
import sys
import textwrap
from argparse import ArgumentParser
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, StrictUndefined

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from parking_exp.reports import formats
from parking_exp.reports.cell_comparisons import seed_rates
from parking_exp.reports.report_builder import build_report
from parking_exp.reports.report_data import CellSummary, Pair, ReportData
from parking_exp.results import Results, read_export
from parking_exp.terminal import say

DOCS = ROOT / "docs"
EXPORTS, PAGE, README = DOCS / "results", DOCS / "results.md", ROOT / "README.md"
FULL_TABLES, PROVENANCE = DOCS / "full_tables.md", DOCS / "provenance.md"
# The others have final_success.
FIGURES = dict.fromkeys(("algorithms", "goal_tasks", "tutorial"), "learning_curves")
FIGURE_CELLS = {  # the cells that a figure shows; the others show all
    "goal_tasks": ("env=point_maze",),
    "her_relabelling": ("her_future*", "algorithm.features=ego_mirrored"),
}
PACKAGES = (
    "highway-env",
    "stable-baselines3",
    "sb3-contrib",
    "gymnasium-robotics",
    "mujoco",
    "torch",
    "python",
)
LINK, NO_BREAK = re.compile(r"\[[^\]]*\]\([^)]*\)"), "\0"
MARKED = re.compile(r"(<!-- results: (?P<name>\w+) -->\n).*?(<!-- end of results -->)", re.DOTALL)
COLUMNS = {
    "success": ("success, %", lambda cell: formats.percent_interval(cell.success)),
    "crash": ("crash, % (range)", lambda cell: _range(cell, "crash")),
    "parked": ("parked, %", lambda cell: formats.percent_interval(cell.metric("parked"))),
    "lowest": ("lowest", lambda cell: formats.percent(cell.lowest)),
    "iqm": ("IQM", lambda cell: formats.percent(cell.iqm)),
    "at_95": ("seeds ≥ 95 %", lambda cell: f"{cell.reaching_95}/{cell.success.n}"),
    "area": ("AUC, %", lambda cell: formats.percent_interval(cell.area)),
    "to_90": (
        "steps to 90 %",
        lambda cell: (
            formats.number(cell.survival.median) or f"{cell.survival.k} of {cell.survival.n} seeds"
        ),
    ),
    "cpu_s": ("CPU-s", lambda cell: formats.number(cell.cpu_s.value)),
}


@dataclass(frozen=True)
class Experiment:
    """The results of an experiment as the templates format them. Cells are named by their labels.

    Attributes:
        results: data frames of the export.
        report: the report on them.
    """

    results: Results
    report: ReportData

    def only(self, *cells: str, baseline: str | None = None) -> "Experiment":
        """Return the experiment with some of its cells, selected as by `scripts/report.py`."""
        return Experiment(
            self.results,
            build_report(self.results, self.report.experiments, cells=cells, baseline=baseline),
        )

    def cell(self, label: str) -> CellSummary:
        """Return the cell with a label."""
        return next(cell for cell in self.report.cells if cell.label == label)

    def rate(self, label: str, metric: str = "success") -> str:
        """Return the mean rate of a cell with its interval, e.g. `94.4 % [91.2, 97.1]`."""
        return formats.rate_interval(self.cell(label).metric(metric))

    def seeds(self, label: str, metric: str = "success") -> str:
        """Return the mean rate of a cell with its lowest and highest seed, e.g. `94.4 % (90.1 to
        100.0 %)`.
        """
        cell = self.cell(label)
        rates = [seed.metric(metric) or 0.0 for seed in cell.seeds]
        low, high = formats.percent(min(rates)), formats.percent(max(rates))
        return f"{formats.rate_text(cell.metric(metric).value)} ({low} to {high} %)"

    def cpu_s(self, label: str) -> str:
        """Return the mean CPU seconds of a cell's runs."""
        return formats.number(self.cell(label).cpu_s.value)

    def cpu_s_to_90(self, label: str) -> str:
        """Return the median CPU seconds of a cell's runs to 90 %."""
        return formats.number(self.cell(label).median_cpu_s)

    def reaching(self, label: str, threshold: float) -> str:
        """Return how many seeds of a cell reach a final success: `99/100`."""
        rates = np.asarray(seed_rates(self.cell(label)).rates)
        return f"{np.count_nonzero(rates >= threshold)}/{len(rates)}"

    def difference(self, first: str, second: str) -> str:
        """Return the difference in success of two cells, e.g. `+9.1 points [+4.0, +14.2], p =
        0.012`.
        """
        pair = self._pair(first, second)
        pair = pair if pair.a == self.cell(first).id else pair.reverse()
        return f"{formats.points_interval(pair.difference)}, {formats.p_value(pair.p_corrected)}"

    def ranks(self, first: str, second: str) -> str:
        """Return p of Mann and Whitney's test of two cells' seeds, e.g. `p = 0.012`."""
        return formats.p_value(self._pair(first, second).rank_p)

    def _pair(self, first: str, second: str) -> Pair:
        ids = {self.cell(first).id, self.cell(second).id}
        return next(pair for pair in self.report.pairs if {pair.a, pair.b} == ids)

    def mean(self, key: str, level: object) -> str:
        """Return the mean success of the cells with a value of a config key, with its interval."""
        factor = next(effect for effect in self.report.effects if effect.factor == key)
        return formats.rate_interval(
            next(item.effect for item in factor.levels if item.level == level)
        )

    def table(self, factors: dict[str, str], *columns: str, labels: tuple[str, ...] = ()) -> str:
        """Return a Markdown table of cells.

        Args:
            factors: config keys and the headings of their columns; empty: one column of labels.
            columns: names in COLUMNS.
            labels: labels of the cells, in the order of the rows; empty: all cells.
        """
        heads = [*(factors.values() or ["cell"]), *(COLUMNS[name][0] for name in columns)]
        lines = [_row(heads), _row([*(":---" for _ in factors or [0]), *("---:" for _ in columns)])]
        cells = [self.cell(label) for label in labels] or self.report.cells
        for cell in cells:
            names = [self._setting(cell, key) for key in factors] or [f"`{cell.label}`"]
            lines.append(_row([*names, *(COLUMNS[name][1](cell) for name in columns)]))
        return "\n".join(lines)

    def grid(self, row: str, column: str) -> str:
        """Return a Markdown table of success by two config keys, in percent; cells without one of
        them are left out.
        """
        rates = {
            place: formats.percent_interval(cell.success)
            for cell in self.report.cells
            if all(place := (self._setting(cell, row), self._setting(cell, column)))
        }
        rows, columns = (list(dict.fromkeys(place[axis] for place in rates)) for axis in (0, 1))
        row_name, column_name = (
            key.removesuffix(".name").rpartition(".")[2] for key in (row, column)
        )
        lines = [
            [f"`{row_name}`", *(f"`{column_name}={value}`" for value in columns)],
            [":---", *("---:" for _ in columns)],
        ]
        lines += [[value, *(rates.get((value, other), "") for other in columns)] for value in rows]
        return "\n".join(map(_row, lines))

    def _setting(self, cell: CellSummary, key: str) -> str:
        value: Any = self._runs.at[cell.seeds[0].run_id, f"config.{key}"]
        return (
            ""
            if pd.isna(value)
            else f"{value:,}"
            if isinstance(value, Integral)
            else formats.setting(value)
        )

    @cached_property
    def _runs(self) -> pd.DataFrame:
        return self.results.runs.set_index("run_id")

    def environment(self) -> str:
        """Return the package versions of the runs."""
        origin = self.report.provenance
        versions = [
            f"{name} {', '.join(origin.versions[name])}"
            for name in PACKAGES
            if name in origin.versions
        ]
        return ", ".join(versions)

    @property
    def cross_checked(self) -> str:
        """Number of scenes of a run that were cross-checked on highway-env."""
        if "config.env.simulator" not in self.results.runs:
            return "none"
        if (self.results.runs["config.env.simulator"] == "highway_env").all():
            return "all"
        return ", ".join(
            map(str, self.results.runs["config.evaluation.n_certified_scenes"].unique())
        )

    @property
    def runs(self) -> int:
        """Number of finished runs."""
        return sum(len(cell.seeds) for cell in self.report.cells)

    @property
    def cpu_hours(self) -> float:
        """CPU time of all runs, in hours."""
        return float(self.results.runs["cpu_s"].sum()) / 3600


def main(arguments: list[str]) -> int:
    """Write the pages, README's parts and the figures; with `--check`, compare the texts only."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument(
        "--check", action="store_true", help="write nothing; fail if a text is not up to date"
    )
    only_check = parser.parse_args(arguments).check
    experiments = {
        folder.name: _experiment(folder) for folder in sorted(EXPORTS.iterdir()) if folder.is_dir()
    }
    texts = {
        PAGE: _rendered("page", experiments),
        FULL_TABLES: _rendered("full_tables", experiments),
        PROVENANCE: _rendered("provenance", experiments),
        README: _readme(experiments),
    }
    stale = [path for path, text in texts.items() if path.read_text(encoding="utf-8") != text]
    if only_check:
        for path in stale:
            say(
                f"{path.relative_to(ROOT)} is not up to date with docs/results; run make "
                "results-page"
            )
        return int(bool(stale))
    for path in stale:
        path.write_text(texts[path], encoding="utf-8")
    for name, experiment in experiments.items():
        if f"images/results_{name}.png" in texts[PAGE]:
            _draw(
                name,
                experiment.only(*FIGURE_CELLS[name]).report
                if name in FIGURE_CELLS
                else experiment.report,
            )
    say(
        f"written        {', '.join(str(path.relative_to(ROOT)) for path in texts)}, "
        "docs/images/results_*.png"
    )
    return 0


def _experiment(folder: Path) -> Experiment:
    results = read_export(folder)
    names = list(dict.fromkeys(results.runs["experiment"]))
    return Experiment(results, build_report(results, names))


def _readme(experiments: dict[str, Experiment]) -> str:
    """Return README with its parts between `<!-- results: NAME -->` and `<!-- end of results -->`
    filled in.
    """
    text = README.read_text(encoding="utf-8")
    return MARKED.sub(
        lambda match: f"{match[1]}{_rendered(match['name'], experiments).strip()}\n{match[3]}", text
    )


def _rendered(name: str, experiments: dict[str, Experiment]) -> str:
    """Return the template docs/results/NAME.md.jinja, filled in and wrapped."""
    text = (EXPORTS / f"{name}.md.jinja").read_text(encoding="utf-8")
    # Markdown needs no escaping of HTML.
    template = Environment(
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    ).from_string(text)
    return _wrapped(template.render(experiments, tables=experiments))


def _wrapped(text: str) -> str:
    """Wrap paragraphs and lists, whose lines get longer when numbers are filled in."""
    blocks = re.split(r"(```.*?```)", re.sub(r"\n{3,}", "\n\n", text), flags=re.DOTALL)
    return "".join(
        block if number % 2 else "\n\n".join(_paragraphs(block))
        for number, block in enumerate(blocks)
    )


def _paragraphs(text: str) -> Iterator[str]:
    for paragraph in text.split("\n\n"):
        if paragraph.lstrip().startswith(("|", "#", "!", "<")) or not paragraph.strip():
            yield paragraph
            continue
        start, end = (
            ("\n" if edge else "")
            for edge in (paragraph.startswith("\n"), paragraph.endswith("\n"))
        )
        yield start + "\n".join(map(_filled, re.split(r"\n(?=- )", paragraph.strip("\n")))) + end


def _filled(item: str) -> str:
    words = LINK.sub(lambda link: link[0].replace(" ", NO_BREAK), " ".join(item.split()))
    indent = "  " if words.startswith("- ") else ""
    lines = textwrap.fill(
        words, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return lines.replace(NO_BREAK, " ")


def _range(cell: CellSummary, metric: str) -> str:
    """Return a mean rate with its lowest and highest seed, for a table."""
    rates = [seed.metric(metric) or 0.0 for seed in cell.seeds]
    mean, low, high = (
        formats.percent(rate) for rate in (cell.metric(metric).value, min(rates), max(rates))
    )
    return f"{mean} ({low}, {high})"


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _draw(name: str, report: ReportData) -> None:
    """Draw the figure of an experiment as docs/images/results_NAME.png."""
    from parking_exp.reports.sections import draw, sections_of

    wanted = FIGURES.get(name, "final_success")
    sections = [
        section
        for section in sections_of(report)
        if wanted in {figure.name for figure in section.figures}
    ]
    with TemporaryDirectory() as folder:
        draw(report, Path(folder), ["png"], sections)
        shutil.copy(Path(folder) / f"{wanted}.png", DOCS / "images" / f"results_{name}.png")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
