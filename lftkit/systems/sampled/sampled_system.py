"""Sampled linear systems with named ports, ready for a real-time loop (numpy only).

Controllers are stored as files of this kind. A file is a JSON object:

=================  ============================================================================================
key                value
=================  ============================================================================================
``format``         ``lftkit/sampled-system``; ``version``: 1
``name``           text
``dt``             sampling period [s]
``inputs``         list of ports, objects with ``name``, ``size``, ``unit``; ``outputs`` alike
``A`` ... ``D``    matrices as lists of rows
``design_basis``   what the system was made for, names and values; may be missing
``provenance``     how the system was made; may be missing
=================  ============================================================================================
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.atomic_output import write_text
from lftkit.support.input_files import read_text
from lftkit.support.scalars import as_positive
from lftkit.support.structured_text import load_json
from lftkit.systems.arguments import checked
from lftkit.systems.control_conversion import control_system, ports_and_matrices
from lftkit.systems.matrices import checked_matrices
from lftkit.systems.ports import Port, as_ports, spread_columns, total_size
from lftkit.systems.sampled.ordered_product import OrderedProduct
from lftkit.systems.system_summary import named_line

if TYPE_CHECKING:
    import control

FORMAT = "lftkit/sampled-system"
VERSION = 1
KEYS = "format", "version", "name", "dt", "inputs", "outputs", *"ABCD", "design_basis", "provenance"


@dataclass(frozen=True)
class SampledSystem:
    """Sampled linear system ``x+ = A x + B u``, ``y = C x + D u`` with named ports.

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (n, n), (n, m), (p, n), (p, m); n may be 0 (a static gain).
    inputs, outputs : tuple of Port
        Sizes add up to m and p.
    dt : float
        Sampling period [s].
    name : str
        What the system is, for messages and reports.
    design_basis : mapping
        What the system was made for, names and values; empty where nothing is known.
    provenance : mapping
        How it was made: command, seed, commit, norms.

    Raises
    ------
    ValueError
        Shapes that do not fit, numbers that are not finite, a period that is not positive.

    Examples
    --------
    A leaky integrator driven by 1 settles at its DC gain 1 / (1 - 0.9):

    >>> k = SampledSystem([[0.9]], [[1.0]], [[1.0]], [[0.0]], (Port("u", 1),), (Port("y", 1),), 1e-3)
    >>> y = np.zeros(1)
    >>> for _ in range(400):
    ...     k.step(np.ones(1), y)
    >>> round(float(y[0]), 9)
    10.0
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    dt: float
    name: str = "controller"
    design_basis: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    _product: OrderedProduct = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for side in ("inputs", "outputs"):
            object.__setattr__(self, side, as_ports(getattr(self, side), f"{self.name}, {side}"))
        sizes = total_size(self.inputs), total_size(self.outputs)
        try:
            matrices = checked_matrices(self.A, self.B, self.C, self.D, *sizes)
        except ValueError as error:
            raise InputError(f"{self.name}: {error}") from None
        for key, matrix in zip("ABCD", matrices):
            object.__setattr__(self, key, matrix)
        as_positive(self.dt, f"{self.name}: sampling period")
        object.__setattr__(self, "_product", OrderedProduct(np.block([[self.A, self.B], [self.C, self.D]])))

    def __repr__(self) -> str:
        return named_line(self, f"dt {self.dt:g} s")

    @property
    def order(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    @property
    def state(self) -> FloatArray:
        """Copy of the present state."""
        return self._product.values[: len(self.A)].copy()

    @property
    def product(self) -> OrderedProduct:
        """``[[A, B], [C, D]]`` times ``(x, u)``, which holds the present state: for compiled loops."""
        return self._product

    def require(self, inputs: Iterable[Port], outputs: Iterable[Port], dt: float) -> None:
        """Check the ports, by name, size and unit where one is stated, and the sampling period [s].

        Raises
        ------
        ValueError
            Other ports, another unit or another period; the message lists both.
        """
        sides = ("inputs", tuple(inputs), self.inputs), ("outputs", tuple(outputs), self.outputs)
        for kind, expected, present in sides:
            known = {port.name: port for port in expected}
            for one in present:
                port = known.get(one.name, one)
                if one.size == port.size and not port.takes(one):
                    raise InputError(f"{self.name}: {kind[:-1]} {one.name} must be in {port.unit}, got {one.unit}")
            required, got = (", ".join(f"{p.name}[{p.size}]" for p in ports) for ports in (expected, present))
            if got != required:
                raise InputError(f"{self.name}: {kind} must be {required}, got {got}")
        if abs(self.dt - dt) > 1e-12:
            raise InputError(f"{self.name}: sampling period must be {dt} s, got {self.dt}")

    def with_inputs(self, ports: Sequence[Port]) -> SampledSystem:
        """The system with its inputs in another order, or behind more inputs, whose columns of B and D are zero.

        A system with an input that is not among `ports`, or has another unit there, is returned as it is;
        :meth:`require` says what is wrong.
        """
        if not all(any(port.takes(one) for port in ports) for one in self.inputs):
            return self
        if [p.name for p in self.inputs] == [p.name for p in ports]:
            return self
        B, D = (spread_columns(matrix, self.inputs, ports) for matrix in (self.B, self.D))
        return replace(self, B=B, D=D, inputs=tuple(ports))

    def step(self, u: FloatArray, out: FloatArray) -> None:
        """Write the output of this tick into `out` (p,) and go on to the next; allocates nothing.

        Each row of ``[[A, B], [C, D]]`` times ``(x, u)`` is added up from left to right, see
        :mod:`lftkit.systems.sampled.ordered_product`: the bits depend on no library and no processor.
        """
        n, values = self.A.shape[0], self._product.values
        values[n:] = u
        sums = self._product()
        out[:] = sums[n:]
        values[:n] = sums[:n]

    def steps(self, u: FloatArray) -> FloatArray:
        """Outputs (k, p) of the ticks with the inputs `u` (k, m): bit for bit those of :meth:`step`."""
        return self._product.recur(u)[:, len(self.A) :]

    def reset(self, state: FloatArray | None = None) -> None:
        """Back to the zero state, or to another `state` (n,)."""
        self._product.values[: len(self.A)] = 0.0 if state is None else state

    def to_json(self) -> str:
        """Text of the JSON file that :meth:`from_file` reads."""
        content = {
            "format": FORMAT,
            "version": VERSION,
            "name": self.name,
            "dt": self.dt,
            "inputs": [vars(port) for port in self.inputs],
            "outputs": [vars(port) for port in self.outputs],
            **{key: getattr(self, key).tolist() for key in "ABCD"},
            "design_basis": dict(self.design_basis),
            "provenance": dict(self.provenance),
        }
        return json.dumps(content, indent=1) + "\n"

    def to_file(self, path: str | os.PathLike[str]) -> None:
        """Write the JSON file that :meth:`from_file` reads, whole or not at all."""
        write_text(Path(path), self.to_json())

    @classmethod
    def from_control(cls, system: Any, units: Mapping[str, str] | None = None, name: str = "") -> SampledSystem:
        """System of a `control.StateSpace` in discrete time; signals ``port[0], port[1], ...`` become one port.

        Parameters
        ----------
        system : control.StateSpace
            With its sampling period [s].
        units : mapping, optional
            SI unit of each port by name.
        name : str, optional
            Taken from the system otherwise.

        Raises
        ------
        ValueError
            Another type, continuous time or a period that is not given in seconds, or labels from which the ports do
            not follow.
        """
        matrices, inputs, outputs = ports_and_matrices(system, units)
        if not system.dt or system.dt is True:
            raise InputError(f"system must have a sampling period in seconds, got dt {system.dt}")
        return cls(*matrices, inputs, outputs, float(system.dt), name or str(system.name))

    def to_control(self, name: str | None = None) -> control.StateSpace:
        """`control.StateSpace` of the same period, with the signal names of the ports; the present state stays behind.

        Raises
        ------
        ValueError
            A port whose name is that of a signal of another port, for instance ``w[0]``.
        """
        matrices = self.A, self.B, self.C, self.D
        return control_system(matrices, self.inputs, self.outputs, self.dt, self.name if name is None else name)

    @classmethod
    @checked
    def from_file(cls, path: str | os.PathLike[str]) -> SampledSystem:
        """Read a system from its JSON file.

        Raises
        ------
        ValueError
            The file cannot be read, is not of this format, or holds matrices that do not fit.
        """
        try:
            content = load_json(read_text(path), "it")
        except OSError as error:
            raise InputError(f"cannot read the controller file {path}: {error.strerror}") from None
        except InputError as error:
            raise InputError(f"{path} is not a controller file: {error}") from None
        except UnicodeDecodeError:
            raise InputError(f"{path} is not a controller file: it must be JSON, got no text in UTF-8") from None
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise InputError(f'{path} is not a controller file: expected JSON with "format": "{FORMAT}"')
        if content.get("version") != VERSION:
            raise InputError(f"{path}: expected version {VERSION}, got {content.get('version')}")
        if unknown := [key for key in content if key not in KEYS]:
            raise InputError(f"{path}: keys must be among {', '.join(KEYS)}, got {unknown[0]!r}")
        missing = [key for key in ("inputs", "outputs", "dt", *"ABCD") if key not in content]
        if missing:
            raise InputError(f"{path}: expected the keys {', '.join(missing)}, which are missing")
        for key in ("design_basis", "provenance"):
            if not isinstance(content.get(key, {}), dict):
                raise InputError(f"{path}: {key} must be an object of names and values, got {content[key]!r}")
        try:
            inputs, outputs = (tuple(Port(**port) for port in content[key]) for key in ("inputs", "outputs"))
            return cls(
                A=content["A"],
                B=content["B"],
                C=content["C"],
                D=content["D"],
                inputs=inputs,
                outputs=outputs,
                dt=content["dt"],
                name=str(content.get("name", Path(path).stem)),
                design_basis=content.get("design_basis", {}),
                provenance=content.get("provenance", {}),
            )
        except TypeError:
            raise InputError(f"{path}: expected ports as objects with name, size and unit") from None
        except OverflowError:
            raise InputError(f"{path}: numbers must be finite, got one that is too large") from None
        except ValueError as error:
            raise InputError(f"{path}: {error}") from None
