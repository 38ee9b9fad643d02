"""The loop closed: the sampled controllers around the telescope, as one-tick matrices and as frequency responses.

:func:`sampled_loop` closes it in the state space of a plant at given parameter values. It is exact: commands are held
for a tick and act one tick late, values of slower sensors are held between their samples.

:func:`closed_loop` closes it around the telescope's LFT at frequencies (:mod:`los_loop.open_loop`). What remains is a
small LFT with the channels of Delta, so that every response at any parameter values is a solution of their order
(:class:`lftkit.analysis.lft_response.LftResponse`)::

    T(w, Delta) = T11 + T12 Delta (I - M Delta)^-1 T21

Of the hold of slower sensors it has the fundamental; sidebands are left out.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import overload

import numpy as np

from lftkit import System
from lftkit.analysis.lft_response import LftResponse, feedback
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop import NONE, Delays, SampledLoop
from los_loop.spec import state_parts
from titop_plant.disturbances.wheel_and_drive_tones import no_tones
from titop_plant.interface import CAMERA, FSM_ANGLE, TRUTH
from titop_plant.sensors import CAMERA_PORT
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.simulation.plant_step import held_step, step_matrix

ACQUIRED = "acquired"
"""Among the ports that have a sample at a tick: that the camera takes a frame, which is used later."""


@dataclass(frozen=True)
class ClosedAt:
    """The loop at one frequency [rad/s], with Delta left open.

    Inputs are the normalised disturbances and signals added to the commands, outputs the controlled line of sight and
    the commands applied to the plant (:mod:`los_loop.spec`).
    """

    omega: float
    lft: LftResponse


@dataclass(frozen=True)
class ClosedLoop:
    """The loop at N frequencies, with Delta left open.

    Parameters
    ----------
    omega : ndarray, shape (N,)
        rad/s.
    lft : LftResponse
        From (Delta, disturbances, signals added to the commands) to (Delta, line of sight, commands applied).
    open : ndarray, complex, shape (N, q + y + 2, q + m + u)
        LFT of the telescope that was closed.
    control : ndarray, complex, shape (N, u, y)
        Commands by measurements that it was closed with.
    """

    omega: FloatArray
    lft: LftResponse
    open: ComplexArray
    control: ComplexArray

    def __len__(self) -> int:
        return len(self.omega)

    @overload
    def __getitem__(self, index: int) -> ClosedAt: ...

    @overload
    def __getitem__(self, index: slice) -> ClosedLoop: ...

    def __getitem__(self, index: int | slice) -> ClosedAt | ClosedLoop:
        if isinstance(index, slice):
            return ClosedLoop(self.omega[index], self.lft[index], self.open[index], self.control[index])
        return ClosedAt(float(self.omega[index]), self.lft[index])

    def __iter__(self) -> Iterator[ClosedAt]:
        return (self[k] for k in range(len(self)))


def closed_loop(lft: ComplexArray, control: ComplexArray, omega: FloatArray) -> ClosedLoop:
    """Close a law around the telescope's LFT at N frequencies.

    Parameters
    ----------
    lft : ndarray, complex, shape (N, q + y + 2, q + m + u)
        From Delta (q), m disturbances and u commands to Delta, y measurements and the line of sight
        (:meth:`los_loop.open_loop.OpenLoop.at`).
    control : ndarray, complex, shape (N, u, y)
        The law K, ``u = K y``: no sign is added.
    omega : ndarray, shape (N,)
        Frequencies [rad/s].

    Raises
    ------
    LinAlgError
        A loop that is singular.
    """
    commands, measured = control.shape[1:]
    q, u = lft.shape[1] - measured - TRUTH, lft.shape[2] - commands
    y, held, into = q + measured, lft[:, :, u:], lft[:, :, :u]
    unit = np.broadcast_to(np.eye(commands, dtype=complex), (len(omega), commands, commands))
    command = feedback(control @ held[:, q:y], np.concatenate([control, unit], axis=2))
    applied = np.concatenate([command[:, :, :measured] @ into[:, q:y], command[:, :, measured:]], axis=2)
    whole = np.concatenate([held @ applied, applied], axis=1)
    whole[:, : lft.shape[1], :u] += into
    outputs = slice(y, None)  # line of sight, then the commands
    closed = LftResponse(whole[:, :q, :q], whole[:, outputs, :q], whole[:, :q, q:], whole[:, outputs, q:])
    return ClosedLoop(omega, closed, lft, control)


def sampled_loop(
    plant: System | ModalPlant,
    control: ControlLaws,
    *,
    step: FloatArray | None = None,
    delays: Delays = NONE,
) -> SampledLoop:
    """Close the sampled loop around a plant at given parameter values.

    Parameters
    ----------
    plant : System or ModalPlant
        Continuous; inputs start with the commands, outputs are the measurements and the controlled line of sight (2),
        as in :func:`titop_plant.telescope.control_plant.loop_plant`. In modal coordinates, the plant's part of the
        state is in these.
    control : ControlLaws
        With the sensors, at their rates, and the actuators that plant and `step` have.
    step : ndarray, shape (n + m + 2, n + c), optional
        Of the plant, as :func:`titop_plant.simulation.plant_step.step_matrix` makes it without tones, if it is known.
    delays : Delays
        Of a rig. With late frames the laws must have a sensitivity of the mirror.

    Raises
    ------
    ValueError
        Frames that are later than the next one, or late ones without a sensitivity.
    """
    ports = control.ports
    commands, every = ports.commands, ports.ticks
    if delays.frames and (delays.frames >= every[CAMERA_PORT] or control.los_sensitivity is None):
        got = f"{delays.frames} of {every[CAMERA_PORT]} ticks and a sensitivity of {control.los_sensitivity}"
        raise InputError(f"late frames must come before the next one, with a sensitivity of the mirror, got {got}")
    if step is None:
        if isinstance(plant, ModalPlant):
            step = held_step(plant)
        else:
            step = step_matrix(plant, no_tones(plant.B.shape[1] - commands))
    close = _TickClosing(step, control, delays)
    due = _due(every, ports.period, delays)
    frame, noise_frame = close.matrices(due[0])
    hold, noise_hold = close.matrices(frozenset())
    some = {names: close.matrices(names) for names in set(due.values()) - {due[0], frozenset()}}
    between = {k: some[names] for k, names in due.items() if names in some}
    n = close.plant_order
    return SampledLoop(frame, hold, noise_frame, noise_hold, close.of_plant(close.truth), n, ports, between)


class _TickClosing:
    """Closes the loop over one tick.

    Parameters
    ----------
    step : ndarray, shape (n + m + 2, n + c)
        Of the plant: from its state and the command in force to its next state, measurements and line of sight.
    control : ControlLaws
    delays : Delays
    """

    def __init__(self, step: FloatArray, control: ControlLaws, delays: Delays) -> None:
        self.control, self.delays = control, delays
        commands = control.ports.commands
        n = self.plant_order = step.shape[1] - commands
        self.mirror = control.los_sensitivity or 0.0
        k_fsm, k_pma = (law.system.order for law in control.laws)
        self.plant, self.command, *self.own, held = state_parts(n, k_fsm, k_pma, control.ports)
        ends = [held.start + k * commands for k in range(delays.commands + 1)]
        self.sent = [slice(a, b) for a, b in itertools.pairwise(ends)]
        self.late = slice(ends[-1], ends[-1] + (2 if delays.frames else 0))
        self.ports = control.ports
        self.held = slice(self.late.stop, self.late.stop + self.ports.held.size)
        self.next, self.truth = step[:n], step[-TRUTH:]
        self.measured = self.of_plant(step[n:-TRUTH])

    def of_plant(self, rows: FloatArray) -> FloatArray:
        """Rows of the plant's step as rows over the whole state of the loop."""
        out = np.zeros((len(rows), self.held.stop))
        out[:, self.plant], out[:, self.command] = rows[:, : self.plant.stop], rows[:, self.plant.stop :]
        return out

    def sensed(self, sampled: frozenset[str]) -> FloatArray:
        """What the laws measure by state and noise, if the ports `sampled` have a sample at the tick."""
        measured, noise = self.measured.copy(), np.eye(len(self.measured))
        columns = self.ports.columns
        for name, part in self.ports.held_parts.items():
            rows = columns[name]
            if name not in sampled:
                measured[rows], noise[rows] = 0.0, 0.0
                measured[rows, self.held.start + part.start : self.held.start + part.stop] = np.eye(
                    part.stop - part.start
                )
            elif self.delays.frames and name == CAMERA_PORT:
                measured[CAMERA] = self.mirror * self.measured[FSM_ANGLE]
                noise[CAMERA] = self.mirror * noise[FSM_ANGLE]
                measured[CAMERA, self.late] = np.eye(2)
        return np.hstack([measured, noise])

    def matrices(self, sampled: frozenset[str]) -> tuple[FloatArray, FloatArray]:
        """Next state from the state, and from the noise of the measurement, at a tick."""
        sensed, size = self.sensed(sampled), self.held.stop
        out = np.zeros((size, sensed.shape[1]))
        out[self.plant, :size] = self.of_plant(self.next)
        out[self.held] = sensed[self.ports.held]
        if ACQUIRED in sampled:
            seen = np.hstack([self.measured, np.eye(len(self.measured))])
            out[self.late] = seen[CAMERA] - self.mirror * seen[FSM_ANGLE]
        else:
            out[self.late, self.late] = np.eye(self.late.stop - self.late.start)
        stages = [self.command, *self.sent]
        for earlier, later in itertools.pairwise(stages):
            out[earlier, later] = np.eye(earlier.stop - earlier.start)
        command = out[stages[-1]]
        for law, states in zip(self.control.laws, self.own):
            K = law.system
            out[states] = K.B @ sensed[law.measured]
            out[states, states] += K.A
            command[law.command] = law.gain * (K.D @ sensed[law.measured])
            command[law.command, states] += law.gain * K.C
        return out[:, :size], out[:, size:]


def _due(every: Mapping[str, int], period: int, delays: Delays) -> dict[int, frozenset[str]]:
    """Ports with a sample at each tick of a period; `ACQUIRED` where the camera takes a frame that is used later."""
    late = {CAMERA_PORT: delays.frames}
    due = {k: {name for name, ticks in every.items() if (k - late.get(name, 0)) % ticks == 0} for k in range(period)}
    if delays.frames:
        for k in range(0, period, every[CAMERA_PORT]):
            due[k].add(ACQUIRED)
    return {k: frozenset(names) for k, names in due.items()}


__all__ = ["ClosedAt", "ClosedLoop", "closed_loop", "sampled_loop"]
