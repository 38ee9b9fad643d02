"""Figures and tables of a report as files, for documents: SVG and PDF, LaTeX, CSV and Markdown."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from lftkit.support.atomic_output import atomic_file, check_output
from pointing_analysis.formatting.latex import latex_table
from pointing_analysis.report.content import ReportContent


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
