"""Outputs of a report: a page or a PDF, and a folder of its figures and tables. Imports no plotting library."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lftkit.errors import InputError
from lftkit.support.atomic_output import check_output, write_text
from pointing_analysis.report.paper import PAGES, PAPERS, PDF, Paper, is_pdf, require_pdf

if TYPE_CHECKING:
    from pointing_analysis.report.content import ReportContent


@dataclass(frozen=True)
class ReportOutputs:
    """Files of a report.

    Parameters
    ----------
    path : file that ends in ``.html`` or ``.htm``, or in ``.pdf``; None for none
    paper : size of the pages of a PDF
    export : folder for the figures and tables; None for none
    """

    path: Path | None = None
    paper: Paper = "a4"
    export: Path | None = None

    def __bool__(self) -> bool:
        return self.path is not None or self.export is not None

    def check(self, what: str = "the report") -> None:
        """Refuse, before any work, files that cannot be written.

        Raises
        ------
        ValueError
            Another suffix, no place for a file, an unknown size of pages, or a PDF without its extra.
        """
        if self.paper not in PAPERS:
            raise InputError(f"paper must be {' or '.join(PAPERS)}, got {self.paper!r}")
        if self.path is not None:
            check_output(self.path, what, suffixes=(*PAGES, PDF))
            if is_pdf(self.path):
                require_pdf()
        if self.export is not None:
            check_output(self.export, "the folder of figures and tables", folder=True)

    def write(self, content: ReportContent) -> None:
        """Write the files; existing ones are replaced, and none is left half-written.

        Raises
        ------
        ValueError, OSError
            A file cannot be written.
        """
        from pointing_analysis.report.export import write_parts
        from pointing_analysis.report.html_page import page
        from pointing_analysis.report.pdf_file import write_pdf

        if self.path is not None and is_pdf(self.path):
            write_pdf(content, self.path, self.paper)
        elif self.path is not None:
            write_text(self.path, page(content))
        if self.export is not None:
            write_parts(content, self.export)


NO_REPORT = ReportOutputs()
"""No file."""
