"""Proofs over the frequency axis and their files: the system, what is claimed, and strips of scalings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.proof_files import (
    Content,
    arrays_of,
    box_of_claim,
    header_entries,
    packed,
    unpacked,
    write_content,
)
from lftkit.proofs.sampled_loop.model import coordinates
from lftkit.proofs.trusted.axis import AxisClaim, AxisSystem
from lftkit.proofs.trusted.entries import (
    Form,
    array,
    each,
    fixed,
    header_of,
    index,
    mapping,
    maybe,
    number,
    pair,
    record,
    text,
)
from lftkit.proofs.trusted.proof import Strip

KIND = "axis"
SIDES = ("below", "above")
ARRAYS: dict[str, Form] = {
    **{name: array("float64", None, None) for name in "ABCD"},
    "poles": array("complex128", None),
    **{name: array("complex128", None, None) for name in "TX"},
}
HEADER: dict[str, Form] = {
    "claim": record(
        {"property": text, "level": maybe(number), "band": fixed(number, maybe(number)), "box": mapping(pair)}
    ),
    "plant": record(
        {"parameters": each(text), "nominal": each(number), "groups": each(each(index)), "kinds": each(text)}
    ),
    "border": number,
}


@dataclass(frozen=True)
class AxisModel(AxisSystem):
    """A system over a part of the axis, for those who search proofs and for the check; fields as there."""

    @property
    def slowest(self) -> float:
        """Smallest of the poles, in the unit of the variable."""
        size = np.abs(self.poles[self.poles != 0.0])
        return float((1.0 / size if self.beyond else size).min(initial=1.0 if not len(size) else np.inf))

    def amplitudes(self, x: float, /) -> tuple[float, FloatArray]:
        """Weight of the errors and amplitudes of the disturbances: ones."""
        return 1.0, np.ones(self.sizes[3])

    def at(self, x: float, /) -> tuple[ComplexArray, ComplexArray]:
        """``z`` and the errors by (w, d) at one value of the variable, (q, q + d) and (e, q + d), without bounds."""
        q, driven = self.sizes[0], self.X @ self.B
        states = x * driven / (1j - x * self.poles)[:, None] if self.beyond else driven / (1j * x - self.poles)[:, None]
        response = self.C @ (self.T @ states) + self.D
        return response[:q], response[q:]

    def coordinates(self, strip: Strip, number: int, omega: float, level: float, /) -> ComplexArray:
        """Coordinates in which the form of a strip is about -I: (w, d) by them, square."""
        return coordinates(self, strip, number, omega, level)


@dataclass(frozen=True)
class AxisProof(AxisClaim):
    """A proof that can be checked and written; fields are those of :class:`~lftkit.proofs.trusted.axis.AxisClaim`."""

    @property
    def cells(self) -> int:
        """Number of strips."""
        return len(self.below) + len(self.above)

    def to_file(self, path: Path) -> None:
        """Write the proof as a compressed ``.npz``."""
        write_content(path, self.content)

    @property
    def content(self) -> Content:
        """Content of its file."""
        low, high = self.band
        band = [low, None if math.isinf(high) else high]
        claim = {"property": self.kind, "level": self.level, "band": band, "box": dict(zip(self.names, self.box))}
        plant = {
            "parameters": self.names,
            "nominal": self.nominal,
            "groups": self.system.groups,
            "kinds": self.system.kinds,
        }
        arrays: dict[str, Any] = {name: np.asarray(getattr(self.system, name)) for name in ARRAYS}
        for side in SIDES:
            strips = packed(getattr(self, side), len(self.names))
            arrays |= {f"{side}_{name}": array for name, array in strips.items()}
        return header_entries(KIND, claim, plant, border=self.border), arrays


def axis_proof(content: Content) -> AxisProof:
    """The proof of a file's content; a ProofError where it is none."""
    header, arrays = content
    header = header_of(header, KIND, HEADER)
    claim, plant, (low, high) = header["claim"], header["plant"], header["claim"]["band"]
    count = len(plant["parameters"])
    arrays = arrays_of(arrays, ARRAYS, count, [f"{side}_" for side in SIDES])
    below, above = (unpacked(arrays, count, f"{side}_") for side in SIDES)
    return AxisProof(
        kind=claim["property"],
        level=claim["level"],
        names=plant["parameters"],
        nominal=plant["nominal"],
        box=box_of_claim(header),
        band=(low, math.inf if high is None else high),
        system=AxisModel(
            **{name: arrays[name] for name in ARRAYS}, groups=plant["groups"], kinds=plant["kinds"], beyond=False
        ),
        border=header["border"],
        below=below,
        above=above,
    )
