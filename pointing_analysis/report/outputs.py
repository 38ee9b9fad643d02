"""Outputs of a report: a page or a PDF, and a folder of its figures and tables. Imports no plotting library."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file, check_output, write_text
from pointing_analysis.formatting.latex import latex_table
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


def write_parts(content: ReportContent, folder: Path) -> list[Path]:
    """Write each figure and each table of a report into a folder; files that it replaces are never half-written.

    A table is ``NAME.tex`` (a ``tabular`` to include, with booktabs and array), ``NAME.csv`` and ``NAME.md``; a figure
    ``NAME.svg`` and ``NAME.pdf``, its curves ``NAME.csv``.

    Parameters
    ----------
    content : of the report
    folder : made as needed; other files in it stay

    Returns
    -------
    Paths of the files, in reading order.

    Raises
    ------
    ValueError
        The folder cannot be made or written to.
    """
    check_output(folder, "the folder of figures and tables", folder=True)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, data in _files(content):
        paths.append(folder / name)
        with atomic_file(paths[-1]) as temporary:
            temporary.write_bytes(data)
    return paths


def _files(content: ReportContent) -> Iterator[tuple[str, bytes]]:
    for picture in content.pictures:
        yield f"{picture.name}.svg", picture.svg
        yield f"{picture.name}.pdf", picture.pdf()
        if curves := picture.csv():
            yield f"{picture.name}.csv", curves
    for table in content.all_tables():
        if table.rows:
            yield f"{table.name}.tex", latex_table(table).encode()
            yield f"{table.name}.csv", table.csv().encode()
            yield f"{table.name}.md", f"{table.markdown()}\n".encode()
