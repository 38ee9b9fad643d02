"""One check of proofs of all kinds. It and what it imports optimise nothing and find no proof."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from lftkit.proofs.axis.proof import KIND as AXIS
from lftkit.proofs.axis.proof import AxisProof, axis_proof
from lftkit.proofs.earlier_files import present_header
from lftkit.proofs.lower_bound import KIND as LOWER_BOUND
from lftkit.proofs.lower_bound import LowerBoundProof, lower_bound_proof_of
from lftkit.proofs.proof_files import Content, read_content
from lftkit.proofs.sampled_loop.files import LOOP, NOISE, loop_proof, noise_proof
from lftkit.proofs.trusted.axis import check_axis_proof
from lftkit.proofs.trusted.cells import KIND as CELLS
from lftkit.proofs.trusted.cells import check_cells
from lftkit.proofs.trusted.entries import FORMAT
from lftkit.proofs.trusted.lower_bound import CheckedLowerBound, check_lower_bound
from lftkit.proofs.trusted.noise import CheckedNoise, NoiseProof, check_noise_proof
from lftkit.proofs.trusted.proof import CheckedProof, Each, ProofFileError, require
from lftkit.proofs.trusted.sampled_loop import CheckedLoop, LoopProof, check_loop_proof
from lftkit.proofs.trusted.structured import check_mu as trusted_check_mu
from lftkit.systems.arguments import checked

Checked = CheckedProof | CheckedLoop | CheckedNoise | CheckedLowerBound


class ProofKind(NamedTuple):
    """What belongs to a kind of proofs: the proof of a file's content, its type, its check."""

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
def check_proof(proof: Any, each: Each = map) -> Checked:
    """Verify a proof of any kind; a ProofError says why it is refused.

    Parameters
    ----------
    proof : Path, str, dict, Proof, AxisProof, LoopProof, NoiseProof or LowerBoundProof
        A file, the content of one, or the `proof` of bounds.
    each : callable
        Maps a function over the strips of a proof, which may be checked in several processes.

    Returns
    -------
    CheckedProof, CheckedLoop, CheckedNoise or CheckedLowerBound
        What it guarantees: of an uncertain system, a sampled loop, noise in one, or of all controllers of a plant.

    Raises
    ------
    ProofError
        It is no proof, it is damaged, or what it claims does not follow.
    """
    for kind in KINDS.values():
        if isinstance(proof, kind.type) and not isinstance(proof, dict):
            return kind.check(proof, each)
    content: Content
    if isinstance(proof, (str, Path)):
        content = read_content(Path(proof))
    else:
        header = getattr(proof, "content", proof)
        require(isinstance(header, Mapping), f"proof must be a file or the proof of bounds, got {type(proof).__name__}")
        content = present_header(header), {}
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
    return kind_of(read_content(path))
