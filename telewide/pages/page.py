"""Pages from templates: single files that open from a disk or a mail, offline, in the reader's colours.

Where a page has a script, its content policy names that one by its hash, and allows no other.
Every value is escaped where a template shows it, but for ``Markup``: HTML that a template made.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from telewide.files import write_text
from telewide.text import with_options


def write_page(path: Path, template: str, **values: object) -> Path:
    """Write one HTML file.

    Args:
        path: of the file.
        template: name of a page's template, such as ``run.html.j2``.
        values: what it shows.

    Returns:
        The path.
    """
    write_text(path, _environment().get_template(template).render(**values))
    return path


def html_part(macro: str, **values: object) -> Markup:
    """Make a part of a page.

    Args:
        macro: its name in the template ``parts.html.j2``.
        values: its arguments.

    Returns:
        HTML.
    """
    return _filled("parts.html.j2", macro, values)


def chart_svg(macro: str, **values: object) -> Markup:
    """Draw a chart.

    Args:
        macro: its name in the template ``charts.svg.j2``.
        values: its arguments.

    Returns:
        A figure element.
    """
    return _filled("charts.svg.j2", macro, values)


def _filled(template: str, macro: str, values: Mapping[str, object]) -> Markup:
    module = _environment().get_template(template).module
    return Markup(getattr(module, macro)(**values))


@lru_cache(maxsize=1)
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("telewide.pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.policies["json.dumps_kwargs"] = {"sort_keys": False}
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    environment.filters["sha256"] = lambda text: base64.b64encode(hashlib.sha256(text.encode()).digest()).decode(
        "ascii"
    )
    environment.filters["px"] = lambda value: f"{value:.1f}"
    environment.filters["with_options"] = with_options
    return environment
