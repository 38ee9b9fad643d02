"""Controllers side by side, each with its own measurements and commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.ports import Port, total_size
from lftkit.tuning.structures.bounds import Bounds, bounds_of
from lftkit.tuning.structures.structures import AffineStructure, Structure


@checked
@dataclass(frozen=True)
class Decentralised:
    """Several controllers side by side, each seeing its own measurements only.

    A measurement may be that of several parts. Parameters are named by the commands and the name in the part:
    ``u.Kp``, ``a+b.D[0,0]``.

    Parameters
    ----------
    parts : tuple of Structure
        Their commands must not overlap.

    Examples
    --------
    A proportional inner loop at a fixed gain beside a PI controller:

    >>> from lftkit.tuning import gain, pid
    >>> inner, outer = gain([("rate", 1)], [("torque", 1)]), pid("e", "thrust", derivative_filter=1, terms="PI")
    >>> both = Decentralised((inner, outer))
    >>> both.names
    ('torque.D[0,0]', 'thrust.Kp', 'thrust.Ki')
    >>> both.with_fixed({"torque.D[0,0]": -2.0}).names
    ('thrust.Kp', 'thrust.Ki')
    """

    parts: tuple[Structure, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self.parts))
        commands = [p.name for part in self.parts for p in part.outputs]
        if len(set(commands)) < len(commands):
            raise InputError(f"decentralised parts must not share outputs, got {commands}")
        sizes: dict[str, int] = {}
        for port in (p for part in self.parts for p in part.inputs):
            if sizes.setdefault(port.name, port.size) != port.size:
                raise InputError(
                    f"measurement {port.name!r} must have one size, got {sizes[port.name]} and {port.size}"
                )

    @property
    def inputs(self) -> tuple[Port, ...]:
        """Measurements of all parts, each once."""
        return tuple({p.name: p for part in self.parts for p in part.inputs}.values())

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

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(
            f"{_prefix(part)}.{name}"
            for part in self.parts
            for name in getattr(part, "names", [f"x[{k}]" for k in range(part.size)])
        )

    @property
    def bounds(self) -> Bounds | None:
        """Bounds of all parts; None where none has any."""
        of_parts = [bounds_of(part) for part in self.parts]
        if not any(of_parts):
            return None
        free = [np.full(part.size, np.inf) for part in self.parts]
        lower = np.concatenate([-f if b is None else b.lower for b, f in zip(of_parts, free)])
        return Bounds(lower, np.concatenate([f if b is None else b.upper for b, f in zip(of_parts, free)]))

    def values(self, x: ArrayLike) -> dict[str, float]:
        """Parameters (size,) by name."""
        return dict(zip(self.names, np.asarray(x, dtype=float).tolist(), strict=True))

    def with_fixed(self, entries: Mapping[str | tuple[int, int], float]) -> Decentralised:
        """Same structure with parameters, by name, or entries (row, column) of the whole gain matrix held.

        Raises
        ------
        ValueError
            Another name or entry than those of the parts, or a part that can hold nothing.
        """
        by_part: list[dict[str | tuple[int, int], float]] = [{} for _ in self.parts]
        for key, value in entries.items():
            if isinstance(key, str):
                number, name = self._part_of(key)
                by_part[number][name] = value
                continue
            for number, (_, _, rows, columns) in enumerate(self._places()):
                if key[0] in rows and key[1] in columns:
                    by_part[number][rows.tolist().index(key[0]), columns.tolist().index(key[1])] = value
                    break
            else:
                raise InputError(f"entry {key} of the gain matrix is in no part of the structure")
        return Decentralised(tuple(_affine(p).with_fixed(held) if held else p for p, held in zip(self.parts, by_part)))

    def with_bounds(self, limits: Mapping[str, tuple[float, float]]) -> Decentralised:
        """Same structure with parameters, by name, kept between (lowest, highest); either may be infinite."""
        by_part: list[dict[str, tuple[float, float]]] = [{} for _ in self.parts]
        for key, limit in limits.items():
            number, name = self._part_of(key)
            by_part[number][name] = limit
        return Decentralised(
            tuple(
                _affine(p).with_bounds(limits_of_part) if limits_of_part else p
                for p, limits_of_part in zip(self.parts, by_part)
            )
        )

    def _part_of(self, key: str) -> tuple[int, str]:
        """Number of the part that a parameter belongs to, and its name there."""
        if key not in self.names:
            raise InputError(f"parameter must be one of {', '.join(self.names)}, got {key!r}")
        prefixes = [f"{_prefix(part)}." for part in self.parts]
        number = next(k for k, prefix in enumerate(prefixes) if key.startswith(prefix))
        return number, key.removeprefix(prefixes[number])

    def _places(self) -> list[tuple[Structure, slice, IntArray, IntArray]]:
        """Each part with its parameters, and its rows and columns of the gain matrix."""
        first, at = dict[str, int](), self.order
        for port in self.inputs:
            first[port.name], at = at, at + port.size
        places, at, x, u = [], 0, 0, self.order
        for part in self.parts:
            nu, states = total_size(part.outputs), np.arange(x, x + part.order)
            seen = [np.arange(first[p.name], first[p.name] + p.size) for p in part.inputs]
            columns = np.concatenate([states, *seen])
            places.append((part, slice(at, at + part.size), np.concatenate([states, np.arange(u, u + nu)]), columns))
            at, x, u = at + part.size, x + part.order, u + nu
        return places

    def _blocks(self) -> list[tuple[Structure, slice, Any]]:
        return [(part, at, np.ix_(rows, columns)) for part, at, rows, columns in self._places()]

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


def _prefix(part: Structure) -> str:
    return "+".join(p.name for p in part.outputs)


def _affine(part: Structure) -> AffineStructure | Decentralised:
    if not isinstance(part, AffineStructure | Decentralised):
        raise InputError(f"parameters of {_prefix(part)} cannot be fixed or bounded, got a {type(part).__name__}")
    return part
