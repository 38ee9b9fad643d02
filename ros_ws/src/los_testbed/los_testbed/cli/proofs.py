"""Command ``los-testbed design check-proof``."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated

import typer

from los_testbed.cli.options import Json
from los_testbed.cli.output import print_json

CHECK_PROOF_EXAMPLES = """Verify a proof of a worst-case gain or of robust stability.

The check has its own short code (`robust_design/certified/checker.py`): it optimises nothing. Exit code 1 if the
proof is refused.

**Example**

    los-testbed design check-proof proof.json
"""


def check_proof(file: Annotated[Path, typer.Argument(help="Proof file (JSON).")], json_: Json = False) -> None:
    """See CHECK_PROOF_EXAMPLES."""
    from lti.threads import one_thread
    from robust_design.certified.checker import ProofError
    from robust_design.certified.checker import check_proof as check

    if not file.exists():
        raise ValueError(f"FILE must be a proof file, got {file}, which does not exist")
    try:
        with one_thread():
            checked = check(file)
    except ProofError as error:
        sys.stderr.write(f"refused: {error}\n")
        raise typer.Exit(1) from None
    band = [checked.band[0], None if math.isinf(checked.band[1]) else checked.band[1]]
    if json_:
        print_json({**vars(checked), "band": band, "margin": min(checked.margin, 1e300)})
        return
    box = ", ".join(f"{name} in [{low:.6g}, {high:.6g}]" for name, (low, high) in checked.box.items())
    frequencies = f"from {checked.band[0]:g} rad/s " + ("on" if band[1] is None else f"to {band[1]:g} rad/s")
    if checked.kind == "gain":
        sys.stdout.write(f"proven: gain below {checked.level:.6g} at all frequencies {frequencies}\n")
    if checked.stable:
        sys.stdout.write("proven: stable\n")
    sys.stdout.write(f"for all {box or 'parameters (there are none)'}\n")
    sys.stdout.write(f"{checked.cells} cells; smallest margin {checked.margin:.3g} times the bound of all rounding\n")
