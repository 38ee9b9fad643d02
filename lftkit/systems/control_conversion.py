"""Systems of python-control as matrices with named ports, and back, without loss (python-control loaded on demand)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.systems.ports import Port
from lftkit.systems.signal_labels import labels_of_ports, order_for_ports, ports_of_labels

if TYPE_CHECKING:
    import control


def ports_and_matrices(
    system: Any,
    units: Mapping[str, str] | None = None,
    inputs: Sequence[Port] | None = None,
    outputs: Sequence[Port] | None = None,
) -> tuple[Matrices, tuple[Port, ...], tuple[Port, ...]]:
    """Matrices of a system of python-control with the signals of each port side by side, and the ports.

    Parameters
    ----------
    system : control.StateSpace or control.TransferFunction
        In continuous or discrete time; its period is left to the caller.
    units : mapping, optional
        Unit of each port by name.
    inputs, outputs : sequence of Port, optional
        Ports whose signals are the labels in some order, or which name them anew. Otherwise ``w[0], w[1], ...`` become
        one port ``w``.

    Raises
    ------
    ValueError
        Another type, or labels from which the ports do not follow.
    """
    import control

    if isinstance(system, control.TransferFunction):
        # State space of a transfer matrix, each entry with states of its own
        rows, columns = system.noutputs, system.ninputs
        A, B, C, D = (np.zeros(shape) for shape in ((0, 0), (0, columns), (rows, 0), (rows, columns)))
        for i in range(rows):
            for j in range(columns):
                a, b, c, d = rational(system.num[i][j], system.den[i][j])
                n, new = len(A), len(a)
                A = np.block([[A, np.zeros((n, new))], [np.zeros((new, n)), a]])
                B, C = np.vstack([B, np.zeros((new, columns))]), np.hstack([C, np.zeros((rows, new))])
                B[n:, j], C[i, n:], D[i, j] = b, c, d
        matrices = A, B, C, D
    elif isinstance(system, control.StateSpace):
        matrices = system.A, system.B, system.C, system.D
    else:
        raise InputError(
            f"system must be a control.StateSpace or control.TransferFunction, got {type(system).__name__}"
        )
    A, B, C, D = matrices
    ports_in, columns = _side(system.input_labels, system.ninputs, units, inputs, "input")
    ports_out, rows = _side(system.output_labels, system.noutputs, units, outputs, "output")
    return (A, B[:, columns], C[rows], D[np.ix_(rows, columns)]), ports_in, ports_out


def rational(num: ArrayLike, den: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Companion form A (n, n), b (n,), c (n,), d of num / den, coefficients from the highest power down.

    Raises
    ------
    ValueError
        A numerator of higher degree than the denominator, or a denominator that is zero.
    """
    top = np.trim_zeros(np.atleast_1d(np.asarray(num, dtype=float)), "f")
    bottom = np.trim_zeros(np.atleast_1d(np.asarray(den, dtype=float)), "f")
    if not len(bottom) or len(top) > len(bottom):
        raise InputError(f"transfer function must be proper, got {np.asarray(num)} / {np.asarray(den)}")
    n = len(bottom) - 1
    a = bottom / bottom[0]
    b = np.concatenate([np.zeros(n + 1 - len(top)), top]) / bottom[0]
    A, e = np.diag(np.ones(max(n - 1, 0)), 1) if n else np.zeros((0, 0)), np.zeros(n)
    if n:
        A[-1], e[-1] = -a[:0:-1], 1.0
    return A, e, (b[1:] - a[1:] * b[0])[::-1], float(b[0])


def control_system(
    matrices: Matrices,
    inputs: Sequence[Port],
    outputs: Sequence[Port],
    dt: float | None,
    name: str,
) -> control.StateSpace:
    """`control.StateSpace` with the labels of the ports.

    Raises
    ------
    ValueError
        A port whose name would be read as that of a single signal.
    """
    import control

    return control.ss(
        *matrices,
        dt,
        inputs=labels_of_ports(inputs, f"{name}: input"),
        outputs=labels_of_ports(outputs, f"{name}: output"),
        name=name,
        remove_useless_states=False,
    )


def _side(
    labels: Sequence[str], count: int, units: Mapping[str, str] | None, stated: Sequence[Port] | None, kind: str
) -> tuple[tuple[Port, ...], Any]:
    if len(labels) != count:  # python-control keeps one of two equal labels
        raise InputError(f"{kind} labels must name one signal each, got {', '.join(labels)} for {count} signals")
    if not stated:
        return ports_of_labels(labels, units, kind)
    return tuple(stated), order_for_ports(labels, stated, kind)
