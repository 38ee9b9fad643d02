"""Check of a proof over the frequency axis: a gain, or stability, for a box of parameters.

The inequality of a strip is that of :mod:`lftkit.proofs.trusted.checker`, with responses of the system's own
matrices (:mod:`lftkit.proofs.axis.model`): negative definite at every frequency of the strip, it bounds the gain there,
and shows that no member has a pole on the axis. Strips over the inverse of the frequency include infinity, where
it shows that all members are well posed. With a stable nominal member in the box every member is then stable, as poles
move continuously.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np

from lftkit.proofs.axis.model import AxisModel
from lftkit.proofs.axis.proof import AxisProof
from lftkit.proofs.blocks.structure import COMPLEX, FULL, REAL
from lftkit.proofs.checked_proof import CheckedProof
from lftkit.proofs.trusted.premises import indices, require_strip
from lftkit.proofs.trusted.proof import Interval, ProofError, Strip, require_cover
from lftkit.proofs.trusted.strips import check_strip


def check_axis_proof(proof: AxisProof | Path, each: Callable[..., Iterable[int | str]] = map) -> CheckedProof:
    """Verify a proof; a ProofError says why it is refused.

    Parameters
    ----------
    proof : AxisProof or Path
    each : callable
        Maps a function over the strips; they may be checked in several processes.

    Returns
    -------
    CheckedProof
        `cells` is the number of windows of frequency; a strip that passes has a margin of 1 at least.
    """
    proof = AxisProof.from_file(proof) if isinstance(proof, Path) else proof
    try:
        with np.errstate(all="ignore"):  # what is not finite is an ArithmeticError
            return _checked(proof, each)
    except (KeyError, TypeError, ValueError, IndexError, ArithmeticError, AttributeError, RecursionError) as error:
        known = isinstance(error, ProofError)
        raise ProofError(str(error) if known else f"the file must be a proof, got {error!r}") from None


def _checked(proof: AxisProof, each: Callable[..., Iterable[int | str]]) -> CheckedProof:
    level = _require_claim(proof)
    _require_matrices(proof)
    low, high = proof.band
    windows, infinite = 0, math.isinf(high)
    parts: list[tuple[bool, tuple[Strip, ...], Interval, str]] = [
        (False, proof.below, (low, proof.border if infinite else high), "rad/s")
    ]
    if infinite:
        parts.append((True, proof.above, (0.0, 1.0 / proof.border), "s/rad"))
    for beyond, strips, band, unit in parts:
        windows += _check_part(proof.model(beyond), strips, proof.deviations, band, unit, level, each)
    inside = all(a <= 0.0 <= b for a, b in proof.deviations)
    stable = proof.band == (0.0, math.inf) and inside and proof.model(False).nominal_stable()
    if proof.kind == "stability" and not stable:
        raise ProofError("a proof of stability needs the whole axis and a stable nominal member in the box")
    named = list(zip(proof.names, proof.kinds, proof.box))
    box = {name: ends for name, kind, ends in named if kind == REAL}
    disks = {name: ends[1] for name, kind, ends in named if kind != REAL}
    return CheckedProof(proof.kind, proof.level, box, proof.band, windows, 1.0, stable, disks)


def _check_part(
    model: AxisModel,
    strips: Sequence[Strip],
    box: tuple[Interval, ...],
    band: Interval,
    unit: str,
    level: float,
    each: Callable[..., Iterable[int | str]],
) -> int:
    """Windows in which the strips of one part of the axis were verified."""
    if band[0] == band[1]:
        return 0
    for number, strip in enumerate(strips):
        require_strip(number, strip, model)
        _require_disks(number, strip, model.kinds)
    require_cover(strips, box, band, unit)
    windows = 0
    for number, outcome in enumerate(each(check_strip, [(model, strip, level) for strip in strips])):
        if isinstance(outcome, str):
            raise ProofError(f"strip {number}: {outcome}")
        windows += outcome
    return windows


def _require_disks(number: int, strip: Strip, kinds: Sequence[str]) -> None:
    """Scalings of complex and dynamic elements, whose terms are not negative for any value in the whole disk.

    In an interval [-r, r] the term of a strip is ``2 (r^2 z* D z - w* D w)`` and what G adds. Without G it holds for
    ``w = delta z`` with every complex delta up to r; where D is a number, for ``w = Delta z`` with every matrix of norm
    up to r.
    """
    for kind, (low, high), D, G in zip(kinds, strip.box, strip.D, strip.G):
        if kind == REAL:
            continue
        single = kind == COMPLEX or np.array_equal(D, D[:, :1, :1] * np.eye(D.shape[-1]))
        if low != -high or np.any(G) or not single:
            raise ProofError(f"strip {number} must have a whole disk, G zero and D of its kind for {kind} elements")


def _require_claim(proof: AxisProof) -> float:
    """A kind, a level, a band, a border and a box that make sense; the level of the inequality."""
    if proof.kind not in ("gain", "stability"):
        raise ProofError(f"a proof must be of a gain or of stability, got {proof.kind!r}")
    level = 1.0 if proof.kind == "stability" else proof.level
    if level is None or not 0.0 < level < math.inf or (proof.kind == "stability" and proof.level is not None):
        raise ProofError(f"a gain must have a positive level and stability none, got {proof.level}")
    low, high = proof.band
    if not 0.0 <= low < high:
        raise ProofError(f"a band must be two frequencies with 0 <= lower < upper, got {proof.band}")
    border = proof.border
    if not (2.0**-500 < border < 2.0**500 and math.frexp(border)[0] == 0.5 and (low <= border or high < math.inf)):
        raise ProofError(f"the border must be a power of two above the band's lower end, got {border}")
    count = len(proof.groups)
    if not len(proof.names) == len(set(proof.names)) == len(proof.nominal) == len(proof.box) == count:
        raise ProofError("each parameter must have a name of its own, a nominal value and an interval")
    disks = [ends == (-ends[1], ends[1]) and at == 0.0 for ends, at, kind in _disks_of(proof)]
    if len(proof.kinds) != count or not {*proof.kinds} <= {REAL, COMPLEX, FULL} or not all(disks):
        raise ProofError("each element must be real, or a disk about zero")
    numbers = [*proof.nominal, *(end for ends in proof.box for end in ends)]
    if not all(map(math.isfinite, numbers)) or not all(low <= high for low, high in proof.box):
        raise ProofError(f"intervals must be finite with lower <= upper, got {proof.box}")
    return level


def _disks_of(proof: AxisProof) -> list[tuple[Interval, float, str]]:
    """Interval, nominal value and kind of the elements that are not real."""
    return [each for each in zip(proof.box, proof.nominal, proof.kinds) if each[2] != REAL]


def _require_matrices(proof: AxisProof) -> None:
    """Finite matrices that fit to each other; every channel belongs to one parameter."""
    n, q = len(proof.A), sum(len(group) for group in proof.groups)
    rows, columns = proof.D.shape
    shapes: dict[str, tuple[int, ...]] = {"A": (n, n), "B": (n, columns), "C": (rows, n), "D": (rows, columns)}
    shapes |= {"poles": (n,), "T": (n, n), "X": (n, n)}
    for name, shape in shapes.items():
        array, kind = getattr(proof, name), np.float64 if name in "ABCD" else np.complex128
        if array.shape != shape or array.dtype != kind or not np.all(np.isfinite(array)):
            raise ProofError(f"{name} must be finite, of shape {shape} and type {kind.__name__}, got another")
    channels = [channel for group in proof.groups for channel in group]
    if not indices(channels, q) or len({*channels}) != q:
        raise ProofError("every channel must belong to one parameter")
    others = (rows - q, columns - q)
    if min(others) < 0 or (proof.kind == "gain" and not all(others)) or (proof.kind == "stability" and any(others)):
        raise ProofError(f"a gain needs outputs and inputs, stability has none, got {others}")
