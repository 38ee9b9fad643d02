"""Systems of python-control as matrices with named ports, and back, without loss (python-control loaded on demand)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from lftkit.arrays import Matrices
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
    """Matrices of a `control.StateSpace` with the signals of each port side by side, and the ports.

    Parameters
    ----------
    system : control.StateSpace
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

    if not isinstance(system, control.StateSpace):
        raise ValueError(f"system must be a control.StateSpace, got {type(system).__name__}")
    ports_in, columns = _side(system.input_labels, system.ninputs, units, inputs, "input")
    ports_out, rows = _side(system.output_labels, system.noutputs, units, outputs, "output")
    B, C, D = system.B[:, columns], system.C[rows], system.D[np.ix_(rows, columns)]
    return (system.A, B, C, D), ports_in, ports_out


def continuous_only(system: Any) -> None:
    """Raise a ValueError for a `control` system in discrete time; an unspecified time base passes."""
    if getattr(system, "dt", None):
        raise ValueError(
            f"system must be in continuous time, got sampling period {system.dt}: SampledSystem.from_control takes it"
        )


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
    labels: Sequence[str], count: int, units: Mapping[str, str] | None, given: Sequence[Port] | None, kind: str
) -> tuple[tuple[Port, ...], Any]:
    if len(labels) != count:  # python-control keeps one of two equal labels
        raise ValueError(f"{kind} labels must name one signal each, got {', '.join(labels)} for {count} signals")
    if not given:
        return ports_of_labels(labels, units, kind)
    return tuple(given), order_for_ports(labels, given, kind)
