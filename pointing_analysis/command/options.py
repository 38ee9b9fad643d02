"""Options that several commands have."""

from __future__ import annotations

from typing import Annotated

import typer

MAX_CHUNK_MB = 64.0

Json = Annotated[bool, typer.Option("--json", help="Last line of output is one JSON object.")]
Gate = Annotated[
    bool,
    typer.Option("--gate", help="Exit code 7 if a requirement is not met, 8 if one is not demonstrated."),
]
From = Annotated[float, typer.Option("--from", metavar="SECONDS", help="Start of the evaluated part of each bag [s].")]
To = Annotated[
    float,
    typer.Option("--to", metavar="SECONDS", help="End of the evaluated part of each bag [s].", show_default=False),
]
MaxChunk = Annotated[float, typer.Option(metavar="MB", help="Largest chunk of a bag that is unpacked [MB].")]
Transient = Annotated[
    float | None,
    typer.Option(help="Start-up to exclude [s]; default: from the bag, else 5, at most half."),
]
