"""Render a page as one HTML file: no network, no library."""

import base64
import hashlib
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from parking_exp import __version__

FOLDER = Path(__file__).parent


def render_html(template: Path, **values: Any) -> str:
    """Render a template that extends `base.html.j2`.

    Everything is escaped. The CSS and JS files that have the template's name become part of the
    page, after the files that all pages have. The browser runs no other script and loads nothing.

    Args:
        template: a file `NAME.html.j2` with `NAME.css` and `NAME.js` beside it.
        values: what the template names.
    """
    environment = Environment(
        loader=FileSystemLoader([template.parent, FOLDER]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["base64"] = to_base64
    name = template.name.partition(".")[0]
    style = _read(FOLDER / "base.css") + _read(template.with_name(f"{name}.css"))
    script = _read(FOLDER / "theme.js") + _read(template.with_name(f"{name}.js"))
    return environment.get_template(template.name).render(
        style=Markup(style),
        script=Markup(script),
        script_hash=to_base64(hashlib.sha256(script.encode()).digest()),
        version=__version__,
        **values,
    )


def to_base64(data: bytes) -> str:
    """Return bytes as text."""
    return base64.b64encode(data).decode()


def _read(path: Path) -> str:
    return path.read_text(encoding="utf-8")
