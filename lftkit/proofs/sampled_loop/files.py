"""Content of files of proofs of a sampled loop, and of noise in one."""

from __future__ import annotations

import itertools
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.proof_files import (
    Content,
    arrays_of,
    box_of_claim,
    header_entries,
    packed,
    unpacked,
    write_content,
)
from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.trusted.entries import (
    Form,
    array,
    each,
    file_content,
    fixed,
    header_of,
    index,
    mapping,
    number,
    pair,
    record,
    text,
    truth,
    word,
)
from lftkit.proofs.trusted.noise import NoisePart, NoiseProof
from lftkit.proofs.trusted.proof import Strip, require
from lftkit.proofs.trusted.sampled_loop import LoopProof

LOOP, NOISE = "sampled loop", "noise"
"""Kinds of proofs."""
MODEL: dict[str, Form] = {"groups": each(each(index)), "angle": each(truth), "rows": each(index), "commands": truth}
ADDED: dict[str, Form] = {"added": each(index), "returned": index}
"""Entries that a plant without such signals leaves out."""
COMPLEX, REAL, SCALAR = ("poles", "C", "B", "K_poles", "K_C", "K_B"), ("D", "K_D", "weights"), ("dt", "window", "scale")
ARRAYS: dict[str, Form] = {
    **{name: array("complex128", *(None,) * (1 if "poles" in name else 2)) for name in COMPLEX},
    **{name: array("float64", None, None) for name in REAL},
    **{name: array("float64") for name in SCALAR},
    "frame": array("int64", None),
}
OF_ARRAYS = tuple(f.name for f in fields(LoopModel) if f.name not in {**MODEL, **ADDED})
OTHERS: dict[str, Form] = {"plant": record({"parameters": each(text), **MODEL}, ADDED), "about": mapping(word)}
PART = fixed(each(index), number, number, number, index)
"""Rows, band, level and number of strips of a part of a bound of noise."""
GAIN_CLAIM = record({"property": text, "level": number, "band": pair, "box": mapping(pair)})
NOISE_CLAIM = record({"property": text, "parts": each(PART), "box": mapping(pair)})


def loop_proof(content: Content) -> LoopProof:
    """The proof of a file's content; a ProofError where it is none."""
    header, model, strips = _read(content, LOOP, GAIN_CLAIM, "gain")
    claim, names = header["claim"], header["plant"]["parameters"]
    return LoopProof(model, names, box_of_claim(header), claim["band"], claim["level"], strips, header["about"])


def noise_proof(content: Content) -> NoiseProof:
    """The proof of noise of a file's content; a ProofError where it is none."""
    header, model, read = _read(content, NOISE, NOISE_CLAIM, "noise")
    claim, names = header["claim"], header["plant"]["parameters"]
    complete = sum(count for *_, count in claim["parts"]) == len(read)
    require(complete, f"parts must have {len(read)} strips in all, got another number")
    strips = iter(read)
    parts = tuple(
        NoisePart(rows, (low, high), level, tuple(itertools.islice(strips, count)))
        for rows, low, high, level, count in claim["parts"]
    )
    return NoiseProof(model, names, box_of_claim(header), parts, header["about"])


def write_loop_proof(proof: LoopProof | NoiseProof, path: Path) -> None:
    """Write a proof of a loop, or of noise in one, as a compressed ``.npz``."""
    claim: dict[str, Any] = {"box": dict(zip(proof.names, proof.box))}
    if isinstance(proof, NoiseProof):
        kind, strips = NOISE, [strip for part in proof.parts for strip in part.strips]
        parts = [[part.rows, *part.band, part.level, len(part.strips)] for part in proof.parts]
        claim = {"property": "noise", "parts": parts, **claim}
    else:
        kind, strips = LOOP, list(proof.strips)
        claim = {"property": "gain", "level": proof.level, "band": proof.band, **claim}
    plant: dict[str, Any] = {"parameters": proof.names, **{name: getattr(proof.model, name) for name in MODEL}}
    if proof.model.added:
        plant |= {name: getattr(proof.model, name) for name in ADDED}
    arrays = {name: np.asarray(getattr(proof.model, name)) for name in OF_ARRAYS}
    header = header_entries(kind, claim, plant, about=dict(proof.about))
    write_content(path, (header, arrays | packed(strips, len(proof.names))))


def read_loop_proof(path: Path) -> LoopProof:
    """Read a proof; a ProofError where there is no such file, or it is none of a loop."""
    return loop_proof(file_content(path))


def read_noise_proof(path: Path) -> NoiseProof:
    """Read a proof of noise; errors as of :func:`read_loop_proof`."""
    return noise_proof(file_content(path))


def _read(
    content: Content, kind: str, claim: Form, property_of: str
) -> tuple[dict[str, Any], LoopModel, tuple[Strip, ...]]:
    """Header, model and strips of a proof of a kind that claims a property."""
    stated, stored = content
    header = header_of(stated, kind, {"claim": claim, **OTHERS})
    got, names = header["claim"]["property"], header["plant"]["parameters"]
    require(got == property_of, f"the property of a proof of kind {kind!r} must be {property_of!r}, got {got!r}")
    arrays = arrays_of(stored, ARRAYS, len(names))
    plant = header["plant"]
    parts: dict[str, Any] = {name: float(arrays[name]) if name in SCALAR else arrays[name] for name in OF_ARRAYS}
    return (
        header,
        LoopModel(**parts, **{name: plant[name] for name in (*MODEL, *ADDED) if name in plant}),
        unpacked(arrays, len(names)),
    )
