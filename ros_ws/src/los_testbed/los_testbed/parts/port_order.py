"""Names of the inputs and outputs of linear controllers of other programs.

A port of several signals has the names of python-control, ``accel_Ip[0]``, or of MATLAB, ``accel_Ip(1)``, in any order.
A system without names (``u`` and ``y``, as matrices have them) is refused, or with the setting ``ports_in_order`` taken
to have all signals of its loop in the order of `titop_plant.interface`. All of it holds for .mat files and for systems
of python-control alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from lftkit.errors import InputError
from lftkit.systems.ports import Port, total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from lftkit.systems.signal_labels import labels_of_ports, ports_of_labels, zero_based

UNNAMED = {"inputs": "u", "outputs": "y"}
"""Name of the only port of a side without names."""


def with_named_ports(
    law: SampledSystem, inputs: Sequence[Port], outputs: Sequence[Port], in_order: bool
) -> SampledSystem:
    """A controller whose ports have names.

    Parameters
    ----------
    law : SampledSystem
    inputs, outputs : sequence of Port
        Of its loop.
    in_order : bool
        Whether signals without names are those of the loop in their order.

    Raises
    ------
    ValueError
        No names, or another number of signals than the loop has where the order counts.

    Examples
    --------
    >>> import numpy as np
    >>> empty = np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((1, 0))
    >>> law = SampledSystem(*empty, np.eye(1, 3), (Port("u", 3),), (Port("y", 1),), 1e-3)
    >>> with_named_ports(law, (Port("rate", 2), Port("angle", 1)), (Port("torque", 1),), True).inputs
    (Port(name='rate', size=2, unit='1'), Port(name='angle', size=1, unit='1'))
    """
    law = _counted_from_zero(law)
    for side, loop in (("inputs", tuple(inputs)), ("outputs", tuple(outputs))):
        ports: tuple[Port, ...] = getattr(law, side)
        if ports == loop or [port.name for port in ports] != [UNNAMED[side]]:
            continue
        listed, size = ", ".join(f"{port.name}[{port.size}]" for port in loop), total_size(ports)
        if not in_order:
            first = loop[0].name
            raise InputError(
                f"{side} must have names ('{first}(1)' in {side[:-1].capitalize()}Name of a struct of MATLAB, "
                f"'{first}[0]' in {side} of control.ss), or be {listed} in this order (--ports-in-order), "
                f"got {size} without names"
            )
        if size != total_size(loop):
            raise InputError(f"{side} must be {total_size(loop)}, in the order {listed}, got {size} without names")
        law = replace(law, inputs=loop) if side == "inputs" else replace(law, outputs=loop)
    known = [port for port in inputs if any((port.name, port.size) == (one.name, one.size) for one in law.inputs)]
    if len(known) == len(law.inputs) and [port.name for port in known] != [port.name for port in law.inputs]:
        return law.with_inputs(known)
    return law


def _counted_from_zero(law: SampledSystem) -> SampledSystem:
    """The system with ports for the names of MATLAB, ``w(1)``, ``w(2)``, which are single signals to others."""
    labels = [labels_of_ports(side) for side in (law.inputs, law.outputs)]
    zero = [[zero_based(label) for label in side] for side in labels]
    if zero == labels:
        return law
    units = {zero_based(port.name).partition("[")[0]: port.unit for port in (*law.inputs, *law.outputs)}
    (inputs, columns), (outputs, rows) = (ports_of_labels(side, units) for side in zero)
    return replace(law, B=law.B[:, columns], C=law.C[rows], D=law.D[rows][:, columns], inputs=inputs, outputs=outputs)
