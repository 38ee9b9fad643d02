"""One entry to the checks of all kinds of proofs. It and what it imports optimise nothing and find no proof."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.axis.checker import check_axis_proof
from lftkit.proofs.axis.proof import FORMAT as AXIS
from lftkit.proofs.axis.proof import AxisProof
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
from lftkit.proofs.verdict import CheckedProof

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
    if not path.is_file():
        raise ProofError(f"the proof must be an ordinary file, got {path}")
    try:
        if zipfile.is_zipfile(path):
            with np.load(path, allow_pickle=False) as archive:
                header = json.loads(bytes(archive["header"]).decode())
        else:
            header = json.loads(path.read_text("utf-8"))
        name = header["format"]
    except Exception as error:  # of a damaged file numpy raises a dozen kinds, that of its tokenizer included
        raise ProofError(f"the file must be a proof, got {type(error).__name__}") from None
    if name not in FORMATS:
        raise ProofError(f"format must be one of {', '.join(map(repr, FORMATS))}, got {name!r}")
    return str(name)
