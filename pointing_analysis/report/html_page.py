"""A report as one self-contained HTML page, which needs no script and no network."""

from __future__ import annotations

from pathlib import Path

import jinja2

from pointing_analysis.report.content import ReportContent
from pointing_analysis.report.inline_svg import inline

TEMPLATE = Path(__file__).with_name("report.html.j2")


def page(content: ReportContent) -> str:
    """A report as HTML text, self-contained; the same content gives the same text."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["inline"] = inline
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(c=content)
