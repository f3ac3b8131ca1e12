"""The report as GitHub-flavoured Markdown."""

from collections.abc import Iterable, Iterator, Sequence

from parking_exp.errors import plural
from parking_exp.reports import formats
from parking_exp.reports.report_data import ReportData
from parking_exp.reports.sections import SectionContent
from parking_exp.reports.tables.table_writers import markdown as table_text

escape = formats.markdown


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
    parts = [f"# {escape(report.title)}", *(f"**{name.capitalize()}**: {reason}." for name, reason in badges(report))]
    parts.append(_list(report.claims))
    for title, sentences in (("Keep in mind", report.warnings), ("Missing", report.missing), ("Notes", report.notes)):
        parts += [f"**{title}:**", _list(sentences)] if sentences else []
    parts.append("\n".join(f"    {line}" for line in report.command.splitlines()))
    for content in contents:
        if body := list(_body(content, report.shown, ending)):
            parts += [f"## {escape(content.title)}", *body]
    return "\n\n".join(filter(None, parts)) + "\n"


def _body(content: SectionContent, shown: Sequence[str], ending: str | None) -> Iterator[str]:
    yield from map(escape, content.text)
    for table in content.readable_tables:
        text = table_text(table, shown)
        if table.folded:
            yield from (f"<details><summary>{len(table.rows)} {table.noun}</summary>", text, "</details>")
        else:
            yield text
    if ending:
        for picture in content.pictures:
            yield f"![{escape(picture.title)}](figures/{picture.name}.{ending})"
            yield escape(picture.caption)


def _list(sentences: Iterable[str]) -> str:
    return "\n".join(f"- {escape(sentence)}" for sentence in sentences)
