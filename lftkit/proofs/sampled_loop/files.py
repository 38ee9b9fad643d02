"""Files of proofs of a sampled loop. No check depends on how a proof was read: what is read is checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.entries import Form, array, each, index, mapping, number, pair, record, text, truth, word
from lftkit.proofs.proof_files import packed, read_archive, unpacked, write_archive
from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.trusted.given import LoopProof
from lftkit.proofs.trusted.loop import Loop

FORMAT = "lftkit loop proof 1"
HEADER: dict[str, Form] = {
    "groups": each(each(index)),
    "angle": each(truth),
    "rows": each(index),
    "commands": truth,
}
ADDED: dict[str, Form] = {"added": each(index), "returned": index}
"""Entries that a file without such signals leaves out."""
COMPLEX, REAL, SCALAR = ("poles", "C", "B", "K_poles", "K_C", "K_B"), ("D", "K_D", "weights"), ("dt", "window", "scale")
ARRAYS: dict[str, Form] = {
    **{name: array("complex128", *(None,) * (1 if "poles" in name else 2)) for name in COMPLEX},
    **{name: array("float64", None, None) for name in REAL},
    **{name: array("float64") for name in SCALAR},
    "frame": array("int64", None),
}
MODEL = tuple(f.name for f in fields(LoopModel) if f.name not in {**HEADER, **ADDED})
CLAIM: dict[str, Form] = {"format": text, "names": each(text), "box": each(pair), "about": mapping(word)}
"""Entries of every header of a sampled loop."""


def write_loop_proof(proof: LoopProof, path: Path) -> None:
    """Write a proof as a compressed ``.npz``."""
    of_model, arrays = model_entries(proof.model)
    header = {
        "format": FORMAT,
        "names": proof.names,
        "box": proof.box,
        "band": proof.band,
        "level": proof.level,
        **of_model,
        "about": dict(proof.about),
    }
    write_archive(path, header, arrays | packed(proof.strips, len(proof.names)))


def read_loop_proof(path: Path) -> LoopProof:
    """Read a proof.

    Raises
    ------
    ProofError
        No such file, or not a proof.
    """
    form = record({**CLAIM, **HEADER, "band": pair, "level": number}, ADDED)
    header, arrays = read_archive(path, FORMAT, form, ARRAYS)
    strips, level = unpacked(arrays, len(header["names"])), header["level"]
    return LoopProof(
        model_of(header, arrays), header["names"], header["box"], header["band"], level, strips, header["about"]
    )


def model_entries(model: Loop) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays of a model in a file."""
    header = {"groups": model.groups, "angle": model.angle, "rows": model.rows, "commands": model.commands}
    if model.added:
        header |= {"added": model.added, "returned": model.returned}
    return header, {name: np.asarray(getattr(model, name)) for name in MODEL}


def model_of(header: Mapping[str, Any], arrays: Mapping[str, Any]) -> LoopModel:
    """The model of :func:`model_entries`, of entries that were read."""
    parts: dict[str, Any] = {name: float(arrays[name]) if name in SCALAR else arrays[name] for name in MODEL}
    return LoopModel(**parts, **{name: header[name] for name in (*HEADER, *ADDED) if name in header})
