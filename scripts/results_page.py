#!/usr/bin/env python
"""Write docs/results.md, docs/full_tables.md, docs/provenance.md, their figures and the marked
parts of README from docs/results; `--check` only compares.
"""

import re
import shutil
import sys
import textwrap
from argparse import ArgumentParser
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from numbers import Integral
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, StrictUndefined

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from parking_exp.config.settings import display_setting
from parking_exp.reports import formats
from parking_exp.reports.cell_comparisons import seed_rates
from parking_exp.reports.report_builder import build_report
from parking_exp.reports.report_data import CellSummary, Pair, ReportData
from parking_exp.results import Results, read_export
from parking_exp.statistics import steps_to
from parking_exp.terminal import say

DOCS = ROOT / "docs"
EXPORTS = DOCS / "results"
README = ROOT / "README.md"
PAGE = DOCS / "results.md"
FULL_TABLES = DOCS / "full_tables.md"
PROVENANCE = DOCS / "provenance.md"
# The others have final_success.
FIGURES = {
    "algorithms": "learning_curves",
    "goal_tasks": "learning_curves",
    "time_to_95": "learning_curves",
    "tutorial": "learning_curves",
}
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
# What stays on one line: links, code, intervals, and numbers with a unit.
UNBROKEN = re.compile(
    r"\[[^\]]*\]\([^)]*\)|`[^`]*`|\[[^\]]*\]|[\N{MINUS SIGN}+]?[\d.]+ (?:%|points)"
)
NO_BREAK = "\0"  # stands for a space where lines may not end, while they are wrapped
MARKED = re.compile(r"(<!-- results: (?P<name>\w+) -->\n).*?(<!-- end of results -->)", re.DOTALL)
COLUMNS = {
    "seeds": ("seeds", lambda cell: str(len(cell.seeds))),
    "success": ("success, %", lambda cell: formats.percent_interval(cell.success)),
    "crash": ("crash, % (range)", lambda cell: _range(cell, "crash")),
    "parked": ("parked, %", lambda cell: formats.percent_interval(cell.metrics["parked"])),
    "lowest": ("lowest", lambda cell: formats.percent(cell.lowest)),
    "iqm": ("IQM", lambda cell: formats.percent(cell.iqm)),
    "at_95": ("seeds ≥ 95 %", lambda cell: f"{cell.reaching_95}/{cell.success.n}"),
    "area": ("AUC, %", lambda cell: formats.percent_interval(cell.area)),
    "to_90": (
        "steps to 90 %",
        lambda cell: (
            formats.number(cell.steps_to_90) or f"{cell.n_reached_90} of {cell.n_timed} seeds"
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
        report = build_report(self.results, self.report.experiments, cells=cells, baseline=baseline)
        return Experiment(self.results, report)

    def cell(self, label: str) -> CellSummary:
        """Return the cell with a label."""
        return next(cell for cell in self.report.cells if cell.label == label)

    def rate(self, label: str, metric: str = "success") -> str:
        """Return the mean rate of a cell with its interval, e.g. `94.4 % [91.2, 97.1]`."""
        return formats.percent_interval_in_words(self.cell(label).metrics[metric])

    def seeds(self, label: str, metric: str = "success") -> str:
        """Return a cell's mean rate (lowest to highest seed), e.g. `94.4 % (90.1 to 100.0 %)`."""
        cell = self.cell(label)
        low, high = _ends(cell, metric)
        return f"{formats.percent_in_words(cell.metrics[metric].value)} ({low} to {high} %)"

    def cpu_s(self, label: str) -> str:
        """Return the mean CPU seconds of a cell's runs."""
        return formats.number(self.cell(label).cpu_s.value)

    def cpu_s_to_90(self, label: str) -> str:
        """Return the median CPU seconds of a cell's runs to 90 %."""
        return formats.number(self.cell(label).cpu_s_to_90)

    def ending_at(self, label: str, threshold: float) -> str:
        """Return how many seeds of a cell end at a success or above: `99/100`."""
        rates = np.asarray(seed_rates(self.cell(label)).rates)
        return f"{np.count_nonzero(rates >= threshold)}/{len(rates)}"

    def difference(self, first: str, second: str) -> str:
        """Return two cells' difference in success, e.g. `+9.1 points [+4.0, +14.2], p = 0.012`."""
        difference = self._pair(first, second).difference
        p = formats.p_in_words(difference.p_corrected)
        return f"{formats.points_interval_in_words(difference)}, {p}"

    def verdict(self, first: str, second: str) -> str:
        """Return the verdict on two cells' difference in success, and its points, e.g. `▲ +9.1`."""
        pair = self._pair(first, second)
        mark = formats.VERDICTS[pair.verdict].mark
        return f"{mark} {formats.points(pair.difference.value)}"

    def ranks(self, first: str, second: str) -> str:
        """Return p of Mann and Whitney's test of two cells' seeds, e.g. `p = 0.012`."""
        return formats.p_in_words(self._pair(first, second).rank_p)

    def least_cpu_time_ratio(self, first: str, second: str) -> str:
        """Return the second cell's CPU time until success stays at 95 %, divided by the first's.

        It is the lower end of an interval: see `least_ratio_of_times`. Success stays at 95 % from
        the first of three evaluations in a row that have it.
        """
        ratio = least_ratio_of_times(self._cpu_s_to_95(second), self._cpu_s_to_95(first))
        return f"{ratio:.0f}"

    def cpu_s_to_95(self, label: str) -> str:
        """Return the median CPU seconds until success of a cell's seeds stays at 95 %."""
        median = float(np.median(self._cpu_s_to_95(label)))
        return formats.number(median) if np.isfinite(median) else "not reached"

    def each_cpu_s_to_95(self, label: str) -> str:
        """List the CPU seconds of each seed of a cell until success stays at 95 %."""
        times = np.sort(self._cpu_s_to_95(label))
        texts = [formats.number(time) if np.isfinite(time) else "not reached" for time in times]
        return ", ".join(texts)

    def each_rate(self, label: str) -> str:
        """List the success of each seed of a cell."""
        rates = np.sort(seed_rates(self.cell(label)).rates)
        return ", ".join(formats.percent(rate) for rate in rates)

    def holding_95(self, label: str) -> str:
        """Return in how many seeds of a cell success stays at 95 %, e.g. `9/10`."""
        times = self._cpu_s_to_95(label)
        return f"{np.isfinite(times).sum()}/{len(times)}"

    def _cpu_s_to_95(self, label: str) -> np.ndarray:
        """Return the CPU seconds of each seed until success stays at 95 %, inf if it never does."""
        curves = dict(iter(self.results.curves.groupby("run_id")))
        times = []
        for seed in self.cell(label).seeds:
            curve = curves[seed.run_id]
            cpu_s = steps_to(curve["cpu_s"], curve["success_rate"], 0.95)
            times.append(np.inf if cpu_s is None else cpu_s)
        return np.array(times)

    def _pair(self, first: str, second: str) -> Pair:
        """Return the comparison of the first cell with the second."""
        first_id = self.cell(first).id
        second_id = self.cell(second).id
        for pair in self.report.pairs:
            if (pair.a, pair.b) == (first_id, second_id):
                return pair
            if (pair.a, pair.b) == (second_id, first_id):
                return pair.reverse()
        raise ValueError(f"{first} and {second} are not compared")

    def comparisons(self) -> str:
        """Return a Markdown table of the pairs that the report compares, corrected for all."""
        labels = {cell.id: cell.label for cell in self.report.cells}
        rows = []
        for pair in self.report.pairs:
            mark = formats.VERDICTS[pair.verdict].mark
            difference = formats.points_interval(pair.difference)
            p = formats.p_value(pair.difference.p_corrected)
            rows.append([f"`{labels[pair.a]}`", f"`{labels[pair.b]}`", mark, difference, p])
        return _table(["cell", "minus"], ["", "difference, points", "p"], rows)

    def mean(self, key: str, level: object) -> str:
        """Return the mean success of the cells with a value of a config key, with its interval."""
        factor = next(effect for effect in self.report.effects if effect.factor == key)
        effects = {item.level: item.effect for item in factor.levels}
        return formats.percent_interval_in_words(effects[level])

    def table(self, factors: dict[str, str], *columns: str, labels: tuple[str, ...] = ()) -> str:
        """Return a Markdown table of cells.

        Args:
            factors: config keys and the headings of their columns; empty: one column of labels.
            columns: names in COLUMNS.
            labels: labels of the cells, in the order of the rows; empty: all cells.
        """
        cells = [self.cell(label) for label in labels] or self.report.cells
        headings = list(factors.values()) or ["cell"]
        rows = []
        for cell in cells:
            names = [self._setting(cell, key) for key in factors] or [f"`{cell.label}`"]
            values = [COLUMNS[name][1](cell) for name in columns]
            rows.append(names + values)
        return _table(headings, [COLUMNS[name][0] for name in columns], rows)

    def grid(self, row: str, column: str) -> str:
        """Return success by two config keys as a Markdown table, in percent, of cells with both."""
        rates: dict[tuple[str, str], str] = {}
        for cell in self.report.cells:
            value = self._setting(cell, row)
            other = self._setting(cell, column)
            if value and other:
                rates[value, other] = formats.percent_interval(cell.success)
        values = dict.fromkeys(value for value, _ in rates)
        others = dict.fromkeys(other for _, other in rates)

        headings = [f"`{_last_part(column)}={other}`" for other in others]
        rows = []
        for value in values:
            rows.append([value, *(rates.get((value, other), "") for other in others)])
        return _table([f"`{_last_part(row)}`"], headings, rows)

    def _setting(self, cell: CellSummary, key: str) -> str:
        value: Any = self._runs.at[cell.seeds[0].run_id, f"config.{key}"]
        if pd.isna(value):
            return ""
        if isinstance(value, Integral):
            return f"{value:,}"
        return display_setting(value)

    @cached_property
    def _runs(self) -> pd.DataFrame:
        return self.results.runs.set_index("run_id")

    def environment(self) -> str:
        """Return the package versions of the runs."""
        versions = self.report.provenance.versions
        texts = []
        for name in PACKAGES:
            if name in versions:
                texts.append(f"{name} {', '.join(versions[name])}")
        return ", ".join(texts)

    @property
    def cross_checked(self) -> str:
        """Number of scenes of a run that were cross-checked on highway-env."""
        runs = self.results.runs
        if "config.env.simulator" not in runs:
            return "none"
        if (runs["config.env.simulator"] == "highway_env").all():
            return "all"
        numbers = runs["config.evaluation.n_certified_scenes"].unique()
        return ", ".join(map(str, numbers))

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
    folders = [folder for folder in sorted(EXPORTS.iterdir()) if folder.is_dir()]
    experiments = {folder.name: _experiment(folder) for folder in folders}
    texts = {
        PAGE: _rendered("page", experiments),
        FULL_TABLES: _rendered("full_tables", experiments),
        PROVENANCE: _rendered("provenance", experiments),
        README: _readme(experiments),
    }
    stale = [path for path, text in texts.items() if path.read_text(encoding="utf-8") != text]
    if only_check:
        for path in stale:
            page = path.relative_to(ROOT)
            say(f"{page} is not up to date with docs/results; run make results-page")
        return int(bool(stale))

    for path in stale:
        path.write_text(texts[path], encoding="utf-8")
    for name, experiment in experiments.items():
        if f"images/results_{name}.png" in texts[PAGE]:
            shown = experiment
            if name in FIGURE_CELLS:
                shown = experiment.only(*FIGURE_CELLS[name])
            _draw(name, shown.report)
    names = ", ".join(str(path.relative_to(ROOT)) for path in texts)
    say(f"written        {names}, docs/images/results_*.png")
    return 0


def _experiment(folder: Path) -> Experiment:
    results = read_export(folder)
    names = list(dict.fromkeys(results.runs["experiment"]))
    return Experiment(results, build_report(results, names))


def _readme(experiments: dict[str, Experiment]) -> str:
    """Return README, filled in from `<!-- results: NAME -->` to `<!-- end of results -->`."""

    def fill(match: re.Match[str]) -> str:
        text = _rendered(match["name"], experiments).strip()
        return f"{match[1]}{text}\n{match[3]}"

    return MARKED.sub(fill, README.read_text(encoding="utf-8"))


def _rendered(name: str, experiments: dict[str, Experiment]) -> str:
    """Return the template docs/results/NAME.md.jinja, filled in and wrapped."""
    text = (EXPORTS / f"{name}.md.jinja").read_text(encoding="utf-8")
    # Markdown needs no escaping of HTML.
    environment = Environment(
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    template = environment.from_string(text)
    return _wrapped(template.render(experiments, tables=experiments))


def _wrapped(text: str) -> str:
    """Wrap paragraphs and lists, whose lines get longer when numbers are filled in."""
    text = re.sub(r"\n{3,}", "\n\n", text)
    blocks = re.split(r"(```.*?```)", text, flags=re.DOTALL)  # every second one is code
    for number in range(0, len(blocks), 2):
        paragraphs = blocks[number].split("\n\n")
        blocks[number] = "\n\n".join(map(_wrapped_paragraph, paragraphs))
    return "".join(blocks)


def _wrapped_paragraph(paragraph: str) -> str:
    """Wrap a paragraph or a list; tables, headings, images and HTML stay as they are."""
    content = paragraph.strip("\n")
    if not content.strip() or paragraph.lstrip().startswith(("|", "#", "!", "<")):
        return paragraph
    items = re.split(r"\n(?=- )", content)
    start = "\n" if paragraph.startswith("\n") else ""
    end = "\n" if paragraph.endswith("\n") else ""
    return start + "\n".join(map(_filled, items)) + end


def _filled(item: str) -> str:
    words = UNBROKEN.sub(lambda link: link[0].replace(" ", NO_BREAK), " ".join(item.split()))
    indent = "  " if words.startswith("- ") else ""
    lines = textwrap.fill(
        words, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return lines.replace(NO_BREAK, " ")


def least_ratio_of_times(times: np.ndarray, others: np.ndarray) -> float:
    """Return the lower end of the 95 % interval of the ratio of two samples of times.

    The interval inverts the exact test of Mann and Whitney (Hodges and Lehmann 1963). It supposes
    that both have the same distribution but for a factor. Shape (seeds,) each. Times are inf where
    only a lower limit is known. Where it is so of both, their ratio counts as 0.

    Raises:
        ValueError: there are too few times for an interval of 95 %.
    """
    n = len(times)
    ranks = combinations(range(n + len(others)), n)
    u = np.sort([sum(chosen) for chosen in ranks]) - n * (n - 1) // 2
    # The number of pairs below the interval.
    outside = int(u[int(0.025 * len(u))])
    if outside == 0:
        raise ValueError(f"{n} and {len(others)} times are too few")
    with np.errstate(invalid="ignore"):
        ratios = np.divide.outer(times, others).ravel()
    ratios[np.isnan(ratios)] = 0
    return float(np.sort(ratios)[outside - 1])


def _range(cell: CellSummary, metric: str) -> str:
    """Return a mean rate with its lowest and highest seed, for a table."""
    low, high = _ends(cell, metric)
    return f"{formats.percent(cell.metrics[metric].value)} ({low}, {high})"


def _ends(cell: CellSummary, metric: str) -> tuple[str, str]:
    """Return the rates of the lowest and the highest seed of a cell, in percent."""
    rates = [seed.metrics[metric] or 0.0 for seed in cell.seeds]
    return formats.percent(min(rates)), formats.percent(max(rates))


def _last_part(key: str) -> str:
    """Return the name that a config key has in the head of a table."""
    return key.removesuffix(".name").rpartition(".")[2]


def _table(left: list[str], right: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table whose first columns are aligned to the left, the others right.

    Args:
        left: headings of the first columns.
        right: headings of the others.
        rows: the cells of each row.
    """
    alignment = [":---"] * len(left) + ["---:"] * len(right)
    return "\n".join(map(_row, [left + right, alignment, *rows]))


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _draw(name: str, report: ReportData) -> None:
    """Draw the figure of an experiment as docs/images/results_NAME.png."""
    from parking_exp.reports.sections import draw_figures, sections_of

    wanted = FIGURES.get(name, "final_success")
    sections = []
    for section in sections_of(report):
        if any(figure.name == wanted for figure in section.figures):
            sections.append(section)
    with TemporaryDirectory() as folder:
        draw_figures(report, Path(folder), ["png"], sections)
        shutil.copy(Path(folder) / f"{wanted}.png", DOCS / "images" / f"results_{name}.png")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
