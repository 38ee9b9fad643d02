"""Micro-vibration disturbances in time: tones of the wheels and of the solar array drives.

A disturbance is a set of tones on the disturbance inputs (imbalance, 5 for each wheel, then a torque for each array
drive; 22 for the reference)::

    d(t) = sum_k Im( a_k exp(i phase_k(t)) ),   phase_k' = frequency_k

Radial forces and torques of a wheel turn with it (x leads y by a quarter turn), so each is a complex pair. Scenarios
(:mod:`titop_plant.simulation.scenarios`): ``imbalance``, physical amplitudes proportional to the square of the speed;
``unit_norm``, tones at the frequencies where the telescope on its isolator alone is worst, whose norms add up to 1;
``design``, the same with norm 1 each; ``worst_case``, the tone of unit norm that is worst for the loop that runs
(:mod:`los_loop.worst_tone`). A tone has unit norm if its amplitudes over the synthesis weights have norm 1: **the
H-infinity norm of a design bounds the response to it.**

Source: the paper (weights W_rws and W_sa); harmonic ratios of a measured small wheel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from lftkit import System
from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_grid import frequency_grid
from lftkit.analysis.frequency_response import FrequencyResponse, frequency_response
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import rpe_weight, weight_amplitudes

MODE_WIDTH = 0.04
"""Wheels whose speeds differ by less than this share are taken to be at the same mode."""


@dataclass(frozen=True)
class Tones:
    """A set of K tones.

    Parameters
    ----------
    frequency : ndarray, shape (K,)
        rad/s.
    amplitude : ndarray, shape (channels, K), complex
        On the disturbance inputs (N, Nm), with the phase at t = 0.
    harmonic : ndarray, shape (K,)
        For tones of a wheel: multiple of its speed; 0 for tones of fixed frequency.
    wheel : ndarray of int, shape (K,)
        Index of the wheel, or -1.
    """

    frequency: FloatArray
    amplitude: ComplexArray
    harmonic: FloatArray
    wheel: NDArray[np.int64]


def no_tones(inputs: int) -> Tones:
    """An empty set, for a plant with so many disturbance inputs."""
    return Tones(np.zeros(0), np.zeros((inputs, 0), complex), np.zeros(0), np.zeros(0, dtype=np.int64))


def joined(parts: Sequence[Tones]) -> Tones:
    """All tones of several sets."""
    return Tones(
        np.concatenate([p.frequency for p in parts]),
        np.concatenate([p.amplitude for p in parts], axis=1),
        np.concatenate([p.harmonic for p in parts]),
        np.concatenate([p.wheel for p in parts]),
    )


def _tones(rows: list[tuple[float, ComplexArray, float, int]], inputs: int) -> Tones:
    if not rows:
        return no_tones(inputs)
    frequency, amplitude, harmonic, wheel = zip(*rows)
    return Tones(np.array(frequency), np.array(amplitude).T, np.array(harmonic), np.array(wheel, dtype=np.int64))


def _wheel_vector(force: float, axial: float, torque: float, sense: float, rng: np.random.Generator) -> ComplexArray:
    """Complex amplitude of one wheel's five channels; **radial parts turn from x to y for sense > 0**."""
    phase = np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, 3))
    return np.array(
        [
            force * phase[0],
            -1j * sense * force * phase[0],
            axial * phase[1],
            torque * phase[2],
            -1j * sense * torque * phase[2],
        ]
    )


def imbalance_tones(telescope: Telescope, speeds: FloatArray, rng: np.random.Generator) -> Tones:
    """Tones of the wheels at the given speeds, random phases.

    Parameters
    ----------
    telescope : Telescope
        Table ``imbalance``, and what is on board.
    speeds : ndarray, shape (wheels,)
        rad/s; a wheel at rest makes no tone.
    rng : numpy.random.Generator
    """
    table, inputs = telescope.imbalance, telescope.channels
    rows: list[tuple[float, ComplexArray, float, int]] = []
    for k, i in enumerate(telescope.turning_wheels):
        speed = float(speeds[i])
        square, sense = speed**2, float(np.sign(speed)) or 1.0
        kinds = (
            (table.force_harmonics, table.force_ratios, table.radial_force, table.axial_force, 0.0),
            (table.torque_harmonics, table.torque_ratios, 0.0, 0.0, table.radial_torque),
        )
        for harmonics, ratios, force, axial, torque in kinds:
            for harmonic, ratio in zip(harmonics, ratios):
                size = ratio * square
                five = _wheel_vector(force * size, axial * size, torque * size, sense, rng)
                amplitude = np.zeros(inputs, complex)
                amplitude[5 * k : 5 * k + 5] = five
                rows.append((harmonic * abs(speed), amplitude, harmonic, i))
    return _tones(rows, inputs)


def sadm_tones(telescope: Telescope, rng: np.random.Generator) -> Tones:
    """Micro-stepping torque of all array drives: harmonics of the step frequency, their sum within the bound.

    A drive with a stepper motor has none: its torques are a source of their own.
    """
    table, inputs, bounds = telescope.sadm, telescope.channels, telescope.torque_bounds
    ratios = np.array(table.step_harmonics, dtype=float)
    plain = np.array([array.stepper is None for array in telescope.driven_arrays], dtype=float)
    sizes = bounds * plain * ratios[:, None] / ratios.sum()
    rows: list[tuple[float, ComplexArray, float, int]] = []
    for h, size in enumerate(sizes if plain.any() else (), start=1):
        amplitude = np.zeros(inputs, complex)
        amplitude[-bounds.size :] = size * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, bounds.size))
        rows.append((h * table.step_frequency, amplitude, 0.0, -1))
    return _tones(rows, inputs)


def design_tones(telescope: Telescope, plant: FrequencyResponse, rng: np.random.Generator) -> Tones:
    """Tones of unit norm where the telescope on its isolator alone is worst.

    Parameters
    ----------
    telescope : Telescope
        Tables ``design_scenario`` and ``weights``, and what is on board.
    plant : FrequencyResponse
        From the disturbance inputs to the line of sight (2), isolated, no fine control.
    rng : numpy.random.Generator
        Phase of each tone as a whole.

    Notes
    -----
    "Worst" is the largest singular value seen through the weight of the relative performance error. At each of these
    frequencies the wheels have amplitudes along the right singular vector; so have the drives where they are worst.
    """
    low, high = telescope.design_scenario.band
    omega = frequency_grid(plant.poles, low, high)
    size = weight_amplitudes(telescope, omega)
    response = plant.at(omega) * size[:, None, :]
    seen = rpe_weight(omega, telescope.weights.rpe_window)
    inputs, edge = telescope.channels, 5 * len(telescope.turning_wheels)
    wheels, drives = slice(0, edge), slice(edge, inputs)
    values = seen * largest_gains(response[:, :, wheels])
    inner = np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:])) + 1
    peaks = [int(k) for k in inner[np.argsort(values[inner])[::-1][: telescope.design_scenario.tones]]]
    chosen = [(k, wheels) for k in peaks]
    if inputs > edge:
        chosen.append((int(np.argmax(seen * largest_gains(response[:, :, drives]))), drives))
    rows: list[tuple[float, ComplexArray, float, int]] = []
    for k, part in chosen:
        right = linalg.svd(response[k][:, part])[2][0].conj()
        amplitude = np.zeros(inputs, complex)
        amplitude[part] = size[k, part] * right
        rows.append((float(omega[k]), amplitude * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi)), 0.0, -1))
    return _tones(rows, inputs)


def given_tones(table: Sequence[Sequence[float]], inputs: int) -> Tones:
    """Tones of fixed frequency from plain numbers.

    Parameters
    ----------
    table : sequence of sequences
        Of each tone the frequency [rad/s], then the real and the imaginary parts of its amplitudes [N, Nm].
    inputs : int
        Number of amplitudes, the disturbance inputs of the telescope.

    Raises
    ------
    ValueError
        Another length, or a number that is not finite.
    """
    rows: list[tuple[float, ComplexArray, float, int]] = []
    for entry in table:
        if len(entry) != 1 + 2 * inputs or not np.isfinite(entry).all():
            raise InputError(f"a tone must be {1 + 2 * inputs} finite numbers, got {len(entry)}")
        values = np.asarray(entry, dtype=float)
        rows.append((float(values[0]), values[1 : 1 + inputs] + 1j * values[1 + inputs :], 0.0, -1))
    return _tones(rows, inputs)


def loudest_speeds(telescope: Telescope, plant: System, senses: FloatArray) -> FloatArray:
    """Speed of each wheel [rad/s] at which the relative error by its fundamental is largest; the senses are given.

    No two wheels have the same mode: each takes what the wheels before it leave. A wheel without a choice keeps its
    default speed.

    Parameters
    ----------
    telescope : Telescope
        Tables ``imbalance``, ``reaction_wheel`` and ``weights``.
    plant : System
        From the disturbance inputs to the line of sight (2), isolated, no fine control.
    senses : ndarray, shape (wheels,)
        +1 or -1.
    """
    table, wheels = telescope.imbalance, telescope.wheels
    top = max(abs(end) for wheel in wheels for end in wheel.speed_range)
    omega = frequency_grid(linalg.eigvals(plant.A), 0.05 * top, top)
    response = frequency_response(plant, omega)
    seen = rpe_weight(omega, telescope.weights.rpe_window) * omega**2
    sizes = np.diag([table.radial_force, table.axial_force, table.radial_torque])
    loudest, free = np.abs(telescope.default_speeds), np.ones(omega.size, dtype=bool)
    for k, i in enumerate(telescope.turning_wheels):
        sense, (low, high) = senses[i], wheels[i].speed_range
        within = free & (low <= sense * omega) & (sense * omega <= high)
        if not (wheels[i].varies and within.any()):
            continue
        five = [np.array([f, -1j * sense * f, a, t, -1j * sense * t]) for f, a, t in sizes]
        parts = response[:, :, 5 * k : 5 * k + 5] @ np.stack(five, axis=1)
        power = np.sum(np.abs(parts) ** 2, axis=(1, 2))
        loudest[i] = omega[np.argmax(np.where(within, seen * np.sqrt(power), -1.0))]
        free &= np.abs(omega - loudest[i]) > MODE_WIDTH * loudest[i]
    return loudest
