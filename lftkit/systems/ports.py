"""Named groups of signals (numpy only)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.support.scalars import as_integer


@dataclass(frozen=True)
class Port:
    """A named group of signals.

    Parameters
    ----------
    name : str
        Unique among the inputs (or outputs) of a system.
    size : int
        Number of scalar signals, at least 1.
    unit : str
        SI unit of the signals, one per component separated by commas where they differ; ports are
        only connected to ports of the same unit.

    Examples
    --------
    >>> Port("accel_Ip", 6, "m/s2,rad/s2").signals[0]
    'accel_Ip[0]'
    """

    name: str
    size: int
    unit: str = "1"

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InputError(f"name of a port must be text, got {self.name!r}")
        if not self.name:
            raise InputError("name of a port must not be empty, got ''")
        if not isinstance(self.unit, str):
            raise InputError(f"unit of port {self.name!r} must be text, got {self.unit!r}")
        size = as_integer(self.size, f"size of port {self.name!r}")
        if size < 1:
            raise InputError(f"size of port {self.name!r} must be at least 1, got {size}")
        object.__setattr__(self, "size", size)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the scalar signals: the port's own name if it has one, else ``name[i]``."""
        if self.size == 1:
            return (self.name,)
        return tuple(f"{self.name}[{i}]" for i in range(self.size))

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each signal."""
        units = tuple(self.unit.split(","))
        return units if len(units) == self.size else (self.unit,) * self.size

    def takes(self, other: Port) -> bool:
        """Whether another port has the same name and size, and the same unit if it states one (not ``1``)."""
        same = (self.name, self.size) == (other.name, other.size)
        return same and (other.unit in ("", "1") or other.units == self.units)


def as_ports(ports: Iterable[Any], what: str) -> tuple[Port, ...]:
    """Ports given as such or as (name, size); names must be unique.

    Raises
    ------
    ValueError
        Another form, or a name that is used twice; the message begins with `what`.
    """
    if not isinstance(ports, Iterable):
        raise InputError(f"{what}: must be a sequence of ports, got {ports!r}")
    made = tuple(_as_port(p, what) for p in ports)
    names = [p.name for p in made]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise InputError(f"{what}: port names must be unique, got {', '.join(map(repr, twice))} twice")
    return made


def _as_port(value: Any, what: str) -> Port:
    if isinstance(value, Port):
        return value
    if not (isinstance(value, tuple | list) and 2 <= len(value) <= 3):
        raise InputError(f"{what}: a port must be a Port or (name, size), got {value!r}")
    return Port(*value)


def names_of_ports(value: Any, what: str) -> tuple[str, ...]:
    """Names given as a sequence, or a single one; a ValueError that begins with `what` for anything else."""
    names = (value,) if isinstance(value, str) else tuple(value) if isinstance(value, Iterable) else (value,)
    if not all(isinstance(name, str) for name in names):
        raise InputError(f"{what} must be a name or names of ports, got {value!r}")
    return names


def read_only(array: ArrayLike) -> FloatArray:
    """Contiguous read-only float copy."""
    copy = np.array(array, dtype=float, order="C")
    copy.setflags(write=False)
    return copy


def port_slices(ports: Iterable[Port]) -> dict[str, slice]:
    """Slice of each port in the stacked signal vector, by name."""
    slices, start = {}, 0
    for port in ports:
        slices[port.name] = slice(start, start + port.size)
        start += port.size
    return slices


def total_size(ports: Iterable[Port]) -> int:
    """Number of scalar signals of all ports together."""
    return sum(port.size for port in ports)


def spread_columns(matrix: ArrayLike, ports: Sequence[Port], onto: Sequence[Port]) -> FloatArray:
    """The columns of `matrix`, which are those of `ports`, at the places of the same ports among `onto`; others are 0.

    Raises
    ------
    ValueError
        A port that is not among `onto`, or has another size there.

    Examples
    --------
    >>> spread_columns([[1.0, 2.0]], [Port("a", 2)], [Port("b", 1), Port("a", 2)]).tolist()
    [[0.0, 1.0, 2.0]]
    """
    columns = np.asarray(matrix, dtype=float)
    sizes = {port.name: port.size for port in onto}
    if any(sizes.get(port.name) != port.size for port in ports):
        present, allowed = (", ".join(f"{p.name}[{p.size}]" for p in which) for which in (ports, onto))
        raise InputError(f"inputs must be of {allowed}, got {present}")
    spread = np.zeros((len(columns), total_size(onto)))
    spread[:, port_indices(onto, [port.name for port in ports], "input")] = columns
    return spread


def port_indices(ports: Sequence[Port], names: Iterable[str], kind: str, of: str = "") -> IntArray:
    """Indices of the signals of the ports `names`, in the given order, in the stacked vector of all `ports`.

    Raises
    ------
    ValueError
        Unknown port; the message lists the existing ones and names the system by `kind` and `of`.
    """
    slices = port_slices(ports)
    chosen: list[int] = []
    for name in names:
        if name not in slices:
            known = ", ".join(slices) or "(none)"
            raise InputError(f"{of + ': ' if of else ''}{kind} port must be one of {known}, got {name!r}")
        chosen.extend(range(slices[name].start, slices[name].stop))
    return np.array(chosen, dtype=np.intp)
