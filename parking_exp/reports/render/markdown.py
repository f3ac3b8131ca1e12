"""The report as GitHub-flavoured Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from parking_exp.reports import formats
from parking_exp.reports.data import Content
from parking_exp.reports.render.listings import Listing, listings
from parking_exp.reports.render.methods import REFERENCES, methods

if TYPE_CHECKING:
    from parking_exp.reports.figures.draw import Picture

ROWS = 100
"""A longer table is cut: `tables/*.csv` hold everything."""

escape = formats.markdown


def markdown(content: Content, pictures: Sequence["Picture"] = (), ending: str = "png") -> str:
    """Return `report.md`: claims, tables, links to `figures/NAME.<ending>`, what was run, how it was computed."""
    found = listings(content, content.shown)
    parts = [f"# {escape(content.title)}", *_summary(content)]
    if "headline" in found:
        parts += ["## Results", table(found["headline"], len(content.cells))]
    if "times" in found:
        parts += ["## Time to 90 %", table(found["times"], len(content.cells))]
    if pictures:
        parts.append("## Figures")
        parts += [
            f"![{escape(picture.title)}](figures/{picture.name}.{ending})\n\n{escape(picture.caption)}"
            for picture in pictures
        ]
    if "pairs" in found:
        parts += ["## Pairs", escape(content.family), table(found["pairs"], len(content.pairs))]
    for name, listing in found.items():
        if name.partition("-")[0] in ("effects", "interactions", "importance"):
            parts += [f"## {name.replace('-', ' ').capitalize()}", table(listing)]
    how = ["## How it was computed", _list(methods(content)), escape(REFERENCES)]
    return "\n\n".join(part for part in [*parts, *_provenance(content, found), *how] if part) + "\n"


def table(listing: Listing, total: int = 0) -> str:
    """Return a table under its caption; the first rows of a long one, where `total` is how many there are in all."""
    rows = listing.rows[:ROWS]
    lines = [
        [escape(column.title) for column in listing.columns],
        ["---:" if column.numeric else ":---" for column in listing.columns],
        *([escape(entry.text) or "–" for entry in row] for row in rows),  # noqa: RUF001
    ]
    total = max(total, len(listing.rows))
    left = f" {len(rows)} of {total} rows; `tables/` holds them all." if len(rows) < total else ""
    return "\n".join([escape(listing.caption) + left, "", *(f"| {' | '.join(line)} |" for line in lines)])


def _summary(content: Content) -> list[str]:
    kinds = []
    if content.quick:
        kinds.append("**Preliminary**: made while runs may still have been under way.")
    if content.exploratory:
        kinds.append("**Exploratory**: fewer than 10 seeds in some cell.")
    return [
        *kinds,
        _list(content.claims),
        *(["**Keep in mind:**", _list(content.warnings)] if content.warnings else []),
        *(["**Missing:**", _list(content.missing)] if content.missing else []),
        _list(content.notes),
    ]


def _provenance(content: Content, found: Mapping[str, Listing]) -> list[str]:
    origin = content.provenance
    parts = ["## What was run"]
    when = f"Runs from {origin.first} to {origin.last}. " if origin.first and origin.last else ""
    parts.append(escape(f"{when}Store: {origin.uri}. Report made {content.made} by parking-exp {content.version}:"))
    parts.append("".join(f"    {line}\n" for line in content.command.splitlines()).rstrip())
    for name in ("versions", "config", "unfinished"):
        if name in found:
            parts.append(table(found[name]))
    if origin.left_out:
        parts += ["Cells that were not asked for:", _list(origin.left_out)]
    if "common" in found:
        summary = "<details><summary>Settings that are the same in all cells</summary>"
        parts += [summary, table(found["common"]), "</details>"]
    return parts


def _list(sentences: Iterable[str]) -> str:
    return "\n".join(f"- {escape(sentence)}" for sentence in sentences)
