"""Telescope and controllers of a folder of ``los-testbed design all``, and requirements that its designs ignore."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lftkit.errors import InputError
from los_testbed.config.run_settings import DESIGN_FILES, TELESCOPE_FILE

if TYPE_CHECKING:
    from lftkit import SampledSystem
    from titop_plant.telescope.telescope import Telescope


def designs_in(folder: Path) -> tuple[Telescope, SampledSystem, SampledSystem]:
    """Telescope and controllers of a folder of designs; the reference telescope where it names none.

    Raises
    ------
    ValueError
        No folder, or a file that is missing or cannot be read.
    """
    from lftkit import SampledSystem
    from titop_plant.telescope.load import load_telescope

    if not folder.is_dir():
        raise InputError(
            f"--designs must be a folder with {' and '.join(DESIGN_FILES.values())}, got no folder {folder}"
        )
    file = folder / TELESCOPE_FILE
    telescope = load_telescope(file if file.exists() else None)
    k_fsm, k_pma = (SampledSystem.from_file(folder / name) for name in DESIGN_FILES.values())
    return telescope, k_fsm, k_pma


def name_unseen_requirements(telescope: Telescope) -> None:
    """Write to the error output the requirements that no figure of a design covers, if any."""
    from titop_plant.telescope.requirements import unseen_by_design

    if unseen := [f"{one.name} ({one.exact_text})" for one in unseen_by_design(telescope.requirements)]:
        sys.stderr.write(f"requirements: the design does not consider {', '.join(unseen)}; runs are judged by them\n")
