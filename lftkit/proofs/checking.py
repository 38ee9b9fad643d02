"""One entry to the checks of all kinds of proofs. It and what it imports optimise nothing and find no proof."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from lftkit.proofs.axis.checker import check_axis_proof
from lftkit.proofs.axis.proof import FORMAT as AXIS
from lftkit.proofs.axis.proof import AxisProof
from lftkit.proofs.checked_proof import CheckedProof
from lftkit.proofs.entries import file_content
from lftkit.proofs.sampled_loop.files import FORMAT as LOOP
from lftkit.proofs.sampled_loop.files import read_loop_proof
from lftkit.proofs.sampled_loop.noise import FORMAT as NOISE
from lftkit.proofs.sampled_loop.noise import CheckedNoise, NoiseProof, check_noise_proof
from lftkit.proofs.state_space.checker import DISCRETE
from lftkit.proofs.state_space.checker import FORMAT as CELLS
from lftkit.proofs.state_space.checker import check_proof as check_cells
from lftkit.proofs.trusted.checker import CheckedLoop, check_loop_proof
from lftkit.proofs.trusted.given import LoopProof
from lftkit.proofs.trusted.proof import ProofError
from lftkit.support.format_names import current_name

FORMATS = (CELLS, DISCRETE, LOOP, AXIS, NOISE)


Checked = CheckedProof | CheckedLoop | CheckedNoise


def check_proof(proof: Any, each: Callable[..., Iterable[int | str]] = map) -> Checked:
    """Verify a proof of any kind; a ProofError says why it is refused.

    Parameters
    ----------
    proof : Path, str, dict, Proof, AxisProof, LoopProof or NoiseProof
        A file, the content of one, or the `proof` of bounds.
    each : callable
        Maps a function over the strips of a proof, which may be checked in several processes.

    Returns
    -------
    CheckedProof, CheckedLoop or CheckedNoise
        What it guarantees; the latter two for a proof of a sampled loop, or of noise in one.

    Raises
    ------
    ProofError
        It is no proof, it is damaged, or what it claims does not follow.
    """
    if isinstance(proof, (str, Path)):
        path = Path(proof)
        name = proof_format(path)
        return check_cells(path) if name in (CELLS, DISCRETE) else _check_strips(path, name, each)
    if isinstance(proof, AxisProof):
        return check_axis_proof(proof, each)
    if isinstance(proof, LoopProof):
        return check_loop_proof(proof, each)
    if isinstance(proof, NoiseProof):
        return check_noise_proof(proof, each)
    if isinstance(proof, Mapping) or hasattr(proof, "content"):
        return check_cells(proof)
    raise ProofError(f"proof must be a file or the proof of bounds, got {type(proof).__name__}")


def _check_strips(path: Path, name: str, each: Callable[..., Iterable[int | str]]) -> Checked:
    if name == NOISE:
        return check_noise_proof(NoiseProof.from_file(path), each)
    return check_loop_proof(read_loop_proof(path), each) if name == LOOP else check_axis_proof(path, each)


def proof_format(path: Path) -> str:
    """Name of the format that a file's header says, one of :data:`FORMATS`.

    Raises
    ------
    ProofError
        No such file, or no header of a proof.
    """
    header, _ = file_content(path)
    name = current_name(header.get("format")) if isinstance(header, dict) else None
    if name not in FORMATS:
        raise ProofError(f"format must be one of {', '.join(map(repr, FORMATS))}, got {name!r}"[:400])
    return str(name)
