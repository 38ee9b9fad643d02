"""The implemented loop as one sampled linear system: plant, one-tick delay, camera hold, controllers.

The state at a tick is ``[x, v, x_F, x_P, c]``: plant, command in force, states of K_FSM and K_PMA, last camera value
(zero-order hold between frames). With camera frames every N ticks the loop is periodic; its stability is that of the
product of the N one-tick matrices.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from lftkit import SampledSystem, StateSpace
from lftkit.arrays import ComplexArray, FloatArray
from los_loop.spec import HELD, laws, state_parts
from titop_plant.interface import COMMANDS, DT, MEASUREMENTS, TRUTH
from titop_plant.simulation.build import sample
from titop_plant.simulation.disturbances import no_tones


@dataclass(frozen=True)
class SampledLoop:
    """One-tick matrices of the closed loop.

    Parameters
    ----------
    frame, hold : ndarray, shape (n, n)
        Next state from state at a tick with and without a camera frame.
    noise_frame, noise_hold : ndarray, shape (n, 22)
        Next state from the measurement noise of the tick.
    truth : ndarray, shape (2, n)
        Controlled line of sight [rad] from the state.
    frame_ticks : int
        N.
    plant_order : int
        Number of plant states, the first of the state.
    """

    frame: FloatArray
    hold: FloatArray
    noise_frame: FloatArray
    noise_hold: FloatArray
    truth: FloatArray
    frame_ticks: int
    plant_order: int

    @cached_property
    def period(self) -> FloatArray:
        """State at the next camera frame from the state at a frame, before its measurement, shape (n, n)."""
        return np.asarray(np.linalg.matrix_power(self.hold, self.frame_ticks - 1) @ self.frame)

    def multipliers(self) -> ComplexArray:
        """Eigenvalues of the matrix over a frame period."""
        return np.asarray(linalg.eigvals(self.period), dtype=complex)

    def spectral_radius(self) -> float:
        """Largest growth factor per tick, the N-th root of the spectral radius over a frame period; stable below 1."""
        return radius_of(self.multipliers(), self.frame_ticks)


def radius_of(multipliers: ComplexArray, frame_ticks: int) -> float:
    """Largest growth factor per tick from the eigenvalues over a frame period."""
    return float(np.max(np.abs(multipliers)) ** (1.0 / frame_ticks))


def slow_modes(multipliers: ComplexArray, frame_ticks: int, highest: float, damping: float) -> FloatArray:
    """Frequencies [rad/s] of oscillating modes below `highest` with a damping ratio below `damping`.

    Faster modes than half of the frame rate appear at a wrong frequency, so `highest` must be below
    ``pi / (frame_ticks dt)``.
    """
    seen = multipliers[np.abs(multipliers) > 1e-6]
    poles = np.log(seen) / (frame_ticks * DT)
    found = poles[(poles.imag > 0.0) & (poles.imag < highest) & (-poles.real < damping * np.abs(poles))]
    return np.asarray(np.sort(found.imag), dtype=float)


def sampled_loop(
    plant: StateSpace,
    k_fsm: SampledSystem,
    k_pma: SampledSystem,
    *,
    loop: str,
    frame_ticks: int,
    los_sensitivity: float | None = None,
) -> SampledLoop:
    """Close the sampled loop around a plant at given parameter values.

    Parameters
    ----------
    plant : StateSpace
        Continuous; inputs start with the 8 commands, outputs are the 22 measurements and the
        controlled line of sight (2), as in :func:`titop_plant.simulation.build.build_plant`.
    k_fsm, k_pma : SampledSystem
    loop : {"isolator", "fsm", "fsm+pma"}
    frame_ticks : int
        Ticks between camera frames.
    los_sensitivity : float, optional
        Of the telescope's mirror: the mirror law divides by it where the file of K_FSM does not say for which one it
        was made.

    Raises
    ------
    ValueError
        The mirror's loop is closed and nothing says a sensitivity.
    """
    n = plant.A.shape[0]
    step = sample(plant, no_tones(), 1).step
    both = laws(k_fsm, k_pma, loop, los_sensitivity)
    X, V, *own, H = state_parts(n, k_fsm.order, k_pma.order)
    size = H.stop
    Y = np.zeros((MEASUREMENTS, size))
    Y[:, X], Y[:, V] = step[n : n + MEASUREMENTS, :n], step[n : n + MEASUREMENTS, n : n + COMMANDS]

    def tick(with_frame: bool) -> tuple[FloatArray, FloatArray]:
        measured, noise = Y.copy(), np.eye(MEASUREMENTS)
        if not with_frame:
            measured[HELD], noise[HELD] = 0.0, 0.0
            measured[HELD, H] = np.eye(HELD.size)
        sensed = np.hstack([measured, noise])
        out = np.zeros((size, size + MEASUREMENTS))
        out[X, X], out[X, V] = step[:n, :n], step[:n, n : n + COMMANDS]
        out[H] = sensed[HELD]
        command = out[V]
        for law, states in zip(both, own):
            K = law.system
            out[states] = K.B @ sensed[law.measured]
            out[states, states] += K.A
            command[law.command] = law.gain * (K.D @ sensed[law.measured])
            command[law.command, states] += law.gain * K.C
        return out[:, :size], out[:, size:]

    frame, noise_frame = tick(True)
    hold, noise_hold = tick(False)
    truth = np.zeros((TRUTH, size))
    truth[:, X], truth[:, V] = step[n + MEASUREMENTS :, :n], step[n + MEASUREMENTS :, n : n + COMMANDS]
    return SampledLoop(frame, hold, noise_frame, noise_hold, truth, frame_ticks, n)
