"""Sizes of the pages of a PDF, and whether one can be made."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Literal

from lftkit.errors import InputError

Paper = Literal["a4", "letter"]
PAPERS: dict[Paper, str] = {"a4": "a4", "letter": "us-letter"}
"""Size of the pages -> its name in typst."""
PAGES, PDF = (".html", ".htm"), ".pdf"
"""Ends of the names of HTML pages, and of a PDF."""


def is_pdf(path: Path) -> bool:
    """Whether a report is to be a PDF, by the end of its name."""
    return path.suffix.lower() == PDF


def require_pdf() -> None:
    """Refuse a PDF that cannot be made.

    Raises
    ------
    ValueError
        typst is not installed; with the command that installs it.
    """
    if importlib.util.find_spec("typst") is None:
        raise InputError("typst must be installed for PDF reports: pip install 'los-testbed[pdf]'")
