"""One check of proofs of all kinds. It and what it imports optimise nothing and find no proof."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lftkit.proofs.axis.proof import KIND as AXIS
from lftkit.proofs.axis.proof import AxisProof, axis_proof
from lftkit.proofs.lower_bound import KIND as LOWER_BOUND
from lftkit.proofs.lower_bound import LowerBoundProof, lower_bound_proof_of
from lftkit.proofs.proof_files import Content
from lftkit.proofs.sampled_loop.files import LOOP, NOISE, loop_proof, noise_proof
from lftkit.proofs.trusted.axis import check_axis_proof
from lftkit.proofs.trusted.cells import KIND as CELLS
from lftkit.proofs.trusted.cells import check_cells
from lftkit.proofs.trusted.digests import plant_digest
from lftkit.proofs.trusted.entries import FORMAT, file_content
from lftkit.proofs.trusted.loop import Loop
from lftkit.proofs.trusted.lower_bound import CheckedLowerBound, check_lower_bound
from lftkit.proofs.trusted.noise import CheckedNoise, NoiseProof, check_noise_proof
from lftkit.proofs.trusted.proof import CheckedProof, Each, ProofFileError, require
from lftkit.proofs.trusted.sampled_loop import CheckedLoop, LoopProof, check_loop_proof
from lftkit.proofs.trusted.structured import check_mu as trusted_check_mu
from lftkit.systems.arguments import checked

Checked = CheckedProof | CheckedLoop | CheckedNoise | CheckedLowerBound


class ProofKind(NamedTuple):
    """A kind of proofs: how one is made of a file's content, its type, its check."""

    made: Callable[[Content], Any]
    type: type
    check: Callable[[Any, Each], Checked]


def _cells(content: Content) -> dict[str, Any]:
    header, arrays = content
    require(not arrays, f"a proof by cells must have no arrays, got {sorted(arrays)}"[:300])
    return header


KINDS = {
    CELLS: ProofKind(_cells, dict, lambda proof, each: check_cells(proof)),
    AXIS: ProofKind(axis_proof, AxisProof, check_axis_proof),
    LOOP: ProofKind(loop_proof, LoopProof, check_loop_proof),
    NOISE: ProofKind(noise_proof, NoiseProof, check_noise_proof),
    LOWER_BOUND: ProofKind(lower_bound_proof_of, LowerBoundProof, lambda proof, each: check_lower_bound(proof)),
}

check_mu = checked(trusted_check_mu)
"""The check of a certificate of mu, which names an argument of another type: what is trusted imports no such check."""


@checked
def check_proof(proof: Any, each: Each = map, system: Any = None) -> Checked:
    """Verify a proof of any kind; a ProofError says why it is refused.

    Parameters
    ----------
    proof : Path, str, dict, Proof, AxisProof, LoopProof, NoiseProof or LowerBoundProof
        A file, the content of one, or the `proof` of bounds.
    each : callable
        Maps a function over the strips of a proof, which may be checked in several processes.
    system : System, or what :func:`lftkit.systems.exchange.as_system` takes; Loop, optional
        The plant that the proof must be about, number by number: with the ports whose gain is bounded; a plant with its
        controller's ports for a lower bound, the model of a loop for proofs of it.

    Returns
    -------
    CheckedProof, CheckedLoop, CheckedNoise or CheckedLowerBound
        What it guarantees: of an uncertain system, a sampled loop, noise in one, or of all controllers of a plant. Its
        `plant` is the digest of what was checked: whoever hands over a proof can have chosen another plant.

    Raises
    ------
    ProofError
        It is no proof, it is damaged, what it claims does not follow, or it is of another plant than `system`.

    Examples
    --------
    >>> from lftkit import RealParameter, System
    >>> from lftkit.proofs import robust_stability
    >>> p = RealParameter("p", 0.0, -0.5, 0.5)
    >>> one = [[1.0]], [[1.0]], [[0.0]]
    >>> lag, slow = (System([[-a]], *one, (), (), channels=("p",), elements=(p,)) for a in (1.0, 0.9))
    >>> proof = robust_stability(lag).proof
    >>> len(check_proof(proof, system=lag).plant)
    32
    >>> check_proof(proof, system=slow)
    Traceback (most recent call last):
    ...
    lftkit.proofs.trusted.proof.ProofError: the proof must be of the given system, got one of another plant
    """
    claim = _checked(proof, each)
    same = system is None or claim.plant in _digests(system, claim)
    require(same, "the proof must be of the given system, got one of another plant")
    return claim


def _digests(system: Any, claim: Checked) -> set[str]:
    """Digests that a claim of this kind about a plant has; over the axis its dynamics are square."""
    from lftkit.proofs.state_space.disks import disks_of, real_first  # a check alone loads nothing of what finds proofs
    from lftkit.systems.exchange import as_system

    if isinstance(claim, (CheckedLoop, CheckedNoise)):
        return {system.digest} if isinstance(system, Loop) else set()
    plant = as_system(system)
    if isinstance(claim, CheckedLowerBound):
        return {plant_digest(float(plant.dt), (), {}, {}, [np.asarray(matrix) for matrix in plant.matrices])}
    chosen = real_first(plant.select(inputs=(), outputs=()) if claim.kind == "stability" else plant)
    nominal = {p.name: p.nominal for p in chosen.parameters}
    sizes = {disk.name: (disk.outputs, disk.inputs) for disk in disks_of(chosen)}
    square = {name: (max(shape),) * 2 for name, shape in sizes.items()}
    matrices = [np.asarray(getattr(chosen, name)) for name in "ABCD"]
    return {plant_digest(float(chosen.dt), chosen.channels, nominal, each, matrices) for each in (sizes, square)}


def _checked(proof: Any, each: Each) -> Checked:
    for kind in KINDS.values():
        if isinstance(proof, kind.type) and not isinstance(proof, dict):
            return kind.check(proof, each)
    content: Content
    if isinstance(proof, (str, Path)):
        content = file_content(Path(proof))
    else:
        header = getattr(proof, "content", proof)
        require(isinstance(header, Mapping), f"proof must be a file or the proof of bounds, got {type(proof).__name__}")
        content = dict(header), {}
    kind = KINDS[kind_of(content)]
    return kind.check(kind.made(content), each)


def kind_of(content: Content) -> str:
    """Kind of a proof, one of :data:`KINDS`, as its header says.

    Raises
    ------
    ProofFileError
        No header of a proof.
    """
    header = content[0]
    kind = header.get("kind") if isinstance(header, dict) and header.get("format") == FORMAT else None
    if not isinstance(kind, str) or kind not in KINDS:
        raise ProofFileError(f"the header must be one of {FORMAT!r}, kind {', '.join(KINDS)}, got {kind!r}"[:400])
    return kind


def proof_kind(path: Path) -> str:
    """Kind of the proof in a file; errors as of :func:`kind_of`."""
    return kind_of(file_content(path))
