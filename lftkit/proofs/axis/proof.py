"""Proofs over the frequency axis as files: the system, what is claimed, and strips of scalings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.axis.model import AxisModel
from lftkit.proofs.blocks.structure import REAL
from lftkit.proofs.entries import Form, array, each, fixed, index, maybe, number, pair, record, text
from lftkit.proofs.proof_files import packed, read_archive, unpacked, write_archive
from lftkit.proofs.trusted.proof import Interval, Strip

FORMAT = "lftkit axis proof 1"
SIDES = ("below", "above")
ARRAYS: dict[str, Form] = {
    **{name: array("float64", None, None) for name in "ABCD"},
    "poles": array("complex128", None),
    **{name: array("complex128", None, None) for name in "TX"},
}
HEADER = record(
    {
        "format": text,
        "kind": text,
        "level": maybe(number),
        "names": each(text),
        "nominal": each(number),
        "box": each(pair),
        "band": fixed(number, maybe(number)),
        "groups": each(each(index)),
        "border": number,
    },
    {"kinds": each(text)},
)


@dataclass(frozen=True)
class AxisProof:
    """What a file claims and the strips that prove it.

    Parameters
    ----------
    kind : str
        ``gain`` or ``stability``.
    level : float or None
        The gain from all inputs to all outputs is below it; None for stability.
    names : tuple of str
        Of the parameters and of complex and dynamic elements.
    nominal : tuple of float
        Their nominal values; zero for complex and dynamic elements.
    box : tuple of (low, high)
        Their intervals, physical values; minus and plus the radius of complex numbers, the bound of dynamics.
    band : (low, high)
        Frequencies [rad/s]; high may be infinite.
    A, B, C, D : ndarray
        The system with ``w = (value - nominal) z`` for each channel, channels first; without inputs and outputs for
        stability.
    poles, T, X : ndarray, complex
        As of :class:`~lftkit.proofs.axis.model.AxisModel`.
    groups : tuple of tuple of int
        Channels of each element.
    kinds : tuple of str
        Of each element, as of :class:`~lftkit.proofs.axis.model.AxisModel`: all real in files without them.
    border : float
        Power of two: frequency [rad/s] from which strips are over the inverse of the frequency.
    below, above : tuple of Strip
        Boxes are deviations from the nominal values.
    """

    kind: str
    level: float | None
    names: tuple[str, ...]
    nominal: tuple[float, ...]
    box: tuple[Interval, ...]
    band: Interval
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    poles: ComplexArray
    T: ComplexArray
    X: ComplexArray
    groups: tuple[tuple[int, ...], ...]
    kinds: tuple[str, ...]
    border: float
    below: tuple[Strip, ...] = field(default=())
    above: tuple[Strip, ...] = field(default=())

    @property
    def cells(self) -> int:
        """Number of strips."""
        return len(self.below) + len(self.above)

    def model(self, beyond: bool) -> AxisModel:
        """Responses over the frequencies below or beyond the border."""
        matrices = self.A, self.B, self.C, self.D, self.poles, self.T, self.X
        return AxisModel(*matrices, self.groups, self.kinds, beyond)

    @property
    def deviations(self) -> tuple[Interval, ...]:
        """Intervals of the deviations from the nominal values, rounded outwards."""
        return deviations_of(self.box, self.nominal)

    def to_file(self, path: Path) -> None:
        """Write the proof as a compressed ``.npz``."""
        header = {
            "format": FORMAT,
            "kind": self.kind,
            "level": self.level,
            "names": self.names,
            "nominal": self.nominal,
            "box": self.box,
            "band": [self.band[0], None if math.isinf(self.band[1]) else self.band[1]],
            "groups": self.groups,
            "kinds": self.kinds,
            "border": self.border,
        }
        arrays: dict[str, Any] = {name: np.asarray(getattr(self, name)) for name in ARRAYS}
        for side in SIDES:
            strips = packed(getattr(self, side), len(self.names))
            arrays |= {f"{side}_{name}": array for name, array in strips.items()}
        write_archive(path, header, arrays)

    @classmethod
    def from_file(cls, path: Path) -> AxisProof:
        """Read a proof.

        Raises
        ------
        ProofError
            No such file, or not a proof.
        """
        header, arrays = read_archive(path, FORMAT, HEADER, ARRAYS, [f"{side}_" for side in SIDES])
        low, high = header.pop("band")
        del header["format"]
        below, above = (unpacked(arrays, len(header["names"]), f"{side}_") for side in SIDES)
        return cls(
            **{"kinds": (REAL,) * len(header["names"]), **header},
            band=(low, math.inf if high is None else high),
            below=below,
            above=above,
            **{name: arrays[name] for name in ARRAYS},
        )


def deviations_of(box: tuple[Interval, ...], nominal: tuple[float, ...]) -> tuple[Interval, ...]:
    """Intervals of ``value - nominal``, rounded outwards."""

    def away(value: float, middle: float, towards: float) -> float:
        return 0.0 if value == middle else math.nextafter(value - middle, towards)

    return tuple((away(low, at, -math.inf), away(high, at, math.inf)) for (low, high), at in zip(box, nominal))
