"""The controllers between the ports of the loop, as a stage connects them: one law from measurements to commands.

The sampled law acts one tick after the measurement, and a value of a sensor that is slower than the tick is held until
its next one. The frequency response has the delay, and of the hold its fundamental.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lftkit import SampledSystem
from lftkit.analysis.batched_linalg import solve
from lftkit.analysis.eigenvectors import modal
from lftkit.arrays import ComplexArray, FloatArray, IntArray, Matrices
from lftkit.systems.ports import port_indices
from los_loop.spec import held_response
from titop_plant.interface import DT, FORCE_STAGES, MIRROR, MIRROR_STAGES, DesignBasis
from titop_plant.telescope.loop_ports import LoopPorts


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


def _in_units(k_pma: SampledSystem, ports: LoopPorts) -> SampledSystem:
    """K_PMA with the rows that it uses, sensors and actuators in their order, and commands in units of their scale."""
    rows = port_indices(k_pma.outputs, [port.name for port in ports.commanded], "output", k_pma.name)
    law, scale = k_pma.with_inputs(ports.measured), ports.scale[:, None]
    return replace(law, C=law.C[rows] / scale, D=law.D[rows] / scale, outputs=ports.commanded)


@dataclass(frozen=True)
class ControlLaws:
    """Both controllers in a stage. **The mirror turns against the estimate, by its inverse sensitivity**.

    Parameters
    ----------
    k_fsm, k_pma : SampledSystem
        Measured ports that the file of K_FSM leaves out have no effect.
    stage : {"none", "isolator", "fsm", "fsm+pma"}
    ports : LoopPorts
        Rows that the loop has; the controllers use those that they name.
    los_sensitivity : float, optional
        Of the telescope's mirror [rad/rad]: the mirror law divides by it where the file of K_FSM does not say for which
        one it was made.

    Raises
    ------
    ValueError
        The mirror's loop is closed and nothing says a sensitivity.
    """

    k_fsm: SampledSystem
    k_pma: SampledSystem
    stage: str
    ports: LoopPorts
    los_sensitivity: float | None = None

    def __post_init__(self) -> None:
        _ = self.laws  # refused here where nothing says a sensitivity

    @cached_property
    def laws(self) -> tuple[Law, Law]:
        """K_FSM and K_PMA between columns of the measurement and of the command."""
        k_fsm, k_pma, ports, mirror = self.k_fsm, self.k_pma, self.ports, 0.0
        if self.stage in MIRROR_STAGES:
            basis = DesignBasis.from_mapping(k_fsm.design_basis, k_fsm.name)
            mirror = -1.0 / basis.mirror_sensitivity(DesignBasis(los_sensitivity=self.los_sensitivity))
        observed, used = ports.of_system("k_fsm", k_fsm).measured, ports.of_system("k_pma", k_pma)
        forces = 1.0 if self.stage in FORCE_STAGES else 0.0
        return (
            Law(k_fsm.with_inputs(observed), mirror, ports.measured_columns(observed), MIRROR),
            Law(
                _in_units(k_pma, used),
                forces,
                ports.measured_columns(used.measured),
                ports.command_columns(used.commanded),
            ),
        )

    @property
    def held_ticks(self) -> IntArray:
        """Ticks for which each measured value is held, shape (measurements,)."""
        return np.concatenate([np.full(row.port.size, row.ticks) for row in self.ports.sensors])

    def response(self, omega: FloatArray) -> ComplexArray:
        """Commands by measurements at N frequencies [rad/s], shape (N, u, y), one tick of delay and the hold in it.

        Commands are ``u = K y``: the sign of the mirror law is in K.
        """
        z = np.exp(1j * omega * DT)
        out = np.zeros((len(omega), self.ports.commands, self.ports.measurements), complex)
        rows, seen = np.arange(self.ports.commands), np.arange(self.ports.measurements)
        for law in self.laws:
            if law.gain:
                K = law.system
                part = np.ix_(np.arange(len(omega)), rows[law.command], seen[law.measured])
                out[part] = law.gain * transfer_matrices((K.A, K.B, K.C, K.D), z)
        columns = self.ports.columns
        for name, ticks in self.ports.ticks.items():
            out[:, :, columns[name]] *= held_response(z, ticks)[:, None, None]
        return np.asarray(out / z[:, None, None])

    def modes(self) -> tuple[ComplexArray, ComplexArray, ComplexArray, FloatArray]:
        """Poles (k,), B (k, y), C (u, k) and D (u, y) of both laws as one, in z, for the loops that are closed.

        Delay and hold are left out.
        """
        commands, measured = self.ports.commands, self.ports.measurements
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


__all__ = ["ControlLaws", "Law", "transfer_matrices"]
