"""Laws of a compiled flight library (``liblos_flight.so``) instead of the laws of a file."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.input_files import check_file
from lftkit.support.input_limits import SYSTEM
from lftkit.systems.ports import Port, total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.interface import DT, HELD, LAW_PORTS

SIZES: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {
        name: (total_size(inputs), *([HELD.size] if name == "k_fsm" else []), total_size(outputs))
        for name, (inputs, outputs) in LAW_PORTS.items()
    }
)
"""Entries after the order in ``los_k_fsm_sizes`` and ``los_k_pma_sizes``: inputs, held values, outputs."""

LARGEST_ORDER = 10_000


class LibraryLaw:
    """K_FSM or K_PMA of a flight library, stepped in its own arithmetic.

    Parameters
    ----------
    path : Path
        Shared library of the units that ``los-testbed export c`` writes. Its code runs in this process.
    setting : {"k_fsm", "k_pma"}

    Raises
    ------
    InputError
        It cannot be loaded, lacks a function, or has other ports.
    """

    def __init__(self, path: Path, setting: str) -> None:
        self.name, self.design_basis = f"{setting} {path}", MappingProxyType(dict[str, Any]())
        try:
            check_file(path, SYSTEM)
            self._library = ctypes.CDLL(str(path.resolve()))
        except OSError as error:
            raise InputError(f"{setting} {path} must be a shared library for this processor, got {error}") from None
        prefix, sizes = f"los_{setting}", SIZES[setting]
        names = (f"{prefix}_{what}" for what in ("init", "reset", "reset_to", "step", "sizes", "tables_sha256"))
        missing = [name for name in names if not hasattr(self._library, name)]
        if missing:
            raise InputError(
                f"{setting} {path} must have the functions of `los-testbed export c`, got none of {', '.join(missing)}"
            )
        stated = tuple((ctypes.c_int * (1 + len(sizes))).in_dll(self._library, f"{prefix}_sizes"))
        self.order = stated[0]
        if stated[1:] != sizes or not 0 <= self.order <= LARGEST_ORDER:
            raise InputError(f"{setting} {path} must have the sizes (order, {sizes}), got {stated}")
        self.tables_sha256 = (ctypes.c_char * 65).in_dll(self._library, f"{prefix}_tables_sha256").value.decode()
        self._step, self._reset_to = (getattr(self._library, f"{prefix}_{what}") for what in ("step", "reset_to"))
        self._self = np.zeros(self.order + sum(sizes[:-1]))
        self._held = tuple(np.zeros(size) for size in sizes[1:-1])
        self._start = np.zeros(self.order)
        (self._inputs, self._outputs), self._size = LAW_PORTS[setting], sizes[0]
        getattr(self._library, f"{prefix}_init")(_pointer(self._self))

    def require(self, inputs: Iterable[Port], outputs: Iterable[Port], dt: float) -> None:
        """Nothing: the sizes were compared when the library was loaded."""

    def start_at(self, state: FloatArray, camera: FloatArray) -> None:
        """Set the state of the next reset of K_FSM: `state` (order,), held values `camera` (h,)."""
        for value, kept in zip((state, camera), (self._start, *self._held)):
            if np.shape(value) != kept.shape:
                raise InputError(f"{self.name}: state must have shape {kept.shape}, got {np.shape(value)}")
            kept[:] = value

    def reset(self, state: FloatArray | None = None, held: FloatArray | None = None) -> None:
        """Back to the start, or to `state` (order,), of K_FSM with the values `held` (h,)."""
        if state is not None and np.shape(state) != self._start.shape:
            raise InputError(f"{self.name}: state must have shape {self._start.shape}, got {np.shape(state)}")
        start = self._start if state is None else np.ascontiguousarray(state, dtype=float)
        kept = self._held if held is None else (np.ascontiguousarray(held, dtype=float),)
        self._reset_to(_pointer(self._self), _pointer(start), *map(_pointer, kept))

    def system(self) -> SampledSystem:
        """Its sampled system, identified by one tick from each unit state and with each unit input."""
        n = self.order
        columns = []
        for j in range(n + self._size):
            unit = np.zeros(n + self._size)
            unit[j], out = 1.0, np.zeros(total_size(self._outputs))
            self.reset(unit[:n], *(np.zeros(h.size) for h in self._held))
            self.step(unit[n:], out)
            columns.append(np.concatenate([self._self[:n], out]))
        self.reset()
        whole = np.array(columns).T.reshape(n + total_size(self._outputs), n + self._size)
        matrices = whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]
        return SampledSystem(*matrices, self._inputs, self._outputs, DT)

    def step(self, values: FloatArray, out: FloatArray) -> None:
        """Write the output of this tick; `values` are the measurement, or the accelerations of the platform."""
        inputs = np.ascontiguousarray(values, dtype=float)  # kept until the call returns
        self._step(_pointer(self._self), _pointer(inputs), _pointer(out))


def _pointer(values: FloatArray) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)
