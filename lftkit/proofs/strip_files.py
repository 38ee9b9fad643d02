"""Files of strips of scalings.

A file is a compressed ``.npz``: arrays, and one member `header` with the rest as JSON. No check depends on how a proof
was read: what is read is checked.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.proofs.trusted.proof import ProofError, Strip


def packed(strips: Sequence[Strip], parameters: int) -> dict[str, Any]:
    """Arrays of strips: boxes, numbers of nodes, and what belongs to the nodes one after the other."""
    arrays: dict[str, Any] = {
        "boxes": np.array([strip.box for strip in strips]).reshape(len(strips), parameters, 2),
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


def unpacked(arrays: Mapping[str, Any], parameters: int) -> tuple[Strip, ...]:
    """Strips of :func:`packed`."""
    ends = np.concatenate([[0], np.cumsum(arrays["counts"])]).astype(int)
    strips = []
    for number, box in enumerate(arrays["boxes"]):
        part = slice(ends[number], ends[number + 1])
        strips.append(
            Strip(
                tuple((float(a), float(b)) for a, b in box),
                arrays["nodes"][part],
                tuple(arrays[f"D{k}"][part].astype(complex) for k in range(parameters)),
                tuple(arrays[f"G{k}"][part].astype(complex) for k in range(parameters)),
                arrays["factors"][part],
            )
        )
    return tuple(strips)


def write_archive(path: Path, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write a proof."""
    text = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays, header=text)


@contextmanager
def read_archive(path: Path, form: str, what: str) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Header and arrays of a proof; whatever is raised in the context means that the file is none.

    Raises
    ------
    ProofError
        No such file, another format than `form`, or not a proof: it is said to be no `what`.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        header = json.loads(bytes(arrays.pop("header")).decode())
        if header["format"] != form:
            raise ProofError(f"format must be {form!r}, got {header['format']!r}")
        yield header, arrays
    except Exception as error:  # of a damaged file numpy raises a dozen kinds, that of its tokenizer included
        known = isinstance(error, ProofError)
        raise ProofError(str(error) if known else f"the file must be {what}, got {type(error).__name__}") from None
