"""The report as Markdown, and as one HTML file: no network, no library, readable without JavaScript."""

import base64
import hashlib
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from parking_exp.errors import plural
from parking_exp.figure_style import cell_style
from parking_exp.reports import formats
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SectionContent
from parking_exp.reports.tables.table import Table

MOST_ROWS = 100
"""A longer table is cut: `tables/*.csv` hold everything."""
CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
SPECIAL = re.compile(r"([\\`*_\[\]<>|~$&#!])")
LIST_MARK = re.compile(r"^(\d+)([.)])(?=\s|$)|^([-+=])(?!\d)")


def badges(report: ReportData) -> list[tuple[str, str]]:
    """Return what qualifies the whole report: a word, and why."""
    candidates = [
        (report.quick, "preliminary", "made while runs may still have been under way"),
        (report.exploratory, "exploratory", "fewer than 10 seeds in some cell"),
        (report.warnings, plural(len(report.warnings), "warning"), "about what makes numbers hard to compare"),
    ]
    return [(name, reason) for applies, name, reason in candidates if applies]


def markdown(report: ReportData, contents: Sequence[SectionContent], ending: str | None) -> str:
    """Return `report.md`: findings, and what sections say; figures are links to files with an `ending`, if any."""
    parts = [f"# {escaped(report.title)}", *(f"**{name.capitalize()}**: {reason}." for name, reason in badges(report))]
    parts.append(_list(report.claims))
    for title, sentences in (("Keep in mind", report.warnings), ("Missing", report.missing), ("Notes", report.notes)):
        parts += [f"**{title}:**", _list(sentences)] if sentences else []
    parts.append("\n".join(f"    {line}" for line in report.command.splitlines()))
    for content in contents:
        if body := list(_body(content, report.shown, ending)):
            parts += [f"## {escaped(content.title)}", *body]
    return "\n\n".join(filter(None, parts)) + "\n"


def _body(content: SectionContent, shown: Collection[str], ending: str | None) -> Iterator[str]:
    yield from map(escaped, content.text)
    for table in content.readable_tables:
        text = _table(table, shown)
        if table.folded:
            yield from (f"<details><summary>{len(table.rows)} {table.noun}</summary>", text, "</details>")
        else:
            yield text
    if ending:
        for picture in content.pictures:
            yield f"![{escaped(picture.title)}](figures/{picture.name}.{ending})"
            yield escaped(picture.caption)


def _table(table: Table, shown: Collection[str]) -> str:
    """Return a table under its caption: of the cells `shown`, and the first rows of a long one."""
    rows = table.only(shown).entries(MOST_ROWS)
    lines = [
        [escaped(column.title) for column in table.columns],
        ["---:" if column.numeric else ":---" for column in table.columns],
        *([escaped(entry.text) or "–" for entry in row] for row in rows),  # noqa: RUF001
    ]
    cut = f" {len(rows)} of {len(table.rows)} rows; `tables/` holds them all." if len(rows) < len(table.rows) else ""
    return "\n".join([escaped(table.caption) + cut, "", *(f"| {' | '.join(line)} |" for line in lines)])


def _list(sentences: Iterable[str]) -> str:
    return "\n".join(f"- {escaped(sentence)}" for sentence in sentences)


def escaped(text: str) -> str:
    """Escape a text for GitHub's Markdown, tables included."""
    marked = SPECIAL.sub(r"\\\1", one_line(text))
    return LIST_MARK.sub(lambda match: rf"{match[1] or ''}\{match[2] or match[3]}", marked)


def one_line(text: str) -> str:
    """Return a text without line breaks and other control characters."""
    return CONTROL.sub(" ", text).strip()


TEMPLATES = Path(__file__).parent / "templates"
MAX_ROWS = 3000
"""A longer table is left to `tables/*.csv`; the page has its part about the cells in the figures."""

MARKERS = {
    "o": "M5 .8a4.2 4.2 0 1 1 0 8.4a4.2 4.2 0 1 1 0-8.4z",
    "s": "M1.2 1.2h7.6v7.6h-7.6z",
    "^": "M5 .6l4.6 8.4h-9.2z",
    "v": "M5 9.4l4.6-8.4h-9.2z",
    "D": "M5 0l5 5l-5 5l-5-5z",
    "P": "M3.4 .4h3.2v3h3v3.2h-3v3h-3.2v-3h-3v-3.2h3z",
    "X": "M2.8 .5l2.2 2.2l2.2-2.2l2.3 2.3l-2.2 2.2l2.2 2.2l-2.3 2.3l-2.2-2.2l-2.2 2.2l-2.3-2.3l2.2-2.2l-2.2-2.2z",
}


def page(report: ReportData, contents: Sequence[SectionContent]) -> str:
    """Return `index.html`. Everything is escaped; pictures are embedded as images, in which nothing is executed."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": formats.number, "base64": lambda data: base64.b64encode(data).decode()}
    style, script = (TEMPLATES.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    stages = sum((Counter(cell.counts) for cell in report.cells), Counter())
    return environment.get_template("index.html.j2").render(
        report=report,
        style=Markup(style),
        script=Markup(script),
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        sections=[part for part in contents if part.text or part.pictures or part.readable_tables],
        shortened=lambda table: _shortened(table, report.shown),
        swatches={cell: _swatch(cell) for cell in report.shown},
        badges=badges(report),
        stages=stages,
    )


def _swatch(cell_id: str) -> Markup:
    """Return the marker of a cell in the figures, which the page has beside its label."""
    style = cell_style(cell_id)
    svg = Markup('<svg viewBox="0 0 10 10"><path fill="{}" d="{}"/></svg>')
    return svg.format(style.colour, MARKERS.get(style.marker, MARKERS["o"]))


def _shortened(table: Table, shown: Sequence[str]) -> tuple[Table, str]:
    """Return a table, of the cells in the figures alone if it would be too long, and a note that says so."""
    if len(table.rows) <= MAX_ROWS:
        return table, ""
    note = f" Only the cells that the figures show: the whole table is in tables/{table.stem}.csv."
    return table.only(shown), note
