"""Check of a proof of a sampled loop: its gain over a box of parameters and a band of frequencies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lftkit.proofs.trusted.premises import require_premises
from lftkit.proofs.trusted.proof import Box, Interval, ProofError, require_cover
from lftkit.proofs.trusted.stability import stable_below
from lftkit.proofs.trusted.strips import check_strip

if TYPE_CHECKING:
    from lftkit.proofs.trusted.given import LoopProof

FAULTS = (KeyError, TypeError, ValueError, IndexError, ArithmeticError, AttributeError, RecursionError)
"""What a damaged proof may raise."""


@dataclass(frozen=True)
class CheckedLoop:
    """What a proof that passed guarantees."""

    level: float
    names: tuple[str, ...]
    box: Box
    band: Interval
    strips: int
    windows: int
    about: dict[str, Any]
    stable_below: float
    """No pole crosses the axis up to this frequency [rad/s] and the nominal loop was proven stable: infinite if
    `stable`, zero if nothing was proven of stability.
    """

    @property
    def stable(self) -> bool:
        """Every member: the nominal loop was proven stable, and no pole crosses the axis."""
        return math.isinf(self.stable_below)


def check_loop_proof(
    proof: LoopProof, each: Callable[..., Iterable[int | str]] = map, stability: bool = True
) -> CheckedLoop:
    """Verify a proof of a loop; a ProofError says why it is refused.

    Parameters
    ----------
    proof : LoopProof
    each : callable
        Maps a function over the strips; they may be checked in several processes.
    stability : bool
        Whether stability is looked at, too; without it the result says that nothing was proven of it.
    """
    try:
        windows = checked_windows(proof, each)
        below = stable_below(proof.model, proof.band, proof.box) if stability else 0.0
        about = dict(proof.about)
        return CheckedLoop(proof.level, proof.names, proof.box, proof.band, len(proof.strips), windows, about, below)
    except FAULTS as error:
        known = isinstance(error, ProofError)
        raise ProofError(str(error) if known else f"the file must be a proof of a loop, got {error!r}") from None


def checked_windows(proof: LoopProof, each: Callable[..., Iterable[int | str]] = map) -> int:
    """Windows with which premises, cover and the inequality of every strip were verified."""
    require_premises(proof)
    covered(proof)
    items = [(proof.model, strip, proof.level) for strip in proof.strips]
    windows = count = 0
    for count, outcome in enumerate(each(check_strip, items), 1):
        if isinstance(outcome, str):
            raise ProofError(f"strip {count - 1}: {outcome}")
        windows += outcome
    if count != len(items):
        raise ProofError(f"each of {len(items)} strips must be checked, got {count}")
    return windows


def covered(proof: LoopProof) -> None:
    """Whether the strips cover box and band; a ProofError names a hole."""
    require_cover(proof.strips, proof.box, proof.band, "rad/s")
