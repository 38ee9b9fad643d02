"""Files of proofs of a sampled loop. No check depends on how a proof was read: what is read is checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.strip_files import packed, read_archive, unpacked, write_archive
from lftkit.proofs.trusted.given import LoopProof
from lftkit.proofs.trusted.loop import Loop

FORMAT = "los-testbed loop proof 1"
HEADER = ("groups", "angle", "rows", "commands", "added", "returned")
MODEL = tuple(f.name for f in fields(LoopModel) if f.name not in HEADER)


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
    with read_archive(path, FORMAT, "a proof of a loop") as (header, arrays):
        model = model_of(header, arrays)
        box = tuple((float(a), float(b)) for a, b in header["box"])
        band = (float(header["band"][0]), float(header["band"][1]))
        strips = unpacked(arrays, len(header["names"]))
        return LoopProof(model, tuple(header["names"]), box, band, float(header["level"]), strips, header["about"])


def model_entries(model: Loop) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays of a model in a file."""
    header = {"groups": model.groups, "angle": model.angle, "rows": model.rows, "commands": model.commands}
    if model.added:
        header |= {"added": model.added, "returned": model.returned}
    return header, {name: np.asarray(getattr(model, name)) for name in MODEL}


def model_of(header: Mapping[str, Any], arrays: Mapping[str, Any]) -> LoopModel:
    """The model of :func:`model_entries`."""
    parts = {name: arrays[name][()] for name in MODEL}
    parts |= {name: float(parts[name]) for name in ("dt", "window", "scale")}
    return LoopModel(
        **parts,
        groups=tuple(map(tuple, header["groups"])),
        angle=tuple(map(bool, header["angle"])),
        rows=tuple(header["rows"]),
        commands=bool(header["commands"]),
        added=tuple(header.get("added", ())),
        returned=header.get("returned", 0),
    )
