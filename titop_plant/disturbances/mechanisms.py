"""Sources that a telescope's own tables describe: broadband noise of its wheels, torques of its array drives.

**Wheel broadband.** Gaussian noise of the given one-sided densities on the mount of each wheel, in the wheel's frame;
the wheels and the axes are independent, x and y have the radial density.

**Array drive.** Each torque of a stepper has its phase at each angle theta of the array, ``imag(a exp(i c theta))`` for
c cycles in one turn: those of the motor act on its rotor, and an error delta of the gears twists the gearbox, k delta
on the array and - k delta / n on the rotor. theta is that of the run's profile where it turns the arrays, else
``rate t``: the frequency follows the rate, and the telescope stays at its angle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.systems.ports import port_slices, total_size
from titop_plant.blocks.reaction_wheel import spin_frame
from titop_plant.blocks.stepper import Stepper
from titop_plant.disturbances.places import place_matrix, source_ports
from titop_plant.disturbances.signals import NO_LINES, JointSignal, Signal, noise_of_density
from titop_plant.disturbances.sources import PlacedSource
from titop_plant.interface import DT
from titop_plant.telescope.assembly import MOTOR_TORQUE
from titop_plant.telescope.layout import DENSITIES, SADM_TORQUE, WheelOnBoard
from titop_plant.telescope.motion_profiles import MotionProfile
from titop_plant.telescope.telescope import Telescope

WHEEL_BROADBAND, ARRAY_DRIVE = "wheel broadband", "array drive"
"""Names of the sources."""

AXES_OF_DENSITIES = (0, 0, 1, 2, 2, 3)
"""Which of the densities is that of each axis, forces x, y, z and torques x, y, z."""

HIGHEST = 512
"""Harmonics of the electrical frequency that a stepper may have."""

ON_ROTOR, ON_ARRAY = 4, 5
"""Axes of a drive's signal: torque on the shaft of the motor, torque on the array."""


@dataclass(frozen=True)
class AngleSignal:
    """Torques that are periodic in the angle of a shaft.

    Parameters
    ----------
    cycles : ndarray, shape (q,)
        For one turn of the array.
    amplitude : ndarray, shape (q, 6), complex
        The value is the imaginary part of ``amplitude exp(i cycles angle)`` [Nm].
    angle : callable
        Angle of the array [rad] at times (n,) [s].
    dt : float
        Tick [s].
    rate : float
        Of the array where it is constant [rad/s]; 0 where it is not.
    """

    cycles: FloatArray
    amplitude: ComplexArray
    angle: Callable[[FloatArray], FloatArray]
    dt: float
    rate: float = 0.0

    @property
    def lines(self) -> FloatArray:
        """Frequencies at a constant rate."""
        return np.abs(self.cycles * self.rate) if self.rate else NO_LINES

    def tick(self, k: int, instants: FloatArray) -> FloatArray:
        """Values of a tick."""
        phase = np.multiply.outer(self.angle((k + instants) * self.dt), self.cycles)
        return np.asarray((np.exp(1j * phase) @ self.amplitude).imag)


def mechanism_sources(
    telescope: Telescope, profile: MotionProfile, duration: float, seed: int, dt: float = DT
) -> tuple[PlacedSource, ...]:
    """Sources of the telescope's own tables, those that it has.

    Parameters
    ----------
    telescope : Telescope
        Of the telescope.
    profile : MotionProfile
        Motion of the run.
    duration : float
        Of the run [s].
    seed : int
        Of the run.
    dt : float
        Tick [s].
    """
    noisy = [(i, wheel) for i, wheel in enumerate(telescope.wheels) if wheel.broadband is not None and wheel.turns]
    sources = []
    if noisy:
        parts = [_broadband(wheel, duration, dt, _rng(seed, 1, i)) for i, wheel in noisy]
        matrices = [mount_matrix(wheel, telescope) for _, wheel in noisy]
        sources.append(_joined(WHEEL_BROADBAND, "psd", "wheels", matrices, parts))
    if names := [array.name for array in telescope.motors]:
        drives = [_drive(telescope, i, profile, dt, _rng(seed, 2, i)) for i in range(len(names))]
        sources.append(_joined(ARRAY_DRIVE, "stepper", ", ".join(names), *zip(*drives)))
    return tuple(sources)


def mount_matrix(wheel: WheelOnBoard, telescope: Telescope) -> FloatArray:
    """Forces and torques on the mount of a wheel, in the wheel's frame, to the inputs of the structure."""
    frame = spin_frame(wheel.axis)
    return place_matrix("wheels", telescope, frame.T, frame @ wheel.position)


def _rng(seed: int, kind: int, index: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(97, kind, index)))


def _joined(name: str, kind: str, place: str, matrices: Sequence[FloatArray], parts: Sequence[Signal]) -> PlacedSource:
    return PlacedSource(name, kind, place, np.hstack(matrices), JointSignal(tuple(parts)))


def _broadband(wheel: WheelOnBoard, duration: float, dt: float, rng: np.random.Generator) -> Signal:
    table = wheel.broadband
    assert table is not None
    frequency = np.array(table.frequency, dtype=float)
    densities = np.array([table.density(name) for name in DENSITIES])
    return noise_of_density(frequency, densities[list(AXES_OF_DENSITIES)].T, duration, dt, rng)


def _drive(
    telescope: Telescope, index: int, profile: MotionProfile, dt: float, rng: np.random.Generator
) -> tuple[FloatArray, Signal]:
    """Places of the torques of a stepper, and the torques."""
    array, ports = telescope.motors[index], source_ports(telescope)
    columns, drive = port_slices(ports), [one.name for one in telescope.driven_arrays].index(array.name)
    matrix = np.zeros((total_size(ports), 6))
    matrix[columns[MOTOR_TORQUE].start + index, ON_ROTOR] = 1.0
    matrix[columns[SADM_TORQUE].start + drive, ON_ARRAY] = 1.0
    of_array, turns = array.drive, bool(np.ptp(profile.theta))
    assert of_array is not None and of_array.stepper is not None
    motor = of_array.stepper
    cycles, amplitude = drive_harmonics(motor, of_array.gearbox_stiffness, rng)
    fastest = profile.steepest()[0] if turns else abs(motor.rate)
    heard = cycles * fastest < 2.0 * math.pi / dt
    kept = cycles[heard], amplitude[heard]
    if turns:
        return matrix, AngleSignal(*kept, profile.angle, dt)
    return matrix, AngleSignal(*kept, partial(np.multiply, motor.rate), dt, motor.rate)


def drive_harmonics(motor: Stepper, gearbox: float, rng: np.random.Generator) -> tuple[FloatArray, ComplexArray]:
    """Torques of a drive over the angle of its array.

    Parameters
    ----------
    motor : Stepper
    gearbox : float
        Stiffness k of the gearbox [Nm/rad].
    rng : numpy.random.Generator
        Electrical angle of the motor, and of each error of the gears, at the angle 0.

    Returns
    -------
    cycles : ndarray, shape (q,)
        For one turn of the array.
    amplitude : ndarray, shape (q, 6), complex
        Nm, on the axes `ON_ROTOR` and `ON_ARRAY`.
    """
    order, torque = motor.torque_harmonics(HIGHEST)
    turned = rng.uniform(0.0, 2.0 * np.pi, 1 + len(motor.gear_errors))
    amplitude = np.zeros((order.size + len(motor.gear_errors), 6), complex)
    amplitude[: order.size, ON_ROTOR] = torque * np.exp(1j * order * turned[0])
    errors = np.array(motor.gear_errors, dtype=float).reshape(-1, 2)
    twist = gearbox * errors[:, 1] * np.exp(1j * turned[1:])
    amplitude[order.size :, ON_ARRAY], amplitude[order.size :, ON_ROTOR] = twist, -twist / motor.gear_ratio
    return np.concatenate([order * motor.cycles, errors[:, 0]]), amplitude
