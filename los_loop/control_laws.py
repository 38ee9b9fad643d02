"""The controllers between the ports of the loop, as a stage connects them: one law from measurements to commands.

The sampled law acts one tick after the measurement, and a value of a sensor that is slower than the tick is held until
its next one. The frequency response has the delay, and of the hold its fundamental.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lftkit import SampledSystem
from lftkit.analysis.batched_linalg import solve
from lftkit.analysis.eigenvectors import modal
from lftkit.arrays import ComplexArray, FloatArray, IntArray, Matrices
from lftkit.systems.ports import Port, port_slices
from los_loop.spec import NO_DEVICES, Placed, held_response
from titop_plant.interface import (
    COLUMNS,
    COMMANDED,
    COMMANDS,
    DT,
    FORCE_STAGES,
    FRAME_TICKS,
    K_FSM_INPUTS,
    K_PMA_INPUTS,
    K_PMA_OUTPUTS,
    MEASUREMENTS,
    MIRROR_STAGES,
    DesignBasis,
    sample_ticks,
)


@dataclass(frozen=True)
class Law:
    """A controller in the loop: from columns of the measurement to columns of the command.

    Parameters
    ----------
    system : SampledSystem
    gain : float
        From its output to the command; 0 where its loop is open.
    measured, command : slice or ndarray of int
    """

    system: SampledSystem
    gain: float
    measured: slice | IntArray
    command: slice | IntArray


def _in_order(k_pma: SampledSystem, placed: Placed) -> SampledSystem:
    """K_PMA with its further ports in the order of the telescope, and the forces of its actuators in their units."""
    sensed = {port.name for port in k_pma.inputs}
    k_pma = k_pma.with_inputs((*K_PMA_INPUTS, *(port for port in placed.sensors if port.name in sensed)))
    units = dict(zip((port.name for port in placed.actuators), placed.units))
    at, own = port_slices(k_pma.outputs), {port.name: port for port in k_pma.outputs}
    names = [*(port.name for port in K_PMA_OUTPUTS), *(port.name for port in placed.actuators if port.name in own)]
    rows = np.concatenate([np.arange(at[name].start, at[name].stop) for name in names])
    size = np.concatenate([np.full(own[name].size, units.get(name, 1.0)) for name in names])
    outputs = tuple(own[name] for name in names)
    return replace(k_pma, C=k_pma.C[rows] / size[:, None], D=k_pma.D[rows] / size[:, None], outputs=outputs)


def columns(ports: Sequence[Port]) -> slice:
    """Columns of neighbouring ports in their vector.

    Examples
    --------
    >>> columns(K_FSM_INPUTS), columns(K_PMA_INPUTS)
    (slice(0, 22, None), slice(0, 6, None))
    """
    return slice(COLUMNS[ports[0].name].start, COLUMNS[ports[-1].name].stop)


@dataclass(frozen=True)
class ControlLaws:
    """Both controllers in a stage. **The mirror turns against the estimate, by its inverse sensitivity**.

    Parameters
    ----------
    k_fsm, k_pma : SampledSystem
        Measured ports that the file of K_FSM leaves out have no effect.
    stage : {"none", "isolator", "fsm", "fsm+pma"}
    los_sensitivity : float, optional
        Of the telescope's mirror [rad/rad]: the mirror law divides by it where the file of K_FSM does not say for which
        one it was made.
    placed : Placed
        Of the telescope. A controller has the sensors that it uses behind its other inputs, in this order, and K_PMA
        the actuators behind its other outputs.

    Attributes
    ----------
    laws : tuple of Law
        K_FSM and K_PMA between columns of the measurement and of the command.

    Raises
    ------
    ValueError
        The mirror's loop is closed and nothing says a sensitivity.
    """

    k_fsm: SampledSystem
    k_pma: SampledSystem
    stage: str
    los_sensitivity: float | None = None
    placed: Placed = NO_DEVICES
    laws: tuple[Law, Law] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "laws", self._laws())

    def _laws(self) -> tuple[Law, Law]:
        k_fsm, k_pma, placed, mirror = self.k_fsm, self.k_pma, self.placed, 0.0
        if self.stage in MIRROR_STAGES:
            basis = DesignBasis.from_mapping(k_fsm.design_basis, k_fsm.name)
            mirror = -1.0 / basis.mirror_sensitivity(DesignBasis(los_sensitivity=self.los_sensitivity))
        angle, force = COMMANDED[0], K_PMA_OUTPUTS[0].name
        seen = [placed.columns(columns(K_FSM_INPUTS), k_fsm.inputs, placed.sensors, MEASUREMENTS)]
        seen.append(placed.columns(columns(K_PMA_INPUTS), k_pma.inputs, placed.sensors, MEASUREMENTS))
        driven = placed.columns(COLUMNS[force], k_pma.outputs, placed.actuators, COMMANDS)
        names = {port.name for port in k_fsm.inputs}
        if placed != NO_DEVICES:
            k_pma = _in_order(k_pma, placed)
        k_fsm = k_fsm.with_inputs((*K_FSM_INPUTS, *(port for port in placed.sensors if port.name in names)))
        return (
            Law(k_fsm, mirror, seen[0], COLUMNS[angle]),
            Law(k_pma, 1.0 if self.stage in FORCE_STAGES else 0.0, seen[1], driven),
        )

    @property
    def held_ticks(self) -> IntArray:
        """Ticks for which each measured value is held, shape (measurements,), at the frame rate of the reference."""
        found = np.ones(self.placed.measurements, dtype=np.int64)
        for name, ticks in sample_ticks(FRAME_TICKS).items():
            found[COLUMNS[name]] = ticks
        return found

    def response(self, omega: FloatArray) -> ComplexArray:
        """Commands by measurements at N frequencies [rad/s], shape (N, 8, 22), one tick of delay and the hold in it.

        Commands are ``u = K y``: the sign of the mirror law is in K. Forces of actuators of a file and readings of its
        sensors are behind the 8 and the 22.
        """
        z = np.exp(1j * omega * DT)
        out = np.zeros((len(omega), self.placed.commands, self.placed.measurements), complex)
        rows, seen = np.arange(self.placed.commands), np.arange(self.placed.measurements)
        for law in self.laws:
            if law.gain:
                K = law.system
                part = np.ix_(np.arange(len(omega)), rows[law.command], seen[law.measured])
                out[part] = law.gain * transfer_matrices((K.A, K.B, K.C, K.D), z)
        for name, ticks in sample_ticks(FRAME_TICKS).items():
            out[:, :, COLUMNS[name]] *= held_response(z, ticks)[:, None, None]
        return np.asarray(out / z[:, None, None])

    def modes(self) -> tuple[ComplexArray, ComplexArray, ComplexArray, FloatArray]:
        """Poles (k,), B (k, 22), C (8, k) and D (8, 22) of both laws as one, in z, for the loops that are closed.

        Delay and hold are left out.
        """
        commands, measured = self.placed.commands, self.placed.measurements
        D, rows, seen = np.zeros((commands, measured)), np.arange(commands), np.arange(measured)
        poles: list[ComplexArray] = [np.zeros(0, complex)]
        into: list[ComplexArray] = [np.zeros((0, measured), complex)]
        out: list[ComplexArray] = [np.zeros((commands, 0), complex)]
        for law in self.laws:
            if not law.gain:
                continue
            K, gain = law.system, law.gain
            p, b, c = modal(K.A, K.B, K.C)
            B, C = np.zeros((len(p), measured), complex), np.zeros((commands, len(p)), complex)
            B[:, law.measured], C[law.command] = b, gain * c
            D[np.ix_(rows[law.command], seen[law.measured])] = gain * K.D
            poles.append(p)
            into.append(B)
            out.append(C)
        return np.concatenate(poles), np.vstack(into), np.hstack(out), D


def transfer_matrices(matrices: Matrices, points: ComplexArray) -> ComplexArray:
    """``D + C (p I - A)^-1 B`` at N points p of the s plane or the z plane, shape (N, outputs, inputs).

    A solution at each point, for controllers of a few states; :class:`lftkit.analysis.frequency_response` is for more.
    """
    A, B, C, D = matrices
    if not len(A):
        return np.asarray(np.broadcast_to(D, (len(points), *D.shape)), dtype=complex)
    shifted = np.asarray(points[:, None, None] * np.eye(len(A)) - A, dtype=complex)
    entered = np.broadcast_to(B.astype(complex), (len(points), *B.shape))
    return np.asarray(D + C @ solve(shifted, entered))


__all__ = ["ControlLaws", "Law", "columns", "transfer_matrices"]
