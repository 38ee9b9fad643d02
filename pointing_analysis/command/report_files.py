"""Options of `analyse` and `report` for the files of a report: format, size of the pages, figures and tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, cast

import typer

from lftkit.errors import InputError
from pointing_analysis.report.outputs import ReportOutputs
from pointing_analysis.report.paper import PAPERS, Paper, is_pdf

FORMATS = ("html", "pdf")

Format = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="html|pdf",
        help="Report format; default: pdf if its name ends in .pdf, else html. PDF needs the extra `pdf`.",
    ),
]
PaperSize = Annotated[str | None, typer.Option("--paper", metavar="a4|letter", help="Page size of a PDF; default: a4.")]
Export = Annotated[
    Path | None,
    typer.Option(
        "--export",
        metavar="FOLDER",
        help="Also write each figure (SVG, PDF, CSV) and each table (LaTeX, CSV, Markdown) into a folder.",
    ),
]


def report_files(
    output: Path | None, usual: Path | None, form: str | None, paper: str | None, export: Path | None
) -> ReportOutputs:
    """Files of a report by the options of a command, checked before any work.

    Parameters
    ----------
    output : Path or None
        ``--output``.
    usual : Path or None
        Where none is given; its ending is that of the format. None: no report without `usual` or `form`.
    form, paper : str or None
        ``--format``, ``--paper``.
    export : Path or None
        ``--export``.

    Raises
    ------
    ValueError
        An unknown format or size, a name that does not fit the format, a file that cannot be written.
    """
    _require("--format", form, FORMATS)
    _require("--paper", paper, tuple(PAPERS))
    if output is not None and form is not None and is_pdf(output) != (form == "pdf"):
        raise InputError(
            f"--output must {'' if form == 'pdf' else 'not '}end in .pdf with --format {form}, got {output}"
        )
    path = output
    if path is None and (usual is not None or form is not None):
        path = (usual or Path("report")).with_suffix(f".{form or FORMATS[0]}")
    if paper is not None and not (path is not None and is_pdf(path)):
        raise InputError(f"--paper must be given with a PDF report, got --paper {paper} without --format pdf")
    outputs = ReportOutputs(path, cast(Paper, paper or "a4"), export)
    outputs.check("--output" if output is not None else "the report")
    return outputs


def _require(option: str, value: str | None, known: Sequence[str]) -> None:
    if value is not None and value not in known:
        raise InputError(f"{option} must be {' or '.join(known)}, got {value!r}")
