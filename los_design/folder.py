"""Folder of a design: the controllers, the telescope that they were made for, and copies of the files that it names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from shutil import rmtree

from lftkit import SampledSystem
from lftkit.errors import InputError
from lftkit.support.atomic_output import atomic_file
from los_design.copied_files import with_files_beside
from los_design.files import CONTROLLERS, ROUNDS, TELESCOPE
from los_design.synthesis.store import shipped
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.tables.parameter_check import BASE, REFERENCE_NAME
from titop_plant.telescope.tables.uncertain import UNCERTAIN
from titop_plant.telescope.telescope import Telescope


def load_folder(folder: Path) -> tuple[Telescope, SampledSystem, SampledSystem]:
    """Telescope, K_FSM and K_PMA of a folder.

    Raises
    ------
    InputError
        No folder, or a file that is missing or cannot be read.
    """
    if not folder.is_dir():
        raise InputError(
            f"--designs must be a folder with {' and '.join(CONTROLLERS.values())}, got no folder {folder}"
        )
    file = folder / TELESCOPE
    k_fsm, k_pma = (SampledSystem.from_file(folder / name) for name in CONTROLLERS.values())
    return load_telescope(file if file.exists() else None), k_fsm, k_pma


def refuse_shipped(output: Path | None, what: str) -> Path:
    """Path of an output that overwrites no design of the packages.

    Raises
    ------
    InputError
        There is no output, or it is one of a shipped design.
    """
    if output is None:
        raise InputError(f"--output must be given: {what}; shipped designs are never overwritten")
    for path in (output, *(output / name for name in CONTROLLERS.values())):
        if shipped(path):
            raise InputError(f"--output must not be a shipped design, got {path}")
    return output


def store_telescope(folder: Path, parameters: Path | None, uncertain: Sequence[str] = ()) -> None:
    """Make a folder for the designs of a telescope, with its parameter file and copies of the files that it names.

    Parameters
    ----------
    folder : Path
        New, or of designs of the same telescope.
    parameters : Path or None
        Parameter file; None for the reference telescope.
    uncertain : sequence of str
        Further uncertain factors, as ``isolator.stiffness=10%``: the table ``[uncertain]`` of the file that is stored.

    Raises
    ------
    InputError
        The path is a file, a folder of another telescope's designs, or not writable.
    """
    loaded = load_telescope(parameters)
    telescope = loaded.with_uncertain(uncertain)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"--output must be a folder, got the file {folder}")
    stored = folder / TELESCOPE
    if stored.exists() and load_telescope(stored).parameters_hash != telescope.parameters_hash:
        raise InputError(f"--output must be a folder without designs of another telescope, got {folder}")
    if uncertain and loaded.factors:
        raise InputError(f"--uncertain must be in the table [{UNCERTAIN}] of {parameters}, got the option")
    text, beside = (f'{BASE} = "{REFERENCE_NAME}"\n', {}) if parameters is None else with_files_beside(parameters)
    if uncertain:
        table = "".join(f"{name} = {spread!r}\n" for name, spread in telescope.spreads.items())
        text = f"{text}\n[{UNCERTAIN}]\n{table}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if stored.exists() and parameters is not None and stored.samefile(parameters) and not uncertain:
            return
        if parameters is None and not uncertain:  # the folder is of the reference
            return
        # The files that the telescope names are there before it
        for name, content in {**beside, TELESCOPE: text.encode()}.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            with atomic_file(folder / name) as temporary:
                temporary.write_bytes(content)
    except OSError as error:
        raise InputError(f"--output must be a writable folder, got {folder}: {error.strerror}") from None


@contextmanager
def removed_if_refused(folder: Path, new: bool) -> Iterator[None]:
    """A new folder that holds only the telescope's files is removed where the design refuses its input."""
    try:
        yield
    except InputError:
        if new and not any((folder / name).exists() for name in (*CONTROLLERS.values(), ROUNDS)):
            rmtree(folder, ignore_errors=True)
        raise
