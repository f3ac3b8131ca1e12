"""The report as GitHub-flavoured Markdown."""

import re
from collections.abc import Collection, Iterable, Iterator, Sequence

from parking_exp.errors import plural
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
