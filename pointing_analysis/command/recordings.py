"""Recordings of `analyse`, `report` and `image`: options and opening."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from lftkit.errors import InputError
from pointing_analysis.command.output import chunk_limit

if TYPE_CHECKING:
    from pointing_analysis.read.recording import Recording
    from pointing_analysis.requirements.requirement import Requirement

R = TypeVar("R", bound="Recording")

TABLES = "CSV, Parquet, .mat, HDF5, .npy, .npz"

Bags = Annotated[list[Path], typer.Argument(help=f"Bags (folders or .mcap files), or tables: {TABLES}.")]
Bag = Annotated[Path, typer.Argument(help=f"Bag (folder or .mcap file), or table: {TABLES}.")]
Los = Annotated[
    str | None,
    typer.Option(help="Line of sight: topic or topic.field of another bag, two columns of a table.", metavar="NAME"),
]
Unit = Annotated[
    str | None,
    typer.Option(
        help="Its unit: rad, mrad, urad, nrad, deg, mdeg, arcmin, arcsec or mas; default: from header or attribute."
    ),
]
Rate = Annotated[float | None, typer.Option(help="Its sampling rate [Hz]; default: from the time stamps.")]
Requirements = Annotated[
    Path | None, typer.Option(help="TOML or YAML file of requirements; default: those in the bag, else none.")
]
OpticsFile = Annotated[
    Path | None,
    typer.Option(
        "--optics",
        metavar="FILE",
        help="TOML file with a table optics: aperture, wavelength, pixel; default: the bag's.",
    ),
]


def require_different(bags: Sequence[Path]) -> None:
    """Reject a recording that is given twice, also as a copy: it would count as another run.

    Raises
    ------
    ValueError
        The message names both; or a recording does not exist.
    """
    from pointing_analysis.read.mcap.bag_files import bag_files, files_digest

    known: dict[tuple[int, str], Path] = {}
    files = [bag_files(bag).files for bag in bags]
    sizes = [sum(file.stat().st_size for file in each) for each in files]
    for bag, each, size in zip(bags, files, sizes, strict=True):
        same = known.setdefault((size, files_digest(each) if sizes.count(size) > 1 else ""), bag)
        if same is not bag:
            raise InputError(f"recordings must be distinct, got {bag}, which is the same as {same}")


def open_runs(
    bags: Sequence[Path], opener: Callable[[Path, int], R], max_chunk: float, optics: Path | None = None
) -> list[R]:
    """Open recordings; those of a file replace their optics.

    Parameters
    ----------
    bags : sequence of Path
    opener : callable
        Opens one, with the largest chunk that is unpacked [byte].
    max_chunk : float
        ``--max-chunk`` [MB].
    optics : Path, optional
        ``--optics``.
    """
    from pointing_analysis.image.optics import load_optics, with_optics

    seen = None if optics is None else load_optics(optics)
    limit = chunk_limit(max_chunk)
    runs = [opener(bag, limit) for bag in bags]
    return runs if seen is None else [with_optics(run, *seen) for run in runs]


def check_bag(path: Path) -> None:
    """Reject a file of a format that another command reads; unknown formats are left to the bag reader.

    Raises
    ------
    ValueError
        It names the format and the command that takes it.
    """
    from pointing_analysis.read.tables.formats import Format, format_of

    try:
        kind_of_path = format_of(path) if path.is_file() else Format.BAG
    except InputError:
        return
    if kind_of_path is not Format.BAG:
        kind = "CSV or other text" if kind_of_path is Format.CSV else kind_of_path.value
        raise InputError(
            f"{path} must be a bag (folder or .mcap file), got {kind}; `analyse FILE --output PAGE` evaluates tables"
        )


def requirements_in(file: Path | None, stages: Sequence[str] = ()) -> tuple[Requirement, ...] | None:
    """Requirements of ``--requirements``; None where none is given: those of each recording hold.

    `stages` are those of a loop that a requirement may be limited to.
    """
    from pointing_analysis.requirements.requirement import load

    return None if file is None else load(file, stages)


def check_exposures(run: Recording, requirements: Sequence[Requirement], transient: float | None) -> None:
    """Refuse requirements of images whose exposure is longer than a recording without its start-up.

    Raises
    ------
    ValueError
        There is one.
    """
    from pointing_analysis.indices.errors import performance_error

    longest = max((r.times[0] for r in requirements if r.of_image), default=0.0)
    if longest and longest > (there := performance_error(run, transient).duration):
        raise InputError(f"{run.path}: exposure must be at most the {there:g} s of the run, got {longest:g} s")
