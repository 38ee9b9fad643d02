"""Lines that an array drive makes in the line of sight without fine control: of a stepper, and of fixed harmonics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lftkit import System
from lftkit.analysis.frequency_response import frequency_response
from lftkit.arrays import ComplexArray, FloatArray
from titop_plant.disturbances.mechanisms import ARRAY_DRIVE, AngleSignal, mechanism_sources
from titop_plant.disturbances.places import source_ports
from titop_plant.disturbances.signals import JointSignal
from titop_plant.disturbances.wheel_and_drive_tones import sadm_tones
from titop_plant.interface import DT
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.control_plant import disturbances_of
from titop_plant.telescope.motion_profiles import MotionProfile
from titop_plant.telescope.telescope import Telescope

LOS = "los_controlled"


@dataclass(frozen=True)
class DriveLines:
    """Lines in the line of sight.

    Parameters
    ----------
    omega : ndarray, shape (q,)
        rad/s.
    size : ndarray, shape (q,)
        Amplitude, norm of both axes [rad].
    """

    omega: FloatArray
    size: FloatArray


def stepper_lines(telescope: Telescope, seed: int = 0) -> DriveLines:
    """Lines of all stepper drives at the constant rate of their tables, the telescope at its nominal values.

    Parameters
    ----------
    telescope : Telescope
        Of a telescope with a stepper.
    seed : int
        Of the phases between the drives.
    """
    ports = source_ports(telescope)
    whole = build_telescope(telescope, loads=telescope.loaded_nodes, motors=True).system
    plant = whole.select(inputs=[port.name for port in ports], outputs=[LOS]).at({})
    still = MotionProfile(np.zeros(1), np.zeros(1), np.array([telescope.default_speeds], dtype=float))
    sources = mechanism_sources(telescope, still, 1.0, seed, DT)
    source = next(one for one in sources if one.name == ARRAY_DRIVE)
    assert isinstance(source.signal, JointSignal)
    rows: dict[float, ComplexArray] = {}
    for i, part in enumerate(source.signal.parts):
        assert isinstance(part, AngleSignal)
        place = source.matrix[:, 6 * i : 6 * i + 6]
        for cycles, amplitude in zip(part.cycles, part.amplitude):
            omega = abs(float(cycles) * part.rate)
            rows[omega] = rows.get(omega, np.zeros(len(place), complex)) + place @ amplitude
    return _lines(plant, list(rows), np.array(list(rows.values())))


def fixed_lines(telescope: Telescope, seed: int = 0) -> DriveLines:
    """Lines of the same drives with the five fixed harmonics of the table ``[sadm]`` in place of steppers."""
    plain = telescope.without_steppers()
    whole = build_telescope(plain).system
    plant = whole.select(inputs=disturbances_of(whole), outputs=[LOS]).at({})
    tones = sadm_tones(plain, np.random.default_rng(seed))
    return _lines(plant, tones.frequency.tolist(), tones.amplitude.T)


def _lines(plant: System, omega: Sequence[float], amplitude: ComplexArray) -> DriveLines:
    """Norm of the line of sight by amplitudes (q, inputs) at frequencies (q,)."""
    order = np.argsort(omega)
    ascending = np.array(omega)[order]
    los = np.einsum("qij,qj->qi", frequency_response(plant, ascending), amplitude[order])
    return DriveLines(ascending, np.sqrt(np.square(np.abs(los)).sum(axis=1)))
