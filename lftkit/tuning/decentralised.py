"""Controllers side by side, each with its own measurements and commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port, total_size
from lftkit.tuning.structures import Structure


@dataclass(frozen=True)
class Decentralised:
    """Several controllers side by side, each seeing its own measurements only.

    Parameters
    ----------
    parts : tuple of Structure
        Their ports must not overlap.
    """

    parts: tuple[Structure, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        for side in ("inputs", "outputs"):
            names = [p.name for part in self.parts for p in getattr(part, side)]
            if len(set(names)) < len(names):
                raise ValueError(f"decentralised parts must not share {side}, got {names}")

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Measurements of all parts."""
        return tuple(p for part in self.parts for p in part.inputs)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Commands of all parts."""
        return tuple(p for part in self.parts for p in part.outputs)

    @property
    def order(self) -> int:
        """Sum of the orders."""
        return sum(part.order for part in self.parts)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(part.size for part in self.parts)

    def _blocks(self) -> list[tuple[Structure, slice, Any]]:
        found, at, x, y, u = [], 0, 0, self.order, self.order
        for part in self.parts:
            ny, nu = total_size(part.inputs), total_size(part.outputs)
            rows = np.r_[x : x + part.order, u : u + nu]
            columns = np.r_[x : x + part.order, y : y + ny]
            found.append((part, slice(at, at + part.size), np.ix_(rows, columns)))
            at, x, y, u = at + part.size, x + part.order, y + ny, u + nu
        return found

    def gain_matrix(self, x: FloatArray) -> FloatArray:
        """Gain matrix at `x` (size,)."""
        K = np.zeros((self.order + total_size(self.outputs), self.order + total_size(self.inputs)))
        for part, at, entries in self._blocks():
            K[entries] = part.gain_matrix(x[at])
        return K

    def pullback(self, x: FloatArray, G: FloatArray) -> FloatArray:
        """Gradient of ``sum(G * gain_matrix(x))``."""
        return np.concatenate([part.pullback(x[at], G[entries]) for part, at, entries in self._blocks()])

    def start(self, rng: np.random.Generator) -> FloatArray:
        """Random parameters."""
        return np.concatenate([part.start(rng) for part in self.parts])
