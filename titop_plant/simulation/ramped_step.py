"""State propagation of a telescope with varying wheel speeds and array angle.

The one-tick matrices of :mod:`titop_plant.simulation.plant_step` are prepared at nodes of the profile and
interpolated linearly between them, at the middle of each tick. They are entire functions of parameters and of tone
frequencies that vary on the scale of 1 / tick, so that nodes 10 rad/s or 0.06 rad apart are enough (:data:`SPEED_STEP`,
:data:`ANGLE_STEP`); a test compares them with ten times finer nodes and ticks. Tones of the wheels follow them
phase-exactly, with amplitudes proportional to the square of the speed::

    d(t) = sum_k Im( a_k Omega_i(t)^2 exp(i h_k phi_i(t)) ),   phi_i' = Omega_i, signed

Omitted: the reaction torque J dOmega/dt of the motors, which the attitude control carries, and the terms of the array's
rate in the equations of motion, of the size of rate over frequency.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, IntArray
from lftkit.systems.sampled.ordered_product import add_up
from titop_plant.disturbances.wheel_and_drive_tones import Tones
from titop_plant.interface import DT
from titop_plant.simulation.compilation import kernel
from titop_plant.simulation.kernel_arrays import Course, StepArrays
from titop_plant.simulation.plant_step import whole_step
from titop_plant.telescope.motion_profiles import MotionProfile

SPEED_STEP, ANGLE_STEP = 10.0, 0.06
"""Largest change of a wheel speed [rad/s] and of the array angle [rad] from one node to the next."""

KNOTS, LIGHT = 200, 0.1
"""Most knots of a profile, and the damping ratio below which modes are named, in a report."""

MODES_SHOWN = 12
"""Most times at which a report has the modes."""

LONGEST = 1.0
"""Longest time between nodes [s]."""


@dataclass(frozen=True)
class MovingTones:
    """Tones whose frequencies follow the wheels.

    Parameters
    ----------
    profile : MotionProfile
    unit : Tones
        Tones of the wheels at 1 rad/s, turning in the positive sense, and tones of fixed frequency.
    """

    profile: MotionProfile
    unit: Tones

    def at(self, speed: FloatArray) -> Tones:
        """Unit amplitudes at the frequencies, signed, that belong to wheel speeds (4,) [rad/s]."""
        follows = self.unit.wheel >= 0
        signed = self.unit.harmonic * speed[np.maximum(self.unit.wheel, 0)]
        return replace(self.unit, frequency=np.where(follows, signed, self.unit.frequency))

    def phasors(self, time: ArrayLike) -> ComplexArray:
        """Phasors at times (...) [s], shape (..., K): ``Omega^2 exp(i h phi)``, of fixed tones ``exp(i w t)``."""
        t = np.asarray(time, dtype=float)
        follows, wheel = self.unit.wheel >= 0, np.maximum(self.unit.wheel, 0)
        phase = self.unit.harmonic * self.profile.turned(t)[..., wheel]
        size = np.where(follows, self.profile.speeds(t)[..., wheel] ** 2, 1.0)
        return np.asarray(size * np.exp(1j * np.where(follows, phase, self.unit.frequency * t[..., None])))

    def start(self) -> Tones:
        """The tones at the start as tones of constant, positive frequency."""
        signed = self.at(self.profile.speeds(0.0))
        amplitude = signed.amplitude * self.phasors(0.0)
        mirrored = np.where(signed.frequency < 0.0, -amplitude.conj(), amplitude)
        return replace(signed, frequency=np.abs(signed.frequency), amplitude=mirrored)


def node_interval(profile: MotionProfile, dt: float, finer: float = 1.0) -> int:
    """Ticks between nodes of a profile."""
    theta, speed = profile.steepest()
    seconds = min(LONGEST, ANGLE_STEP / max(theta, 1e-12), SPEED_STEP / max(speed, 1e-12)) / finer
    return max(1, round(seconds / dt))


def node_matrices(
    profile: MotionProfile, interval: int, dt: float, matrices: Callable[[float], FloatArray]
) -> list[FloatArray]:
    """Step matrices (of `step_matrix`, phasors of size 1) at the nodes; `matrices` gives them at a time [s]."""
    count = math.ceil(profile.duration / (interval * dt) - 1e-9) + 1
    return [matrices(min(k * interval * dt, profile.duration)) for k in range(count)]


class RampedStep:
    """State at the start of a telescope whose parameters follow a profile, and its next state.

    It has the interface of :class:`titop_plant.simulation.constant_step.ConstantStep`; its coordinates are the states.

    Parameters
    ----------
    nodes : sequence of ndarray, shape (n + m + 2, n + c + 2 K)
        Step matrices every `interval` ticks.
    interval : int
    moving : MovingTones
        Of the profile, K tones.
    start : ndarray, shape (n,)
        State at tick 0.
    dt : float
        Sampling period [s].
    """

    def __init__(
        self, nodes: Sequence[FloatArray], interval: int, moving: MovingTones, start: FloatArray, dt: float = DT
    ) -> None:
        self.interval, self.moving, self.start, self.dt = interval, moving, start, dt
        self.tones = np.unique(moving.unit.frequency[moving.unit.wheel < 0])
        self.numbers = numbers = whole_step(nodes[0], np.ones(moving.unit.frequency.size, complex), len(start))
        self.nodes = np.ascontiguousarray(np.stack(nodes).transpose(0, 2, 1))
        self.arrays = StepArrays(
            numbers.pairs,
            numbers.own,
            numbers.cross,
            numbers.driven,
            numbers.block,
            numbers.outputs,
            numbers.turn,
            self.nodes,
        )
        self.compiled = False
        self._next, self._other = np.zeros(self.nodes.shape[2]), np.zeros(self.nodes.shape[2])
        self._products = np.zeros(self.nodes.shape[1:])

    @cached_property
    def motion(self) -> dict[str, list[Any]]:
        """Motion for reports: knots (time, theta, four speeds), harmonics, modes at the start and over time.

        A row of ``modes_over_time`` is a time [s] and the frequencies [rad/s] of the lightly damped modes there.
        """
        table = self.moving.profile.table()
        knots = table[:: -(-len(table) // KNOTS)]
        if knots[-1] != table[-1]:
            knots.append(table[-1])
        harmonics = np.unique(self.moving.unit.harmonic[self.moving.unit.wheel >= 0])
        shown = np.unique(np.linspace(0, len(self.nodes) - 1, MODES_SHOWN).round().astype(int))
        times = np.minimum(shown * self.interval * self.dt, self.moving.profile.duration)
        over_time = [[float(time), *self._modes(k)] for time, k in zip(times, shown)]
        return {
            "knots": [[float(f"{value:.9g}") for value in knot] for knot in knots],
            "harmonics": harmonics.tolist(),
            "modes": over_time[0][1:],
            "modes_over_time": over_time,
        }

    def _modes(self, node: int) -> list[float]:
        """Frequencies of the lightly damped modes at a node [rad/s]."""
        n = self.numbers.order
        poles = np.log(linalg.eigvals(self.nodes[node][:n, :n].T).astype(complex)) / self.dt
        light = poles[(poles.imag > 0.0) & (-poles.real < LIGHT * np.abs(poles))]
        return [float(f"{value:.6g}") for value in np.sort(light.imag)]

    def begin(self, phasors: FloatArray) -> None:
        """Write the phasors (2 K,) of tick 0, real and imaginary parts in turn."""
        phasors[:] = _in_turn(self.moving.phasors(0.0))

    def advance(self, tick: int, values: FloatArray, sums: FloatArray) -> None:
        """Write outputs (m + 2,) and next states, see `ConstantStep.advance`."""
        place = (tick + 0.5) / self.interval
        if self.compiled and (compiled := kernel()) is not None:
            compiled.between(self.nodes, place, values, self._next, self._other, sums)
            return
        n, k, last = self.numbers.order, int(place), len(self.nodes) - 1
        add_up(self.nodes[min(k, last)], values, self._products, self._next)
        if k < last:
            add_up(self.nodes[k + 1], values, self._products, self._other)
            self._other -= self._next
            self._other *= place - k
            self._next += self._other
        values[:n] = self._next[:n]
        sums[:] = self._next[n:]

    def turn(self, tick: int, phasors: FloatArray) -> None:
        """Write the phasors (2 K,) of the tick after this one."""
        phasors[:] = _in_turn(self.moving.phasors((tick + 1) * self.dt))

    def course(self, ticks: IntArray) -> Course:
        """Places and phasors of these consecutive ticks."""
        phasors = _in_turn(self.moving.phasors(np.append(ticks, ticks[-1] + 1) * self.dt))
        return Course((ticks + 0.5) / self.interval, phasors)


def _in_turn(phasors: ComplexArray) -> FloatArray:
    """Real and imaginary parts in turn, along the last axis."""
    return np.ascontiguousarray(phasors).view(float)


__all__ = ["MovingTones", "RampedStep", "node_interval", "node_matrices"]
