#!/usr/bin/env python
"""Write docs/results.md, its figures and README's rates from the exports in docs/results; `--check` only compares."""

import re
import sys
import textwrap
from argparse import ArgumentParser
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import combinations
from numbers import Integral
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas as pd
from jinja2 import Environment, StrictUndefined
from PIL import Image, PngImagePlugin

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from parking_exp import statistics
from parking_exp.reports import formats
from parking_exp.reports.report_builder import build_report
from parking_exp.reports.report_data import Cell, ReportData, Setting
from parking_exp.results import Results, read_export
from parking_exp.terminal import say

DOCS = ROOT / "docs"
EXPORTS, PAGE, README = DOCS / "results", DOCS / "results.md", ROOT / "README.md"
FIGURES = {  # of a table; of others every seed's success
    "algorithms": ("learning_curves", "trajectories"),
    "tutorial": ("learning_curves",),
}
WIDTH = 120
PACKAGES = ("highway-env", "stable-baselines3", "sb3-contrib", "torch", "python")
DRAWN = {  # cells that a table's figures show; of others all
    "her_ablation": ("her_future*", "replay"),
    "her_relabelling": ("her_future*", "algorithm.features=ego_mirrored"),
}
SOURCE = "Source"  # of a picture: the PNG keyword
LINK, NO_BREAK = re.compile(r"\[[^\]]*\]\([^)]*\)"), "\0"
MARKED = re.compile(r"(<!-- results: (?P<name>\w+) -->\n).*?(<!-- end of results -->)", re.DOTALL)
COLUMNS = {
    "success": ("success, %", lambda cell: formats.percent_interval(cell.success)),
    "crash": ("crash, % (range)", lambda cell: _range(cell, "crash")),
    "parked": ("parked, %", lambda cell: formats.percent_interval(cell.parked)),
    "lowest": ("lowest success", lambda cell: formats.percent(min(seed.success for seed in cell.seeds))),
    "at_90": ("seeds ≥ 90 %", lambda cell: f"{cell.reaching_90.k} of {cell.reaching_90.n}"),
    "area": ("area, %", lambda cell: formats.percent_interval(cell.area)),
    "to_90": (
        "env steps to hold 90 %",
        lambda cell: formats.number(cell.survival.median) or f"{cell.survival.k} of {cell.survival.n} seeds did",
    ),
    "cpu_s": ("CPU-s", lambda cell: formats.number(cell.cpu_s.value)),
}


@dataclass(frozen=True)
class Experiment:
    """What the page's template may say of one experiment; cells are named by their labels."""

    results: Results
    report: ReportData

    def only(self, *cells: str, baseline: str | None = None) -> "Experiment":
        """Return a part of it, as `scripts/report.py` takes its cells and baseline; its labels are shorter."""
        return Experiment(
            self.results, build_report(self.results, self.report.experiments, cells=cells, baseline=baseline)
        )

    def cell(self, label: str) -> Cell:
        """Return a cell."""
        return next(cell for cell in self.report.cells if cell.label == label)

    def rate(self, label: str, metric: str = "success") -> str:
        """Return a mean rate with its interval, e.g. `94.4 % [91.2, 97.1]`."""
        return formats.rate_interval(getattr(self.cell(label), metric))

    def seeds(self, label: str, metric: str = "success") -> str:
        """Return a mean rate with its lowest and highest seed, e.g. `94.4 % (90.1 to 100.0 %)`."""
        cell = self.cell(label)
        rates = [getattr(seed, metric) for seed in cell.seeds]
        low, high = formats.percent(min(rates)), formats.percent(max(rates))
        return f"{formats.rate_text(getattr(cell, metric).value)} ({low} to {high} %)"

    def largest_fall(self, label: str) -> str:
        """Return by how many points the success of a seed fell at most from an evaluation to the next one."""
        runs = [seed.run_id for seed in self.cell(label).seeds]
        curves = self.results.curves[self.results.curves["run_id"].isin(runs)].sort_values(["run_id", "step"])
        return formats.percent(-curves.groupby("run_id")["success_rate"].diff().min())

    def cpu_s(self, label: str) -> str:
        """Return the mean CPU seconds of a run."""
        return formats.number(self.cell(label).cpu_s.value)

    def difference(self, one: str, other: str) -> str:
        """Return how much better a cell is, e.g. `+9.1 points [+4.0, +14.2], p = 0.012`, and whether that is known."""
        a, b = self.cell(one).id, self.cell(other).id
        pair = next(pair for pair in self.report.pairs if {pair.a, pair.b} == {a, b})
        pair = pair if pair.a == a else pair.turned()
        known = "" if pair.verdict in ("a", "b") else ": can't be told apart"
        return f"{formats.points_interval(pair.difference)}, {formats.p_value(pair.p_holm)}{known}"

    def better_than(self, label: str) -> int:
        """Return how many cells are better than one, by Holm's p."""
        one = self.cell(label).id
        worse = [{"a": pair.b, "b": pair.a}.get(pair.verdict) for pair in self.report.pairs]
        return worse.count(one)

    def mean(self, key: str, level: object) -> str:
        """Return the mean success of the cells with one value of a config key, with its interval."""
        factor = next(effect for effect in self.report.effects if effect.factor == key)
        return formats.rate_interval(next(one.effect for one in factor.levels if one.level == level))

    def contrasts(self, key: str, within: str) -> dict[tuple[str, str], str]:
        """Return how far any two values of a config key are apart, e.g. `+9.1 [+4.0, +14.2], p = 0.012`.

        Means are over the values of the key `within`; a control that has none is a cell of its own. p is Holm's over
        all pairs.
        """
        rows = [
            (self._setting(cell, key), self._setting(cell, within), seed.success)
            for cell in self.report.cells
            for seed in cell.seeds
        ]
        frame = pd.DataFrame(rows, columns=[key, within, "success"])
        pairs = list(combinations(dict.fromkeys(frame[key]), 2))
        found = [statistics.contrast(frame, [key, within], "success", (key, *pair)) for pair in pairs]
        corrected = statistics.holm([one.p for one in found])
        return {
            pair: f"{formats.points(one.difference)} [{formats.points(one.low)}, {formats.points(one.high)}], "
            f"{formats.p_value(p)}"
            for pair, one, p in zip(pairs, found, corrected, strict=True)
        }

    def real_share(self, row: str, column: Setting) -> str:
        """Return the measured share of real transitions of a place of the first table of two factors, in percent."""
        table = self.report.interactions[0]
        assert table.real_share
        share = table.real_share[list(table.rows).index(row)][list(table.columns).index(column)]
        assert share is not None
        return f"{100 * share:.0f} %"

    def log_rank(self, one: str, other: str) -> str:
        """Return Holm's p of the difference in the time to hold 90 %, e.g. `p = 0.012`."""
        ids = {self.cell(one).id, self.cell(other).id}
        return formats.p_value(next(pair.log_rank_p_holm for pair in self.report.pairs if {pair.a, pair.b} == ids))

    def table(self, factors: dict[str, str], *columns: str) -> str:
        """Return a Markdown table of all cells.

        Args:
            factors: config keys and what their columns are called; no keys: a column of labels.
            columns: names in COLUMNS.
        """
        heads = [*(factors.values() or ["cell"]), *(COLUMNS[name][0] for name in columns)]
        lines = [_row(heads), _row([*(":---" for _ in factors or [0]), *("---:" for _ in columns)])]
        for cell in self.report.cells:
            if not cell.seeds:
                continue
            names = [self._setting(cell, key) for key in factors] or [f"`{cell.label}`"]
            lines.append(_row([*names, *(COLUMNS[name][1](cell) for name in columns)]))
        return "\n".join(lines)

    def grid(self, row: str, column: str, metric: str = "success", **where: str) -> str:
        """Return a Markdown table of a mean rate of cells by two config keys, with its interval, in percent.

        Args:
            row, column: config keys; cells without a value of one of them are left out.
            metric: a rate.
            where: another key, its dots written as `__`, and its value.

        Raises:
            ValueError: no cell is left, or two cells have the same values.
        """
        found: dict[tuple[str, str], str] = {}
        for cell in self.report.cells:
            place = self._setting(cell, row), self._setting(cell, column)
            if all(self._setting(cell, key.replace("__", ".")) == one for key, one in where.items()) and all(place):
                if place in found:
                    raise ValueError(f"{row} and {column} do not tell {cell.label} from another cell")
                found[place] = formats.percent_interval(getattr(cell, metric))
        if not found:
            raise ValueError(f"there is no cell with {row}, {column} and {where}")
        rows, columns = (list(dict.fromkeys(place[at] for place in found)) for at in (0, 1))
        short, shorter = (key.removesuffix(".name").rpartition(".")[2] for key in (row, column))
        heads = [f"`{short}`", *(f"`{shorter}={one}`" for one in columns)]
        lines = [heads, [":---", *("---:" for _ in columns)]]
        lines += [[one, *(found.get((one, other), "") for other in columns)] for one in rows]
        return "\n".join(map(_row, lines))

    def _setting(self, cell: Cell, key: str) -> str:
        value: Any = self._runs.at[cell.seeds[0].run_id, f"config.{key}"]
        return "" if pd.isna(value) else f"{value:,}" if isinstance(value, Integral) else formats.setting(value)

    @cached_property
    def _runs(self) -> pd.DataFrame:
        return self.results.runs.set_index("run_id")

    def provenance(self) -> str:
        """Return where the runs come from: how many, CPU time, machines, versions, commits."""
        origin = self.report.provenance
        certified = ", ".join(map(str, self.results.runs["config.evaluation.n_certified_scenes"].unique()))
        versions = [f"{name} {', '.join(origin.versions[name])}" for name in PACKAGES if name in origin.versions]
        return (
            f"{self.runs} runs, {self.cpu_hours:.1f} CPU-hours, {', '.join(origin.machines)}; {', '.join(versions)}; "
            f"commit {', '.join(origin.commits)}; {certified} scenes of each run repeated on highway-env."
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
    """Write the page, or with `--check` say whether it is what the exports give."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail where the page is not up to date")
    only_check = parser.parse_args(arguments).check
    found = {folder.name: _experiment(folder) for folder in sorted(EXPORTS.iterdir()) if folder.is_dir()}
    written = {PAGE: _page(found), README: _readme(found)}
    stale = [path for path, text in written.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    if only_check:
        pictures = {path: _digest(name) for name in found for path in _pictures(name).values()}
        stale += [path for path, digest in pictures.items() if _drawn_from(path) != digest]
        for path in stale:
            say(f"{path.relative_to(ROOT)} is not what the exports give; type make results-page")
        return int(bool(stale))
    for path in stale:
        path.write_text(written[path], encoding="utf-8")
    for name, experiment in found.items():
        _draw(name, experiment.only(*DRAWN[name]).report if name in DRAWN else experiment.report)
    say(f"written        {PAGE.relative_to(ROOT)}, {README.relative_to(ROOT)}, docs/images/results_*.png")
    return 0


def _experiment(folder: Path) -> Experiment:
    results = read_export(folder)
    names = list(dict.fromkeys(results.runs["experiment"]))
    return Experiment(results, build_report(results, names))


def _page(found: dict[str, Experiment]) -> str:
    return _rendered("page", found)


def _readme(found: dict[str, Experiment]) -> str:
    """Return README with its marked parts filled in: `<!-- results: NAME -->` by NAME's template."""
    text = README.read_text(encoding="utf-8")
    return MARKED.sub(lambda match: f"{match[1]}{_rendered(match['name'], found).strip()}\n{match[3]}", text)


def _rendered(name: str, found: dict[str, Experiment]) -> str:
    """Fill in the template docs/results/NAME.md.jinja: experiments by their names, and all of them as `tables`."""
    text = (EXPORTS / f"{name}.md.jinja").read_text(encoding="utf-8")
    # Markdown, which needs no escaping of HTML.
    template = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, autoescape=False)
    return _wrapped(template.from_string(text).render(found, tables=found))


def _wrapped(text: str) -> str:
    """Break lines of paragraphs and lists, whose numbers make them longer than a line of the template."""
    blocks = re.split(r"(```.*?```)", re.sub(r"\n{3,}", "\n\n", text), flags=re.DOTALL)
    return "".join(block if number % 2 else "\n\n".join(_lines(block)) for number, block in enumerate(blocks))


def _lines(text: str) -> Iterator[str]:
    for paragraph in text.split("\n\n"):
        if paragraph.lstrip().startswith(("|", "#", "!", "<")) or not paragraph.strip():
            yield paragraph
            continue
        start = "\n" if paragraph.startswith("\n") else ""
        end = "\n" if paragraph.endswith("\n") else ""
        items = re.split(r"\n(?=- )", paragraph.strip("\n"))
        yield start + "\n".join(_filled(item) for item in items) + end


def _filled(item: str) -> str:
    words = LINK.sub(lambda link: link[0].replace(" ", NO_BREAK), " ".join(item.split()))
    indent = "  " if words.startswith("- ") else ""
    lines = textwrap.fill(words, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
    return lines.replace(NO_BREAK, " ")


def _range(cell: Cell, metric: str) -> str:
    """Return a mean rate with its lowest and highest seed, for a table."""
    rates = [getattr(seed, metric) for seed in cell.seeds]
    return (
        f"{formats.percent(getattr(cell, metric).value)} ({formats.percent(min(rates))}, {formats.percent(max(rates))})"
    )


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _draw(name: str, report: ReportData) -> None:
    """Draw the figures of a table; the files have the digest of the export that they were drawn from."""
    from parking_exp.reports.figures.figure_files import draw
    from parking_exp.reports.sections import SECTIONS

    pictures = _pictures(name)
    sections = [section for section in SECTIONS if any(one.name in pictures for one in section.figures)]
    source = PngImagePlugin.PngInfo()
    source.add_text(SOURCE, _digest(name))
    with TemporaryDirectory() as folder:
        draw(report, Path(folder), ["png"], sections)
        for figure, path in pictures.items():
            with Image.open(Path(folder) / f"{figure}.png") as image:
                image.save(path, pnginfo=source, optimize=True)


def _pictures(name: str) -> dict[str, Path]:
    """Return the files of a table's figures, by their names: `results_NAME.png` is the first."""
    first, *others = FIGURES.get(name, ("final_success",))
    names = {first: f"results_{name}", **{figure: f"results_{name}_{figure}" for figure in others}}
    return {figure: DOCS / "images" / f"{file}.png" for figure, file in names.items()}


def _digest(name: str) -> str:
    """Return a digest of an export's files and of what is drawn from them."""
    files = sorted(path for path in (EXPORTS / name).iterdir() if path.is_file())
    parts = [
        repr((list(_pictures(name)), DRAWN.get(name))).encode(),
        *(path.name.encode() + path.read_bytes() for path in files),
    ]
    return sha256(b"".join(parts)).hexdigest()


def _drawn_from(picture: Path) -> str | None:
    """Return the digest of the export that a picture was drawn from; None if it is not there."""
    if not picture.exists():
        return None
    with Image.open(picture) as image:
        return image.info.get(SOURCE)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
