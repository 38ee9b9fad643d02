"""Linear models with named ports: the one state-space type (numpy only).

A :class:`StateSpace` is a plant at given parameter values, a weight or a controller. Signals are chosen by port name,
never by position. :class:`lftkit.UncertainSystem` (with parameters) and :class:`lftkit.SampledSystem` (in discrete
time, ready to run) hold one each.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray, IntArray, Matrices
from lftkit.systems.control_conversion import continuous_only, control_system, ports_and_matrices
from lftkit.systems.ports import Port, as_ports, port_indices, read_only, total_size
from lftkit.systems.system_summary import named_line

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class StateSpace:
    """Continuous-time linear system ``x' = A x + B u, y = C x + D u`` with named ports.

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (n, n), (n, m), (p, n), (p, m); n may be 0. Kept as read-only copies.
    inputs, outputs : sequence of Port (or of (name, size))
        Sizes add up to m and p; names are unique on each side.
    name : str
        Name of the model in messages and results (for instance the parameter values).

    Raises
    ------
    ValueError
        Shapes that do not fit the ports, a name used twice, numbers that are not finite.

    Examples
    --------
    >>> mass = StateSpace([[0, 1], [0, 0]], [[0], [0.5]], [[1, 0]], [[0]], [("force", 1)], [("position", 1)], "2 kg")
    >>> mass.order, mass.channel(["force"], ["position"]).B.ravel().tolist()
    (2, [0.0, 0.5])
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    name: str = "system"

    def __post_init__(self) -> None:
        for side in ("inputs", "outputs"):
            object.__setattr__(self, side, as_ports(getattr(self, side), f"{self.name}, {side}"))
        try:
            matrices = checked_matrices(*self.matrices, total_size(self.inputs), total_size(self.outputs))
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None
        for key, matrix in zip("ABCD", matrices):
            object.__setattr__(self, key, matrix)

    def __repr__(self) -> str:
        return named_line(self, self.name)

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def matrices(self) -> Matrices:
        """(A, B, C, D)."""
        return self.A, self.B, self.C, self.D

    def input_indices(self, names: Iterable[str]) -> IntArray:
        """Columns of the ports `names`, in the given order."""
        return port_indices(self.inputs, names, "input", self.name)

    def output_indices(self, names: Iterable[str]) -> IntArray:
        """Rows of the ports `names`, in the given order."""
        return port_indices(self.outputs, names, "output", self.name)

    def channel(self, inputs: Sequence[str], outputs: Sequence[str]) -> StateSpace:
        """Subsystem from the ports `inputs` to the ports `outputs`; all states are kept."""
        columns, rows = self.input_indices(inputs), self.output_indices(outputs)
        by_in = {p.name: p for p in self.inputs}
        by_out = {p.name: p for p in self.outputs}
        return StateSpace(
            self.A,
            self.B[:, columns],
            self.C[rows],
            self.D[np.ix_(rows, columns)],
            tuple(by_in[n] for n in inputs),
            tuple(by_out[n] for n in outputs),
            self.name,
        )

    def renamed(self, name: str) -> StateSpace:
        """Same model under another name."""
        return replace(self, name=name)

    @classmethod
    def static(cls, gain: ArrayLike, inputs: Sequence[Any], outputs: Sequence[Any], name: str = "gain") -> StateSpace:
        """Model without states, ``y = gain u``."""
        none = np.zeros((0, 0))
        return cls(none, none, none, np.atleast_2d(np.asarray(gain, dtype=float)), tuple(inputs), tuple(outputs), name)

    @classmethod
    def from_control(cls, system: Any, units: Mapping[str, str] | None = None, name: str = "") -> StateSpace:
        """Model of a `control.StateSpace`; signals ``port[0], port[1], ...`` become one port, wherever they stand.

        Parameters
        ----------
        system : control.StateSpace
            Continuous time (dt 0 or None).
        units : mapping, optional
            SI unit of each port by name.
        name : str, optional
            Taken from the system otherwise.

        Raises
        ------
        ValueError
            Another type, a system in discrete time (:meth:`SampledSystem.from_control` takes it), or labels from which
            the ports do not follow: one used twice, a missing index, ``w`` beside ``w[0]``.
        """
        matrices, inputs, outputs = ports_and_matrices(system, units)
        continuous_only(system)
        return cls(*matrices, inputs, outputs, name or str(system.name))

    def to_control(self, name: str | None = None) -> control.StateSpace:
        """`control.StateSpace` with the signal names of the ports, from which :meth:`from_control` makes them again.

        Raises
        ------
        ValueError
            A port whose name is that of a signal of another port, for instance ``w[0]``.
        """
        dt = 0.0 if self.order else None  # a gain may stand in either time
        return control_system(self.matrices, self.inputs, self.outputs, dt, self.name if name is None else name)


def checked_matrices(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, inputs: int | None = None, outputs: int | None = None
) -> Matrices:
    """Read-only float copies of the four matrices after a check of shapes and finiteness.

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (n, n), (n, m), (p, n), (p, m). A matrix without entries may have any shape where it fits.
    inputs, outputs : int, optional
        m and p; those of D otherwise.

    Raises
    ------
    ValueError
        Wrong shape or an entry that is not finite; the message names the matrix, its required and its actual shape.
    """
    given = {key: real_array(key, value) for key, value in zip("ABCD", (A, B, C, D))}
    d = np.atleast_2d(given["D"])
    m = d.shape[1] if inputs is None else inputs
    p = d.shape[0] if outputs is None else outputs
    n = given["A"].shape[0] if given["A"].size and given["A"].ndim else 0
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    for key, shape in shapes.items():
        matrix = given[key]
        if matrix.size == 0 and 0 in shape:
            matrix = np.zeros(shape)
        matrix = np.atleast_2d(matrix)
        if matrix.shape != shape:
            raise ValueError(
                f"matrix {key} must be {shape[0]} x {shape[1]} to fit states and ports, "
                f"got {' x '.join(map(str, matrix.shape))}"
            )
        if not np.all(np.isfinite(matrix)):
            row, column = np.argwhere(~np.isfinite(matrix))[0]
            raise ValueError(f"matrix {key} must be finite, got {matrix[row, column]} in entry [{row}, {column}]")
        given[key] = read_only(matrix)
    return given["A"], given["B"], given["C"], given["D"]


def real_array(key: str, value: ArrayLike) -> FloatArray:
    """`value` as an array of floats; a ValueError names the matrix `key` where it holds anything but real numbers."""
    try:
        if np.iscomplexobj(value):
            raise TypeError
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(
            f"matrix {key} must be a rectangular array of real numbers, got {type(value).__name__}"
        ) from None
