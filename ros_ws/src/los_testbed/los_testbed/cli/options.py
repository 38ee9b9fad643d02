"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from los_testbed.variants import of_designs

MAX_CHUNK_MB = 64.0

Json = Annotated[bool, typer.Option("--json", help="Last line of output is one JSON object.")]
MaxChunk = Annotated[float, typer.Option(metavar="MB", help="Largest chunk of a bag that is unpacked [MB].")]
Transient = Annotated[
    float | None,
    typer.Option(help="Seconds to leave out at the start; default: as the bag says, else 5, at most half."),
]
Requirements = Annotated[
    Path | None, typer.Option(help="TOML or YAML file of requirements. Default: those of the reference telescope.")
]
Telescope = Annotated[Path | None, typer.Option(metavar="FILE", help="Parameter file of your telescope.")]
Designs = Annotated[str | None, typer.Option(metavar="FOLDER", help="Controllers and telescope of `design all`.")]
ObserverFile = Annotated[Path | None, typer.Option(help="Observer file instead of the stored design.")]
ForceLawFile = Annotated[Path | None, typer.Option(help="Proof-mass controller file instead of the stored design.")]
Case = Annotated[str | None, typer.Option(metavar="NAME", help="A named case: los-testbed plant cases.")]
Cases = Annotated[Path | None, typer.Option(help="YAML file of named cases of your own.")]
NewFolder = Annotated[Path | None, typer.Option(help="New folder; default: one under bags/.")]
DesignSeed = Annotated[int, typer.Option(help="Seed of starts and searches.")]


def with_files(designs: str | None, **files: Path | None) -> dict[str, Any]:
    """Settings from a folder of designs and from files that are named one by one, which win.

    Raises
    ------
    ValueError
        The folder lacks a controller.
    """
    return {**of_designs(designs or ""), **{name: str(path) for name, path in files.items() if path is not None}}
