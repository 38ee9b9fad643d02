"""A report as one self-contained HTML page, which needs no script and no network.

Its pictures are part of the page: their curves can be shown and hidden with the runs that they belong to.
"""

from __future__ import annotations

import re
from html import escape
from pathlib import Path

import jinja2
from markupsafe import Markup

from pointing_analysis.report.content import ReportContent
from pointing_analysis.report.figures import Picture

TEMPLATE = Path(__file__).with_name("report.html.j2")
DROPPED = re.compile(
    r"<\?xml.*?\?>|<!DOCTYPE.*?>|<!--.*?-->|<metadata>.*?</metadata>|\s+xmlns(?::\w+)?=\"[^\"]*\"", re.DOTALL
)
RUN = re.compile(r'<g id="(run-\d+)">')
"""Group of matplotlib for an artist with the gid of a run."""


def inline(picture: Picture) -> Markup:
    """SVG element for an HTML page: identifiers with the picture's name before them, gids of runs as classes.

    Examples
    --------
    >>> svg = b'<?xml version="1.0"?><svg xmlns="x"><g id="run-0"><use xlink:href="#a"/></g></svg>'
    >>> print(inline(Picture("psd", "", "a curve", svg)))
    <svg role="img" aria-label="a curve"><g class="run-0"><use xlink:href="#psd-a"/></g></svg>
    """
    text = RUN.sub(r'<g class="\1">', DROPPED.sub("", picture.svg.decode()))
    name = picture.name
    text = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', text)
    text = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    return Markup(text.strip().replace("<svg", f'<svg role="img" aria-label="{escape(picture.alt)}"', 1))


def page(content: ReportContent) -> str:
    """A report as HTML text, self-contained; the same content gives the same text."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["inline"] = inline
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(c=content)
