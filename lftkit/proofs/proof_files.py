"""Files of strips of scalings.

A file is a compressed ``.npz``: arrays, and one member `header` with the rest as JSON. No check depends on how a proof
was read: what is read (:mod:`lftkit.proofs.entries`) is checked.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.entries import Form, array, file_content, record, refuse
from lftkit.proofs.trusted.proof import ProofError, Strip
from lftkit.support.format_names import current_name


def packed(strips: Sequence[Strip], parameters: int) -> dict[str, Any]:
    """Arrays of strips: boxes, numbers of nodes, and what belongs to the nodes one after the other."""
    arrays: dict[str, Any] = {
        "boxes": np.array([strip.box for strip in strips], dtype=float).reshape(len(strips), parameters, 2),
        "counts": np.array([len(strip.nodes) for strip in strips], dtype=np.int64),
        "nodes": np.concatenate([np.zeros(0), *(strip.nodes for strip in strips)]),
        "factors": np.concatenate([np.zeros(0), *(strip.factor for strip in strips)]),
    }
    for k in range(parameters if strips else 0):
        for name, matrices in (("D", [strip.D[k] for strip in strips]), ("G", [strip.G[k] for strip in strips])):
            whole = np.concatenate(matrices)
            single = whole.astype(np.complex64)
            arrays[f"{name}{k}"] = single if np.array_equal(single, whole) else whole
    return arrays


def strip_arrays(arrays: Mapping[str, Any], parameters: int, prefix: str = "") -> dict[str, Form]:
    """Forms of the arrays of :func:`packed` in a file; their sizes must fit to each other."""
    boxes = arrays.get(f"{prefix}boxes")
    some = isinstance(boxes, np.ndarray) and len(boxes.shape) > 0 and len(boxes) > 0
    forms = {
        "boxes": array("float64", None, parameters, 2),
        "counts": array("int64", None),
        "nodes": array("float64", None),
        "factors": array("float64", None),
    }
    scaling = array(("complex64", "complex128"), None, None, None)
    forms |= {f"{name}{k}": scaling for name in "DG" for k in range(parameters if some else 0)}
    return {prefix + name: form for name, form in forms.items()}


def unpacked(arrays: Mapping[str, Any], parameters: int, prefix: str = "") -> tuple[Strip, ...]:
    """Strips of :func:`packed`.

    Raises
    ------
    ProofError
        A node, a factor or a scaling that belongs to no strip, or the other way round.
    """
    own = {name.removeprefix(prefix): arrays[name] for name in strip_arrays(arrays, parameters, prefix)}
    counts, total = own["counts"], len(own["nodes"])
    sizes = {len(values) for name, values in own.items() if name not in ("boxes", "counts")}
    if sizes != {total} or len(counts) != len(own["boxes"]) or np.any(counts < 2) or sum(counts.tolist()) != total:
        raise refuse(f"{prefix}counts", f"numbers of nodes, 2 at least and {total} in all", counts.tolist())
    ends = np.concatenate([[0], np.cumsum(counts)]).astype(int)
    strips = []
    for number, box in enumerate(own["boxes"]):
        part = slice(ends[number], ends[number + 1])
        strips.append(
            Strip(
                tuple((float(a), float(b)) for a, b in box),
                own["nodes"][part],
                tuple(own[f"D{k}"][part].astype(complex) for k in range(parameters)),
                tuple(own[f"G{k}"][part].astype(complex) for k in range(parameters)),
                own["factors"][part],
            )
        )
    return tuple(strips)


def write_archive(path: Path, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write a proof."""
    text = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays, header=text)


def read_archive(
    path: Path, form: str, header: Form, arrays: Mapping[str, Form], prefixes: Sequence[str] = ("",)
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays of a proof, with the strips' arrays under prefixes.

    Raises
    ------
    ProofError
        No such file, another format than `form`, or an entry that has not its form, is missing or unknown.
    """
    given, found = file_content(path)
    own = current_name(given.get("format")) if isinstance(given, dict) else None
    if own != form:
        raise ProofError(f"format must be {form!r}, got {own!r}"[:200])
    known = header(given, "header")
    forms = dict(arrays)
    for prefix in prefixes:
        forms |= strip_arrays(found, len(known["names"]), prefix)
    return known, record(forms)(found, "the file")
