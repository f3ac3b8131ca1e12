"""The report as GitHub-flavoured Markdown."""

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from parking_exp.reports import formats
from parking_exp.reports.methods import REFERENCES, methods
from parking_exp.reports.report_data import Cell, ReportData
from parking_exp.reports.sections import SECTIONS, Section, provenance_tables, section_tables
from parking_exp.reports.tables.writers import markdown as table_text

if TYPE_CHECKING:
    from parking_exp.reports.figures.figure_files import Picture

FIGURES_BEFORE = "pairs"
"""The section that all figures stand before."""

escape = formats.markdown


def markdown(
    report: ReportData,
    pictures: Sequence["Picture"] = (),
    ending: str = "png",
    sections: Sequence[Section] = SECTIONS,
) -> str:
    """Return `report.md`: findings, tables, links to `figures/NAME.<ending>`, what was run, how it was computed."""
    cells = report.shown_cells
    at = next((n for n, section in enumerate(sections) if section.id == FIGURES_BEFORE), len(sections))
    parts = [f"# {escape(report.title)}", *_summary(report)]
    parts += [part for section in sections[:at] for part in _section(section, report, cells)]
    if pictures:
        parts.append("## Figures")
        parts += [
            f"![{escape(picture.title)}](figures/{picture.name}.{ending})\n\n{escape(picture.caption)}"
            for picture in pictures
        ]
    parts += [part for section in sections[at:] for part in _section(section, report, cells)]
    how = ["## How it was computed", _list(methods(report)), escape(REFERENCES)]
    return "\n\n".join(part for part in [*parts, *_provenance(report, cells), *how] if part) + "\n"


def _section(section: Section, report: ReportData, cells: Sequence[Cell]) -> Iterator[str]:
    if not section.in_markdown:
        return
    text = [escape(paragraph) for paragraph in section.text(report)]
    found = [table for table in section_tables(section, report, cells) if table.readable]
    if text and not found:
        yield f"## {escape(section.title)}"
        yield from text
    for number, table in enumerate(found):
        yield f"## {escape(table.title or section.title)}"
        yield from text if number == 0 else ()
        yield table_text(table)


def _summary(report: ReportData) -> list[str]:
    kinds = []
    if report.quick:
        kinds.append("**Preliminary**: made while runs may still have been under way.")
    if report.exploratory:
        kinds.append("**Exploratory**: fewer than 10 seeds in some cell.")
    return [
        *kinds,
        _list(report.claims),
        *(["**Keep in mind:**", _list(report.warnings)] if report.warnings else []),
        *(["**Missing:**", _list(report.missing)] if report.missing else []),
        _list(report.notes),
    ]


def _provenance(report: ReportData, cells: Sequence[Cell]) -> list[str]:
    origin, found = report.provenance, provenance_tables(report, cells)
    parts = ["## What was run"]
    when = f"Runs from {origin.first} to {origin.last}. " if origin.first and origin.last else ""
    parts.append(escape(f"{when}Store: {origin.uri}. Report made {report.made} by parking-exp {report.version}:"))
    parts.append("".join(f"    {line}\n" for line in report.command.splitlines()).rstrip())
    for name in ("versions", "config", "unfinished"):
        if name in found:
            parts.append(table_text(found[name]))
    if origin.left_out:
        parts += ["Cells that were not asked for:", _list(origin.left_out)]
    if "common" in found:
        summary = "<details><summary>Settings that are the same in all cells</summary>"
        parts += [summary, table_text(found["common"]), "</details>"]
    return parts


def _list(sentences: Iterable[str]) -> str:
    return "\n".join(f"- {escape(sentence)}" for sentence in sentences)
