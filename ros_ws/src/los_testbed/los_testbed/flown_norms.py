"""Pointing figures of the loop as it flies, from the sampled matrices: gains, noise, stability.

Route of its own, apart from the tuner: the plant is sampled exactly, commands act one tick late, controllers are the
sampled files. A disturbance tone is not held but integrated over each tick, so its response at the ticks is exact at
every frequency. Stability counts the camera's frames exactly (product of the one-tick matrices over a frame period);
gains and noise take the held camera value as a camera at every tick that is half a frame late.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from los_testbed.as_flown import FlownLoop, flown_loop
from titop_plant.disturbances import rpe_weight, weight_amplitudes
from titop_plant.sampled_plant import COMMANDS, MEASUREMENTS
from titop_plant.telescope.parameters import Parameters
from titop_plant.telescope.weights import relative_error_weight
from uncertain_systems import SampledSystem, StateSpaceData
from uncertain_systems.frequency_response import frequency_grid, singular_values
from uncertain_systems.sampling import sampled

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
DT = 1e-3


@dataclass(frozen=True)
class FlownFigures:
    """Worst values of one loop at one parameter point, normalised where not said otherwise.

    Parameters
    ----------
    ape, rpe, rpe_fine : float
        Peak line of sight by normalised disturbances over 10 arcsec; through the weight of 20 ms over 100 and 40 mas.
    mirror, force : float
        Peak command over 5.3 mrad and over 31.6 N.
    noise_ape, noise_rpe : float
        Line of sight by sensor noise [rad rms, both axes], and through the weight of 20 ms.
    radius : float
        Growth a tick of the least stable motion, camera frames counted exactly; stable below 1.
    omega_rpe : float
        Frequency of the peak of `rpe` [rad/s].
    """

    ape: float
    rpe: float
    rpe_fine: float
    mirror: float
    force: float
    noise_ape: float
    noise_rpe: float
    radius: float
    omega_rpe: float


def flown_figures(
    plant: StateSpaceData,
    k_fsm: SampledSystem,
    k_pma: SampledSystem,
    parameters: Parameters,
    *,
    loop: str,
    frame_ticks: int,
    noise: bool = True,
    sensors: str | None = None,
) -> FlownFigures:
    """All figures of the flown loop at one parameter point.

    Parameters
    ----------
    plant : StateSpaceData
        As for :func:`los_testbed.as_flown.flown_loop`.
    k_fsm, k_pma : SampledSystem
    parameters : mapping
        Telescope parameters (weights, sensors, authority).
    loop : {"isolator", "fsm", "fsm+pma"}
    frame_ticks : int
        Ticks between camera frames.
    noise : bool
        Compute the noise figures too (a Lyapunov equation).
    sensors : {None, "platform"}
        Noise of all sensors, or of the platform's accelerometers only.
    """
    closed = flown_loop(plant, k_fsm, k_pma, loop=loop, frame_ticks=frame_ticks)
    omega, response, relative = weighted_response(closed, plant, parameters)
    table = parameters["weights"]
    los = singular_values(response[:, :2])[:, 0]
    mirror = np.linalg.norm(response[:, 2:4], ord=2, axis=(1, 2))
    force = np.linalg.norm(response[:, 4:], ord=2, axis=(1, 2))
    rms = _noise(_camera_every_tick(closed), parameters, sensors) if noise else (float("nan"), float("nan"))
    return FlownFigures(
        float(los.max()) / table["ape_limit"],
        float(relative.max()) / table["rpe_limit"],
        float(relative.max()) / table["rpe_limit_fine"],
        float(mirror.max()) / parameters["fsm"]["authority"],
        float(force.max()) / parameters["pma"]["authority"],
        *rms,
        closed.spectral_radius(),
        float(omega[relative.argmax()]),
    )


def weighted_response(
    loop: FlownLoop, plant: StateSpaceData, parameters: Parameters, low: float = 1e-2
) -> tuple[FloatArray, ComplexArray, FloatArray]:
    """Frequencies [rad/s], response to normalised disturbances (k, 10, 22), and the relative error's gain [rad]."""
    omega = flown_grid(plant, loop.hold[:-2, :-2], low)
    response = disturbance_response(loop, plant, omega) * weight_amplitudes(parameters, omega)[:, None, :]
    seen = rpe_weight(omega, parameters["weights"]["rpe_window"])
    return omega, response, singular_values(response[:, :2])[:, 0] * seen


@dataclass(frozen=True)
class EveryTick:
    """Time-invariant loop: ``x+ = A x + N n``; rows of `C` give the line of sight."""

    A: FloatArray
    N: FloatArray
    C: FloatArray


def _camera_every_tick(loop: FlownLoop) -> EveryTick:
    """The camera is read at every tick but half a frame late: a chain of delays instead of the hold."""
    n, late = loop.frame.shape[0], max(1, loop.frame_ticks // 2)
    held, chain = slice(n - 2, n), 2 * (late - 1)
    A, N = np.zeros((n + chain, n + chain)), np.zeros((n + chain, MEASUREMENTS))
    A[:n, :n], N[:n] = (loop.frame, loop.noise_frame) if loop.frame_ticks == 1 else (loop.hold, loop.noise_hold)
    if loop.frame_ticks > 1:
        A[held], N[held] = 0.0, 0.0
        last = slice(n + chain - 2, n + chain)  # the camera value goes down the chain to the held state
        A[last, :n], N[last] = loop.frame[held], loop.noise_frame[held]
        for i in range(late - 1):
            A[n - 2 + 2 * i : n + 2 * i, n + 2 * i : n + 2 * i + 2] = np.eye(2)
    C = np.zeros((2, n + chain))
    C[:, :n] = loop.truth
    return EveryTick(A, N, C)


def flown_grid(plant: StateSpaceData, A: FloatArray, low: float = 1e-2, high: float = 3e3) -> FloatArray:
    """Frequencies refined at the modes of the plant and of the closed loop [rad/s]."""
    closed = np.log(linalg.eigvals(A).astype(complex) + 1e-300) / DT
    return frequency_grid(np.concatenate([linalg.eigvals(plant.A), closed]), low, high, points=150, per_mode=3)


def disturbance_response(loop: FlownLoop, plant: StateSpaceData, omega: FloatArray) -> ComplexArray:
    """Response at the ticks to tones on the 22 disturbance inputs: line of sight (2) and commands (8).

    The delay of the camera is closed around the rest of the loop at each frequency.

    Returns
    -------
    ndarray, shape (k, 10, 22), complex
        A tone ``exp(i w t)`` gives ``H exp(i w t)`` at the ticks.
    """
    n, size = loop.plant_order, loop.hold.shape[0] - 2
    values, vectors = _eigenvectors(plant.A)
    drive = linalg.solve(vectors, plant.B[:, COMMANDS:])
    z = np.exp(1j * omega * DT)
    flow, s = np.exp(values * DT), 1j * omega[:, None]
    near = np.abs(s - values) < 1e-9
    kick = np.where(near, DT * flow, (z[:, None] - flow) / np.where(near, 1.0, s - values))
    # Sensors feel the disturbance of the tick itself through the plant's feedthrough.
    felt = plant.D[:MEASUREMENTS, COMMANDS:]
    with_camera = loop.frame_ticks == 1
    A = loop.frame[:size, :size] if with_camera else loop.hold[:size, :size]
    N = loop.noise_frame[:size] if with_camera else loop.noise_hold[:size]
    enter, read = loop.hold[:size, size:], loop.frame[size:, :size]
    wanted = np.zeros((10, size))
    wanted[:2], wanted[2:, n : n + COMMANDS] = loop.truth[:, :size], np.eye(COMMANDS)
    mu, W = _eigenvectors(A)
    right, left = linalg.inv(W), np.vstack([wanted, read]) @ W
    rows = (left[None] / (z[:, None, None] - mu)) @ right  # (k, 12, size)
    pushed = (rows[:, :, :n] @ vectors * kick[:, None, :]) @ drive + rows @ (N @ felt)
    if with_camera:
        return np.asarray(pushed[:, :10])
    pushed[:, 10:] += loop.noise_frame[size:] @ felt
    late = z ** -(loop.frame_ticks // 2)
    fed = rows @ enter  # (k, 12, 2)
    inner = np.linalg.solve(np.eye(2) - late[:, None, None] * fed[:, 10:], late[:, None, None] * pushed[:, 10:])
    return np.asarray(pushed[:, :10] + fed[:, :10] @ inner)


def _eigenvectors(A: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    values, vectors = linalg.eig(A)
    return np.asarray(values, dtype=complex), np.asarray(vectors, dtype=complex)


def _noise(loop: EveryTick, parameters: Parameters, sensors: str | None) -> tuple[float, float]:
    """Line of sight by sensor noise [rad rms], plain and through the relative-error weight."""
    table: Any = parameters["sensors"]
    sigma = np.r_[
        np.tile(table["accelerometer_noise"], 3),
        np.full(2, table["camera_noise"]),
        np.full(2, table["strain_gauge_noise"]),
    ]
    if sensors == "platform":
        sigma[6:] = 0.0
    filtered = _with_relative_error(loop, parameters["weights"]["rpe_window"])
    drive = filtered.N * sigma
    P = linalg.solve_discrete_lyapunov(filtered.A, drive @ drive.T)
    plain, relative = (np.trace(C @ P @ C.T) for C in (filtered.C[:2], filtered.C[2:4]))
    return float(np.sqrt(max(plain, 0.0))), float(np.sqrt(max(relative, 0.0)))


def _with_relative_error(loop: EveryTick, window: float) -> EveryTick:
    """Append the weight of the relative error, sampled by the bilinear rule, to the line of sight."""
    w = sampled(relative_error_weight(window), DT)
    n, m = loop.A.shape[0], w.order
    A = np.block([[loop.A, np.zeros((n, m))], [w.B @ loop.C, w.A]])
    C = np.vstack([np.hstack([loop.C, np.zeros((2, m))]), np.hstack([w.D @ loop.C, w.C])])
    return EveryTick(A, np.vstack([loop.N, np.zeros((m, loop.N.shape[1]))]), C)
