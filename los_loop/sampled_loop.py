"""The implemented loop as one sampled linear system: plant, one-tick delay, held values, controllers.

The state at a tick is ``[x, v, x_F, x_P, c]``: plant, command in force, states of K_FSM and K_PMA, last values of the
sensors that are slower than the tick (zero-order hold until the next). The loop is periodic: with a period of N ticks,
after which all sensors have a sample again, its stability is that of the product of the N one-tick matrices.

A rig has further delays (:class:`Delays`); what is on its way stands before ``c``: commands, the oldest first, and the
frame of the camera without the mirror's share.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar, cast

import numpy as np
from scipy import linalg

from lftkit import SampledSystem, System
from lftkit.analysis.real_schur import RealSchur
from lftkit.arrays import ComplexArray, FloatArray
from los_loop.spec import NO_DEVICES, Placed, laws, state_parts
from titop_plant.interface import (
    CAMERA,
    COLUMNS,
    COMMANDS,
    DT,
    FRAME_TICKS,
    FSM_ANGLE,
    HELD,
    HELD_PARTS,
    MEASUREMENTS,
    TRUTH,
    period_ticks,
    sample_ticks,
)
from titop_plant.sensor_table import CAMERA_PORT
from titop_plant.simulation.disturbances import no_tones
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.simulation.plant_step import held_step, step_matrix

Made = TypeVar("Made")

ACQUIRED = "acquired"
"""Among the ports that have a sample at a tick: that the camera takes a frame, which is used later."""


@dataclass(frozen=True)
class Delays:
    """Delays of a rig beside the tick that each command takes.

    Parameters
    ----------
    commands : int
        Further ticks from the measurement to the command that it causes.
    frames : int
        Ticks from the acquisition of a frame of the camera to its use, less than from one frame to the next. It is
        corrected by what the mirror has done since, as `--old-frames correct` does.

    Raises
    ------
    ValueError
        A negative delay.
    """

    commands: int = 0
    frames: int = 0

    def __post_init__(self) -> None:
        if min(self.commands, self.frames) < 0:
            raise ValueError(f"delays must be zero or more ticks, got {self.commands} and {self.frames}")


NONE = Delays()


@dataclass(frozen=True)
class SampledLoop:
    """One-tick matrices of the closed loop.

    Parameters
    ----------
    frame, hold : ndarray, shape (n, n)
        Next state from state at a tick at which all sensors have a sample, and at which those that are held have none.
    noise_frame, noise_hold : ndarray, shape (n, 22)
        Next state from the measurement noise of the tick; more columns with readings of sensors of a file.
    truth : ndarray, shape (2, n)
        Controlled line of sight [rad] from the state.
    frame_ticks : int
        N, the period: ticks from one tick with all sensors to the next.
    plant_order : int
        Number of plant states, the first of the state.
    between : mapping of int to (ndarray, ndarray)
        The same two matrices at the other ticks of a period at which a sensor that is held has a sample.
    sample_ticks : mapping of str to int
        Ticks from one sample to the next of each port that is held; those left out have one in a period.
    commands : int
        Number of commands, forces of actuators of the telescope's file among them.
    """

    frame: FloatArray
    hold: FloatArray
    noise_frame: FloatArray
    noise_hold: FloatArray
    truth: FloatArray
    frame_ticks: int
    plant_order: int
    between: Mapping[int, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    sample_ticks: Mapping[str, int] = field(default_factory=dict)
    commands: int = COMMANDS

    def at(self, tick: int) -> tuple[FloatArray, FloatArray]:
        """Next state from state and from measurement noise at a tick of the run."""
        k = tick % self.frame_ticks
        if k == 0:
            return self.frame, self.noise_frame
        return self.between.get(k, (self.hold, self.noise_hold))

    def each_tick(self, make: Callable[[FloatArray, FloatArray], Made]) -> list[Made]:
        """What `make` gives for the matrices of each tick of a period; equal matrices are made once."""
        made: dict[int, Made] = {}
        for k in range(self.frame_ticks):
            A, N = self.at(k)
            if id(A) not in made:
                made[id(A)] = make(A, N)
        return [made[id(self.at(k)[0])] for k in range(self.frame_ticks)]

    def changed(
        self, matrix: Callable[[FloatArray], FloatArray], noise: Callable[[FloatArray], FloatArray], truth: FloatArray
    ) -> SampledLoop:
        """The loop with all its matrices changed alike."""
        made = {id(A): (matrix(A), noise(N)) for A, N in self.between.values()}
        return replace(
            self,
            frame=matrix(self.frame),
            hold=matrix(self.hold),
            noise_frame=noise(self.noise_frame),
            noise_hold=noise(self.noise_hold),
            truth=truth,
            between={k: made[id(A)] for k, (A, _) in self.between.items()},
        )

    @property
    def free(self) -> FloatArray:
        """Next state from state with the held values at zero, without those."""
        return self.hold[: -HELD.size, : -HELD.size]

    @cached_property
    def period(self) -> FloatArray:
        """State a period after a tick with all sensors from the state at that tick, before its measurement (n, n)."""
        result, last = self.frame, 0
        for k in sorted(self.between):
            result, last = self.between[k][0] @ self._held_for(k - last - 1, result), k
        return self._held_for(self.frame_ticks - last - 1, result)

    def _held_for(self, ticks: int, matrix: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.matrix_power(self.hold, ticks) @ matrix)

    @cached_property
    def schur(self) -> RealSchur:
        """Schur form of :attr:`period`: eigenvalues and steady states from one decomposition."""
        return RealSchur.of(self.period)

    def multipliers(self) -> ComplexArray:
        """Eigenvalues of the matrix over a period."""
        return self._multipliers.copy()

    @cached_property
    def _multipliers(self) -> ComplexArray:
        return np.asarray(linalg.eigvals(self.period), dtype=complex)

    def spectral_radius(self) -> float:
        """Largest growth factor per tick, the N-th root of the spectral radius over a period; stable below 1."""
        return radius_of(self.multipliers(), self.frame_ticks)

    def slow_modes(self, multipliers: ComplexArray, highest: float, damping: float) -> FloatArray:
        """Frequencies [rad/s] of oscillating modes below `highest` with a damping ratio below `damping`.

        Parameters
        ----------
        multipliers : ndarray
            Of :meth:`multipliers`.
        highest, damping : float
        """
        if highest < np.pi / (self.frame_ticks * DT):
            return slow_modes(multipliers, self.frame_ticks, highest, damping)
        values, vectors = cast("tuple[ComplexArray, ComplexArray]", linalg.eig(self.period))
        light = -np.log(np.maximum(np.abs(values), 1e-300)) < damping * highest * self.frame_ticks * DT
        values, state = values[light], vectors[:, light].astype(complex)
        turned: ComplexArray = np.zeros(values.size, complex)
        for k in range(self.frame_ticks):  # of frequencies that are alike over a period: that at which the state turns
            after = self.at(k)[0] @ state
            turned += np.sum(state.conj() * after, axis=0)
            state = after
        phase = np.angle(values)
        phase = phase + 2.0 * np.pi * np.round((self.frame_ticks * np.angle(turned) - phase) / (2.0 * np.pi))
        poles = (np.log(np.abs(values)) + 1j * phase) / (self.frame_ticks * DT)
        return _slow(poles, highest, damping)


def periodic_covariances(ticks: Sequence[tuple[FloatArray, FloatArray]]) -> list[FloatArray]:
    """Covariance of the state before each tick of a period, in the steady state.

    Parameters
    ----------
    ticks : sequence of (ndarray, ndarray)
        Matrix A of each tick and covariance Q of the noise it adds, shape (n, n); stable over the period.
    """
    size = len(ticks[0][0])
    period: FloatArray = np.eye(size)
    added: FloatArray = np.zeros((size, size))
    for A, Q in ticks:
        period, added = A @ period, A @ added @ A.T + Q
    found = [np.asarray(linalg.solve_discrete_lyapunov(period, added), dtype=float)]
    for A, Q in ticks[:-1]:
        found.append(A @ found[-1] @ A.T + Q)
    return found


def radius_of(multipliers: ComplexArray, frame_ticks: int) -> float:
    """Largest growth factor per tick from the eigenvalues over a frame period."""
    return float(np.max(np.abs(multipliers)) ** (1.0 / frame_ticks))


def slow_modes(multipliers: ComplexArray, frame_ticks: int, highest: float, damping: float) -> FloatArray:
    """Frequencies [rad/s] of oscillating modes below `highest` with a damping ratio below `damping`.

    Faster modes than half of the frame rate appear at a wrong frequency, so `highest` must be below
    ``pi / (frame_ticks dt)``.
    """
    seen = multipliers[np.abs(multipliers) > 1e-6]
    return _slow(np.asarray(np.log(seen) / (frame_ticks * DT), dtype=complex), highest, damping)


def _slow(poles: ComplexArray, highest: float, damping: float) -> FloatArray:
    """Frequencies [rad/s] of the oscillating ones below `highest` with a damping ratio below `damping`."""
    found = poles[(poles.imag > 0.0) & (poles.imag < highest) & (-poles.real < damping * np.abs(poles))]
    return np.asarray(np.sort(found.imag), dtype=float)


def sampled_loop(
    plant: System | ModalPlant,
    k_fsm: SampledSystem,
    k_pma: SampledSystem,
    *,
    loop: str,
    frame_ticks: int = FRAME_TICKS,
    los_sensitivity: float | None = None,
    step: FloatArray | None = None,
    delays: Delays = NONE,
    placed: Placed = NO_DEVICES,
) -> SampledLoop:
    """Close the sampled loop around a plant at given parameter values.

    Parameters
    ----------
    plant : System or ModalPlant
        Continuous; inputs start with the 8 commands, outputs are the 22 measurements and the
        controlled line of sight (2), as in :func:`titop_plant.simulation.build.build_plant`. In modal coordinates, the
        plant's part of the state is in these.
    k_fsm, k_pma : SampledSystem
    loop : {"isolator", "fsm", "fsm+pma"}
    frame_ticks : int
        Ticks between camera frames; other sensors have the rate of their entry.
    los_sensitivity : float, optional
        Of the telescope's mirror: the mirror law divides by it where the file of K_FSM does not say for which one it
        was made.
    step : ndarray, shape (n + 24, n + 8), optional
        Of the plant, as :func:`titop_plant.simulation.plant_step.step_matrix` makes it without tones, if it is known.
    delays : Delays
        Of a rig. With late frames the sensitivity must be given.
    placed : Placed
        Sensors and actuators of the telescope's file that the controllers may use: plant and `step` have the readings
        behind the line of sight, and the forces behind the commands. A plant in modal coordinates has no such forces:
        `step` must be given then.

    Raises
    ------
    ValueError
        The mirror's loop is closed and nothing says a sensitivity; frames that are later than the next one.
    """
    if delays.frames and (delays.frames >= frame_ticks or los_sensitivity is None):
        got = f"{delays.frames} of {frame_ticks} ticks and a sensitivity of {los_sensitivity}"
        raise ValueError(f"late frames must come before the next one, with a sensitivity of the mirror, got {got}")
    if step is None:
        if isinstance(plant, ModalPlant):
            step = held_step(plant)
        else:
            commands = placed.commands
            step = step_matrix(plant, no_tones(plant.B.shape[1] - commands), commands=commands)
    commands, sensed_size = placed.commands, placed.measurements
    n = step.shape[1] - commands
    both = laws(k_fsm, k_pma, loop, los_sensitivity, placed)
    X, V, *own, H = state_parts(n, k_fsm.order, k_pma.order, commands)
    sent = [slice(H.start + k * commands, H.start + (k + 1) * commands) for k in range(delays.commands)]
    Q = slice(H.start + commands * len(sent), H.start + commands * len(sent) + (2 if delays.frames else 0))
    H = slice(Q.stop, Q.stop + HELD.size)
    size = H.stop
    mirror = los_sensitivity or 0.0
    truth = slice(n + MEASUREMENTS, n + MEASUREMENTS + TRUTH)
    Y = _of_plant(np.delete(step, truth, axis=0)[n:], X, V, size)
    seen = np.hstack([Y, np.eye(sensed_size)])

    def tick(sampled: frozenset[str]) -> tuple[FloatArray, FloatArray]:
        measured, noise = Y.copy(), np.eye(sensed_size)
        for name, part in HELD_PARTS.items():
            if name not in sampled:
                measured[COLUMNS[name]], noise[COLUMNS[name]] = 0.0, 0.0
                measured[COLUMNS[name], H.start + part.start : H.start + part.stop] = np.eye(part.stop - part.start)
            elif delays.frames and name == CAMERA_PORT:
                measured[CAMERA], noise[CAMERA] = mirror * Y[FSM_ANGLE], mirror * noise[FSM_ANGLE]
                measured[CAMERA, Q] = np.eye(2)
        sensed = np.hstack([measured, noise])
        out = np.zeros((size, size + sensed_size))
        out[X, :size] = _of_plant(step[:n], X, V, size)
        out[H] = sensed[HELD]
        if ACQUIRED in sampled:
            out[Q] = seen[CAMERA] - mirror * seen[FSM_ANGLE]
        else:
            out[Q, Q] = np.eye(Q.stop - Q.start)
        for earlier, later in itertools.pairwise([V, *sent]):
            out[earlier, later] = np.eye(commands)
        command = out[[V, *sent][-1]]
        for law, states in zip(both, own):
            K = law.system
            out[states] = K.B @ sensed[law.measured]
            out[states, states] += K.A
            command[law.command] = law.gain * (K.D @ sensed[law.measured])
            command[law.command, states] += law.gain * K.C
        return out[:, :size], out[:, size:]

    every, period = sample_ticks(frame_ticks), period_ticks(frame_ticks)
    due = _due(every, period, delays)
    frame, noise_frame = tick(due[0])
    hold, noise_hold = tick(frozenset())
    some = {names: tick(names) for names in set(due.values()) - {due[0], frozenset()}}
    between = {k: some[names] for k, names in due.items() if names in some}
    los = _of_plant(step[truth], X, V, size)
    return SampledLoop(frame, hold, noise_frame, noise_hold, los, period, n, between, every, commands)


def _of_plant(rows: FloatArray, states: slice, commands: slice, size: int) -> FloatArray:
    """Rows of the plant's step as rows over the whole state of the loop."""
    out = np.zeros((len(rows), size))
    out[:, states], out[:, commands] = rows[:, : states.stop], rows[:, states.stop :]
    return out


def _due(every: Mapping[str, int], period: int, delays: Delays) -> dict[int, frozenset[str]]:
    """Ports with a sample at each tick of a period; `ACQUIRED` where the camera takes a frame that is used later."""
    late = {CAMERA_PORT: delays.frames}
    due = {k: {name for name, ticks in every.items() if (k - late.get(name, 0)) % ticks == 0} for k in range(period)}
    if delays.frames:
        for k in range(0, period, every[CAMERA_PORT]):
            due[k].add(ACQUIRED)
    return {k: frozenset(names) for k, names in due.items()}
