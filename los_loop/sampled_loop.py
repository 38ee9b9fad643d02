"""The implemented loop as one sampled linear system: plant, one-tick delay, held values, controllers.

The state at a tick is ``[x, v, x_F, x_P, c]``: plant, command in force, states of K_FSM and K_PMA, last values of the
sensors that are slower than the tick (zero-order hold until the next). The loop is periodic: with a period of N ticks,
after which all sensors have a sample again, its stability is that of the product of the N one-tick matrices.

A rig has further delays (:class:`Delays`); what is on its way stands before ``c``: commands, the oldest first, and the
frame of the camera without the mirror's share. The matrices are made by :func:`los_loop.closing.sampled_loop`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar, cast

import numpy as np
from scipy import linalg

from lftkit.analysis.real_schur import RealSchur
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from titop_plant.interface import DT
from titop_plant.telescope.loop_ports import LoopPorts

Made = TypeVar("Made")


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
            raise InputError(f"delays must be zero or more ticks, got {self.commands} and {self.frames}")


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
    plant_order : int
        Number of plant states, the first of the state.
    ports : LoopPorts
        Rows of the loop.
    between : mapping of int to (ndarray, ndarray)
        The same two matrices at the other ticks of a period at which a sensor that is held has a sample.
    """

    frame: FloatArray
    hold: FloatArray
    noise_frame: FloatArray
    noise_hold: FloatArray
    truth: FloatArray
    plant_order: int
    ports: LoopPorts
    between: Mapping[int, tuple[FloatArray, FloatArray]] = field(default_factory=dict)

    @cached_property
    def frame_ticks(self) -> int:
        """N, the period: ticks from one tick with all sensors to the next."""
        return self.ports.period

    @property
    def commands(self) -> int:
        """Number of commands, forces of actuators of the telescope's file among them."""
        return self.ports.commands

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
        own = len(self.hold) - self.ports.held.size
        return self.hold[:own, :own]

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

    @property
    def growth(self) -> float:
        """Largest growth factor per tick from the Schur form, which steady states need as well; stable below 1."""
        return radius_of(self.schur.eigenvalues, self.frame_ticks)

    def steady_state(self, omega: FloatArray, forced: ComplexArray) -> ComplexArray:
        """State at tick 0 in the steady state under K tones ``exp(i w t)``, shape (n, K); of a constant w is zero.

        Parameters
        ----------
        omega : ndarray, shape (K,)
            rad/s.
        forced : ndarray, complex, shape (n, K)
            State after a period that begins at tick 0 with all states zero, per unit of the tone's phasor at tick 0.
        """
        return self.schur.solve(np.exp(1j * omega * DT * self.frame_ticks), forced)

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
