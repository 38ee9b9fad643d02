"""Proofs of a sampled loop as files: the loop, what is claimed, and strips of scalings."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.verdict import ProofError

Interval = tuple[float, float]
FORMAT = "los-testbed loop proof 1"
MODEL = tuple(f.name for f in fields(LoopModel) if f.name not in ("groups", "angle", "rows", "commands"))


@dataclass(frozen=True)
class Strip:
    """A box of the parameters and scalings at some frequencies.

    Parameters
    ----------
    box : tuple of (low, high)
        Deviations from the nominal values; of an angle theta [rad].
    nodes : ndarray, shape (k,)
        Frequencies [rad/s], ascending, two at least.
    D, G : tuple of ndarray, complex, shape (k, m, m)
        Of each parameter, Hermitian. D is positive definite, or zero for all nodes of an angle: then it is any angle.
    factor : ndarray, shape (k,)
        Of the gain's inequality, positive.
    """

    box: tuple[Interval, ...]
    nodes: FloatArray
    D: tuple[ComplexArray, ...]
    G: tuple[ComplexArray, ...]
    factor: FloatArray


@dataclass(frozen=True)
class LoopProof:
    """What a file claims and the strips that prove it.

    Parameters
    ----------
    model : LoopModel
    names : tuple of str
        Of the parameters.
    box : tuple of (low, high)
        As in :class:`Strip`.
    band : (low, high)
        Frequencies [rad/s].
    level : float
        The gain is below this part of the limit.
    strips : tuple of Strip
    about : mapping
        What the loop is, for people: figure, stage, designs.
    """

    model: LoopModel
    names: tuple[str, ...]
    box: tuple[Interval, ...]
    band: Interval
    level: float
    strips: tuple[Strip, ...]
    about: Mapping[str, Any] = field(default_factory=dict)

    def to_file(self, path: Path) -> None:
        """Write the proof as a compressed ``.npz``."""
        model = self.model
        header = {
            "format": FORMAT,
            "names": self.names,
            "box": self.box,
            "band": self.band,
            "level": self.level,
            "groups": model.groups,
            "angle": model.angle,
            "rows": model.rows,
            "commands": model.commands,
            "about": dict(self.about),
        }
        arrays: dict[str, Any] = {name: np.asarray(getattr(model, name)) for name in MODEL}
        arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
        with path.open("wb") as file:
            np.savez_compressed(file, **arrays, **packed(self.strips, len(self.names)))

    @classmethod
    def from_file(cls, path: Path) -> LoopProof:
        """Read a proof.

        Raises
        ------
        ProofError
            No such file, or not a proof.
        """
        try:
            with np.load(path, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            header = json.loads(bytes(arrays["header"]).decode())
            if header["format"] != FORMAT:
                raise ProofError(f"format must be {FORMAT!r}, got {header['format']!r}")
            parts = {name: arrays[name][()] for name in MODEL}
            parts |= {name: float(parts[name]) for name in ("dt", "window", "scale")}
            model = LoopModel(
                **parts,
                groups=tuple(map(tuple, header["groups"])),
                angle=tuple(map(bool, header["angle"])),
                rows=tuple(header["rows"]),
                commands=bool(header["commands"]),
            )
            box = tuple((float(a), float(b)) for a, b in header["box"])
            band = (float(header["band"][0]), float(header["band"][1]))
            strips = unpacked(arrays, len(header["names"]))
            return cls(model, tuple(header["names"]), box, band, float(header["level"]), strips, header["about"])
        except Exception as error:  # of a damaged file numpy raises a dozen kinds, that of its tokenizer included
            known = isinstance(error, ProofError)
            raise ProofError(
                str(error) if known else f"the file must be a proof of a loop, got {type(error).__name__}"
            ) from None


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
