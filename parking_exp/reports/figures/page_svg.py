"""Rewrite matplotlib's SVG for the page: CSS variables as colours, unique ids, values under the pointer.

matplotlib has none of the three. Chart libraries for offline pages draw nothing without JavaScript, weigh about 1 MB
(Vega-Lite) to 4.5 MB (Plotly), and could not write the PDF and PNG files.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from parking_exp.reports.figures.style import GRID, INK, PAPER, clean

_SVG, _XLINK = "http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"
_THEME = {INK: "var(--ink, currentColor)", GRID: f"var(--grid, {GRID})", PAPER: "var(--paper, #ffffff)"}
_FAMILY = re.compile(r"font-family: [^;]*")
_FONT = re.compile(r"font: (?:(?P<weight>bold|\d+) )?(?P<size>[\d.]+)px [^;]*")
_NUMBER = re.compile(r"(\d+\.\d\d)\d+")
_SPACE = re.compile(r"\s+")
_SCALE = 1.35  # of a drawing's own size, at most: pages are read from farther away than paper


@dataclass(frozen=True)
class Tip:
    """A value under the pointer.

    Attributes:
        shape: `circle`, `rect` or `path`: an invisible one that lies over what was drawn.
        geometry: its attributes, in the drawing's points.
        text: what the page shows; may be hostile.
    """

    shape: str
    geometry: Mapping[str, str]
    text: str


def page_svg(drawing: bytes, name: str, title: str, tips: Sequence[Tip], texts: Mapping[str, str]) -> str:
    """Return what a page holds in place of an image.

    Args:
        drawing: as matplotlib writes it, with text as text.
        name: of the picture; what its ids begin with.
        title: for those who don't see it.
        tips: laid over the drawing.
        texts: id of a group -> what its text says where fonts have more characters than the drawing's one.
    """
    root = ET.fromstring(drawing)
    _replace_texts(root, texts)
    used = {reference for element in root.iter() for reference in _references(element)}
    for element in list(root.iter()):
        for child in list(element):
            if child.tag in (f"{{{_SVG}}}metadata", f"{{{_SVG}}}style", f"{{{_SVG}}}title"):
                element.remove(child)
        element.tag = element.tag.removeprefix(f"{{{_SVG}}}")
        _own(element, name, used)
    _drop_empty(root)
    _dress(root, title)
    root.append(_overlay(tips))
    return ET.tostring(root, encoding="unicode")


def _replace_texts(root: ET.Element, texts: Mapping[str, str]) -> None:
    for group in root.iter(f"{{{_SVG}}}g"):
        if (text := texts.get(group.get("id", ""))) is not None:
            for element in group.iter(f"{{{_SVG}}}text"):
                element.text = clean(text)


def _references(element: ET.Element) -> list[str]:
    href = element.get(f"{{{_XLINK}}}href") or element.get("href") or ""
    found = [href[1:]] if href.startswith("#") else []
    for key in ("clip-path", "style"):
        found += re.findall(r"url\(#([^)]+)\)", element.get(key, ""))
    return found


def _own(element: ET.Element, name: str, used: set[str]) -> None:
    """Rewrite an element's attributes: ids and references of the picture's own, the theme's colours, short numbers."""
    href = element.attrib.pop(f"{{{_XLINK}}}href", None)
    if href is not None and href.startswith("#"):
        element.set("href", f"#{name}-{href[1:]}")
    if (identity := element.attrib.pop("id", None)) in used:
        element.set("id", f"{name}-{identity}")
    for key in ("d", "x", "y", "transform", "points", "width", "height"):
        if key in element.attrib:
            element.set(key, _SPACE.sub(" ", _NUMBER.sub(r"\1", element.attrib[key])).strip())
    for key in ("clip-path", "style"):
        if key in element.attrib:
            element.set(key, element.attrib[key].replace("url(#", f"url(#{name}-"))
    if style := element.get("style"):
        for colour, variable in _THEME.items():
            style = style.replace(colour, variable)
        element.set("style", _FONT.sub(_font, _FAMILY.sub("font-family: inherit", style)))


def _font(match: re.Match[str]) -> str:
    """Return the font properties of matplotlib before 3.11, which writes them in one."""
    weight = f"font-weight: {match['weight']}; " if match["weight"] else ""
    return f"{weight}font-size: {match['size']}px; font-family: inherit"


def _drop_empty(root: ET.Element) -> None:
    """Remove empty groups."""
    for parent in list(root.iter()):
        parent[:] = [child for child in parent if child.tag not in ("g", "defs") or len(child)]


def _dress(root: ET.Element, title: str) -> None:
    width, height = (float(number) for number in root.attrib["viewBox"].split()[2:])
    root.attrib.clear()
    root.set("xmlns", _SVG)
    root.set("viewBox", f"0 0 {width:g} {height:g}")
    root.set("width", "100%")
    root.set("role", "img")
    root.set("aria-label", clean(title))
    style = f"max-width: {width * 96 / 72 * _SCALE:.0f}px; height: auto; stroke-linejoin: round; stroke-linecap: butt"
    root.set("style", style)
    heading = ET.Element("title")
    heading.text = clean(title)
    root.insert(0, heading)


def _overlay(tips: Sequence[Tip]) -> ET.Element:
    group = ET.Element("g", {"class": "tips", "fill": "none", "pointer-events": "all"})
    for tip in tips:
        ET.SubElement(group, tip.shape, {**tip.geometry, "data-tip": clean(tip.text)})
    return group
