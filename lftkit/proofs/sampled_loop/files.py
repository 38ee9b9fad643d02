"""Content of files of proofs of a sampled loop, and of noise in one."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.proof_files import (
    Content,
    arrays_of,
    box_of_claim,
    header_entries,
    named_box,
    packed,
    read_content,
    unpacked,
    write_content,
)
from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.trusted.entries import (
    Form,
    array,
    each,
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
from lftkit.proofs.trusted.loop import Loop
from lftkit.proofs.trusted.noise import NoisePart, NoiseProof
from lftkit.proofs.trusted.proof import require
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


def loop_content(proof: LoopProof) -> Content:
    """Content of the file of a proof."""
    box = named_box(proof.names, proof.box)
    claim = {"property": "gain", "level": proof.level, "band": proof.band, "box": box}
    plant, arrays = _plant(proof.model, proof.names)
    header = header_entries(LOOP, claim, plant, about=dict(proof.about))
    return header, arrays | packed(proof.strips, len(proof.names))


def loop_proof(content: Content) -> LoopProof:
    """The proof of a file's content; a ProofError where it is none."""
    header, arrays = content
    header = header_of(header, LOOP, {"claim": GAIN_CLAIM, **OTHERS})
    claim, names = header["claim"], header["plant"]["parameters"]
    require(claim["property"] == "gain", f"a proof of a loop must be one of a gain, got {claim['property']!r}")
    arrays = arrays_of(arrays, ARRAYS, len(names))
    model, strips = _model(header["plant"], arrays), unpacked(arrays, len(names))
    return LoopProof(model, names, box_of_claim(header), claim["band"], claim["level"], strips, header["about"])


def noise_content(proof: NoiseProof) -> Content:
    """Content of the file of a proof of noise."""
    parts = [[part.rows, *part.band, part.level, len(part.strips)] for part in proof.parts]
    claim = {"property": "noise", "parts": parts, "box": named_box(proof.names, proof.box)}
    plant, arrays = _plant(proof.model, proof.names)
    header = header_entries(NOISE, claim, plant, about=dict(proof.about))
    strips = [strip for part in proof.parts for strip in part.strips]
    return header, arrays | packed(strips, len(proof.names))


def noise_proof(content: Content) -> NoiseProof:
    """The proof of noise of a file's content; a ProofError where it is none."""
    header, arrays = content
    header = header_of(header, NOISE, {"claim": NOISE_CLAIM, **OTHERS})
    claim, names = header["claim"], header["plant"]["parameters"]
    require(claim["property"] == "noise", f"a proof of noise must say so, got {claim['property']!r}")
    arrays = arrays_of(arrays, ARRAYS, len(names))
    found = unpacked(arrays, len(names))
    own = sum(count for *_, count in claim["parts"]) == len(found)
    require(own, f"parts must have {len(found)} strips in all, got another number")
    strips = iter(found)
    parts = tuple(
        NoisePart(rows, (low, high), level, tuple(itertools.islice(strips, count)))
        for rows, low, high, level, count in claim["parts"]
    )
    return NoiseProof(_model(header["plant"], arrays), names, box_of_claim(header), parts, header["about"])


def write_loop_proof(proof: LoopProof | NoiseProof, path: Path) -> None:
    """Write a proof of a loop, or of noise in one, as a compressed ``.npz``."""
    write_content(path, noise_content(proof) if isinstance(proof, NoiseProof) else loop_content(proof))


def read_loop_proof(path: Path) -> LoopProof:
    """Read a proof; a ProofError where there is no such file, or it is none of a loop."""
    return loop_proof(read_content(path))


def read_noise_proof(path: Path) -> NoiseProof:
    """Read a proof of noise; errors as of :func:`read_loop_proof`."""
    return noise_proof(read_content(path))


def _plant(model: Loop, names: tuple[str, ...]) -> Content:
    """Header and arrays of a model in a file."""
    plant: dict[str, Any] = {"parameters": names, **{name: getattr(model, name) for name in MODEL}}
    if model.added:
        plant |= {name: getattr(model, name) for name in ADDED}
    return plant, {name: np.asarray(getattr(model, name)) for name in OF_ARRAYS}


def _model(plant: Mapping[str, Any], arrays: Mapping[str, Any]) -> LoopModel:
    """The model of :func:`_plant`, of entries that were read."""
    parts: dict[str, Any] = {name: float(arrays[name]) if name in SCALAR else arrays[name] for name in OF_ARRAYS}
    return LoopModel(**parts, **{name: plant[name] for name in (*MODEL, *ADDED) if name in plant})
