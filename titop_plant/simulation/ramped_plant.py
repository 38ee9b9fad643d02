"""The telescope as a sampled simulation while wheel speeds and array angle vary.

The one-tick matrices of :mod:`titop_plant.simulation.sampled_plant` are prepared at nodes of the profile and
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
from titop_plant.simulation.compilation import kernel
from titop_plant.simulation.disturbances import Tones
from titop_plant.simulation.kernel_arrays import Course, StepArrays
from titop_plant.simulation.plant_step import whole_step
from titop_plant.simulation.profiles import Profile
from titop_plant.simulation.sampled_plant import SampledPlant, SensorModel

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
    profile : Profile
    unit : Tones
        Tones of the wheels at 1 rad/s, turning in the positive sense, and tones of fixed frequency.
    """

    profile: Profile
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


def node_interval(profile: Profile, dt: float, finer: float = 1.0) -> int:
    """Ticks between nodes of a profile."""
    theta, speed = profile.steepest()
    seconds = min(LONGEST, ANGLE_STEP / max(theta, 1e-12), SPEED_STEP / max(speed, 1e-12)) / finer
    return max(1, round(seconds / dt))


def node_matrices(
    profile: Profile, interval: int, dt: float, matrices: Callable[[float], FloatArray]
) -> list[FloatArray]:
    """Step matrices (of `step_matrix`, phasors of size 1) at the nodes; `matrices` gives them at a time [s]."""
    count = math.ceil(profile.duration / (interval * dt) - 1e-9) + 1
    return [matrices(min(k * interval * dt, profile.duration)) for k in range(count)]


class RampedPlant(SampledPlant):
    """A :class:`SampledPlant` whose parameters follow a profile.

    Parameters
    ----------
    nodes : sequence of ndarray, shape (n + 24, n + 8 + 2 K)
        Step matrices every `interval` ticks.
    interval : int
    tones : MovingTones
    state, sensors, limits, dt, parameters_hash
        As in `SampledPlant`.
    """

    def __init__(
        self,
        nodes: Sequence[FloatArray],
        interval: int,
        tones: MovingTones,
        state: FloatArray,
        sensors: SensorModel,
        limits: FloatArray,
        *,
        dt: float,
        parameters_hash: str,
    ) -> None:
        self.profile = tones.profile
        self._nodes = np.ascontiguousarray(np.stack(nodes).transpose(0, 2, 1))
        self._interval, self._moving = interval, tones
        self._next, self._other = np.zeros(self._nodes.shape[2]), np.zeros(self._nodes.shape[2])
        self._products = np.zeros(self._nodes.shape[1:])
        still = np.ones(tones.unit.frequency.size, complex)
        super().__init__(
            whole_step(nodes[0], still),
            state,
            sensors,
            limits,
            dt=dt,
            tones=np.unique(tones.unit.frequency[tones.unit.wheel < 0]),
            parameters_hash=parameters_hash,
        )

    @cached_property
    def motion(self) -> dict[str, list[Any]]:
        """What moves, for reports: knots (time, theta, four speeds), harmonics, modes at the start and over time.

        A row of ``modes_over_time`` is a time [s] and the frequencies [rad/s] of the lightly damped modes there.
        """
        table = self.profile.table()
        knots = table[:: -(-len(table) // KNOTS)]
        if knots[-1] != table[-1]:
            knots.append(table[-1])
        harmonics = np.unique(self._moving.unit.harmonic[self._moving.unit.wheel >= 0])
        shown = np.unique(np.linspace(0, len(self._nodes) - 1, MODES_SHOWN).round().astype(int))
        times = np.minimum(shown * self._interval * self.dt, self.profile.duration)
        over_time = [[float(time), *self._modes(k)] for time, k in zip(times, shown)]
        return {
            "knots": [[float(f"{value:.9g}") for value in knot] for knot in knots],
            "harmonics": harmonics.tolist(),
            "modes": over_time[0][1:],
            "modes_over_time": over_time,
        }

    def _modes(self, node: int) -> list[float]:
        """Frequencies of the lightly damped modes at a node [rad/s]."""
        n = self._n
        poles = np.log(linalg.eigvals(self._nodes[node][:n, :n].T).astype(complex)) / self.dt
        light = poles[(poles.imag > 0.0) & (-poles.real < LIGHT * np.abs(poles))]
        return [float(f"{value:.6g}") for value in np.sort(light.imag)]

    def _begin(self) -> None:
        """Phasors at tick 0."""
        self._phasors[:] = _in_turn(self._moving.phasors(0.0))

    def _numbers(self) -> StepArrays:
        return super()._numbers()._replace(nodes=self._nodes)

    def _course(self, ticks: IntArray) -> Course:
        """Places and phasors of these ticks, the next ones."""
        phasors = _in_turn(self._moving.phasors(np.append(ticks, ticks[-1] + 1) * self.dt))
        return Course((ticks + 0.5) / self._interval, phasors)

    def _propagate(self) -> None:
        place = (self.tick + 0.5) / self._interval
        if self._compiled and (compiled := kernel()) is not None:
            compiled.between(self._nodes, place, self._values, self._next, self._other, self._sums)
            return
        k = int(place)
        last = len(self._nodes) - 1
        add_up(self._nodes[min(k, last)], self._values, self._products, self._next)
        if k < last:
            add_up(self._nodes[k + 1], self._values, self._products, self._other)
            self._other -= self._next
            self._other *= place - k
            self._next += self._other
        self._values[: self._n] = self._next[: self._n]
        self._sums[:] = self._next[self._n :]

    def _turn(self) -> None:
        phasors = self._phasors if self._disturbed else self._phasor
        phasors[:] = _in_turn(self._moving.phasors((self.tick + 1) * self.dt))


def _in_turn(phasors: ComplexArray) -> FloatArray:
    """Real and imaginary parts in turn, along the last axis."""
    return np.ascontiguousarray(phasors).view(float)


__all__ = ["MovingTones", "RampedPlant", "node_interval", "node_matrices"]
