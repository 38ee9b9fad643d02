"""Outputs of ``los-testbed run`` besides the report: signature of the bag, trace of its ticks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lftkit.errors import InputError
from los_testbed.config.run_config import RunConfig
from pointing_analysis.command.screen import Screen, say

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey


def sign(console: Screen, bag: Path, key: Ed25519PrivateKey) -> bool:
    """Sign the bag of a run; a bag that is not whole is not signed."""
    from los_testbed.bags.check import sign_bag

    try:
        say(console, f"signature {sign_bag(bag, key)}")
    except ValueError as error:
        say(console, f"not signed: {error}", "warning")
        return False
    return True


def check_trace(path: Path, config: RunConfig) -> None:
    """Reject, before the run, a trace that cannot be written after it.

    Raises
    ------
    ValueError
        A run that is not in real time, a path that is taken or cannot be written.
    """
    from lftkit.support.atomic_output import check_output

    if config.mode != "realtime":
        raise InputError(f"mode must be realtime with --trace, got {config.mode}")
    check_output(path, "--trace", new=True)
    if path.absolute() == config.bag.absolute():
        raise InputError(f"--trace must be a file beside the bag, got the name of the bag, {path}")


def write_ticks(console: Screen, bag: Path, path: Path) -> bool:
    """Write the trace of a run's ticks; a bag without a tick has none."""
    from los_testbed.bags.trace import write_trace
    from pointing_analysis.read.run import Run

    try:
        ticks, late = write_trace(Run.open(bag), path)
    except (ValueError, OSError) as error:
        say(console, f"no trace: {error}", "warning")
        return False
    say(console, f"trace   {ticks} ticks, {late} without commands within their period: {path}")
    return True
