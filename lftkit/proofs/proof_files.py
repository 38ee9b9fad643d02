"""Content of files of proofs of all kinds, and strips as arrays in them.

A file is a header and arrays (:mod:`lftkit.proofs.trusted.entries` reads both). Every header begins with the same four
entries: the format, the kind, the claim and the plant that it is about. No check depends on how a proof was read: what
is read is checked.

================  =====================================================================================================
kind              further header entries; arrays
================  =====================================================================================================
``cells``         ``cells`` (intervals, band, P, Q, D, G, centre, factor); ``stable``, the member with a factor of its
                  Lyapunov matrix; ``posed``, in discrete time; ``sha256``; no arrays
``axis``          ``border`` [rad/s]; A, B, C, D, ``poles``, T, X; strips with the prefixes ``below_`` and ``above_``
``lower bound``   A, B, C, D, ``unseen``, ``unmoved``, ``left``, ``right``, ``noiseless``, ``weightless``,
                  ``decaying(_adjoint)``, ``undisturbed(_adjoint)``
``sampled loop``  ``about``, text for readers; poles, matrices, hold and weights of the loop; strips
``noise``         the same
================  =====================================================================================================
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.trusted.entries import FORMAT, Form, array, record, refuse
from lftkit.proofs.trusted.proof import Box, Strip

Content = tuple[dict[str, Any], dict[str, Any]]
"""Header and arrays."""


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
    of_strips = {name.removeprefix(prefix): arrays[name] for name in strip_arrays(arrays, parameters, prefix)}
    counts, total = of_strips["counts"], len(of_strips["nodes"])
    sizes = {len(values) for name, values in of_strips.items() if name not in ("boxes", "counts")}
    if (
        sizes != {total}
        or len(counts) != len(of_strips["boxes"])
        or np.any(counts < 2)
        or sum(counts.tolist()) != total
    ):
        raise refuse(f"{prefix}counts", f"numbers of nodes, 2 at least and {total} in all", counts.tolist())
    ends = np.concatenate([[0], np.cumsum(counts)]).astype(int)
    strips = []
    for number, box in enumerate(of_strips["boxes"]):
        part = slice(ends[number], ends[number + 1])
        strips.append(
            Strip(
                tuple((float(a), float(b)) for a, b in box),
                of_strips["nodes"][part],
                tuple(of_strips[f"D{k}"][part].astype(complex) for k in range(parameters)),
                tuple(of_strips[f"G{k}"][part].astype(complex) for k in range(parameters)),
                of_strips["factors"][part],
            )
        )
    return tuple(strips)


def write_content(path: Path, content: Content) -> None:
    """Write header and arrays: JSON without arrays, else a compressed ``.npz`` with the header as a member."""
    header, arrays = content
    text = json.dumps(header).encode()
    if not arrays:
        path.write_bytes(text)
        return
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays, header=np.frombuffer(text, dtype=np.uint8))


def header_entries(kind: str, claim: Mapping[str, Any], plant: Mapping[str, Any], **others: Any) -> dict[str, Any]:
    """Header of a file: entries that every one begins with, and the others of a kind."""
    return {"format": FORMAT, "kind": kind, "claim": dict(claim), "plant": dict(plant), **others}


def box_of_claim(header: Mapping[str, Any]) -> Box:
    """Box of a claim in the order of the plant's parameters.

    Raises
    ------
    ProofError
        It is one of other parameters.
    """
    names, box = header["plant"]["parameters"], header["claim"]["box"]
    if len(set(names)) != len(names) or set(names) != set(box):
        raise refuse("box", f"one of the parameters {names}"[:200], sorted(box))
    return tuple(box[name] for name in names)


def arrays_of(
    arrays: Mapping[str, Any], forms: Mapping[str, Form], parameters: int, prefixes: Sequence[str] = ("",)
) -> dict[str, Any]:
    """Arrays of a proof, those of its strips, with prefixes, among them.

    Raises
    ------
    ProofError
        One has not its form, is missing or unknown.
    """
    whole = dict(forms)
    for prefix in prefixes:
        whole |= strip_arrays(arrays, parameters, prefix)
    return dict(record(whole)(dict(arrays), "the file"))
