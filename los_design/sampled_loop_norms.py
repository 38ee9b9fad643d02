"""Pointing figures of the loop as it flies, from the sampled matrices: gains, noise, stability.

Route of its own, apart from the tuner: the plant is sampled exactly, commands act one tick late, controllers are the
sampled files. A disturbance tone is not held but integrated over each tick, so its response at the ticks is exact at
every frequency. The camera's value is held between its frames, which makes the loop periodic: a tone at w answers also
at w + k w_frame. Gains count the power of these sidebands, noise is the mean variance over a frame period, and
stability is that of the product of the one-tick matrices over a period.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from los_design.sampled_loop import SampledLoop, sampled_loop
from lti import SampledSystem, StateSpace
from lti.batched_linalg import largest_gains
from lti.eigenvectors import eigenpairs
from lti.frequency_grid import frequency_grid
from lti.sampling import sampled
from titop_plant.disturbances import rpe_weight, weight_amplitudes
from titop_plant.interface import COMMANDS, DT, MEASUREMENTS
from titop_plant.telescope.parameters import Parameters
from titop_plant.telescope.weights import relative_error_weight

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
SIDEBANDS = 4
"""Sidebands of the camera's frame rate that are counted to each side."""


@dataclass(frozen=True)
class SampledLoopMetrics:
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


def sampled_loop_metrics(
    plant: StateSpace,
    k_fsm: SampledSystem,
    k_pma: SampledSystem,
    parameters: Parameters,
    *,
    loop: str,
    frame_ticks: int,
    noise: bool = True,
    sensors: str | None = None,
) -> SampledLoopMetrics:
    """All figures of the implemented loop at one parameter point.

    Parameters
    ----------
    plant : StateSpace
        As for :func:`los_design.sampled_loop.sampled_loop`.
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
    sensitivity = float(parameters["fsm"]["los_sensitivity"])
    closed = sampled_loop(plant, k_fsm, k_pma, loop=loop, frame_ticks=frame_ticks, los_sensitivity=sensitivity)
    omega, response, relative = weighted_response(closed, plant, parameters)
    table = parameters["weights"]
    los = largest_gains(response[:, :2])
    mirror = np.linalg.norm(response[:, 2:4], ord=2, axis=(1, 2))
    force = np.linalg.norm(response[:, 4:], ord=2, axis=(1, 2))
    rms = _noise(closed, parameters, sensors) if noise else (float("nan"), float("nan"))
    return SampledLoopMetrics(
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
    loop: SampledLoop, plant: StateSpace, parameters: Parameters, low: float = 1e-2
) -> tuple[FloatArray, ComplexArray, FloatArray]:
    """Frequencies [rad/s], response to normalised disturbances (k, 10, 22), and the relative error's gain [rad].

    The gain is the largest root mean square of the weighted line of sight over the frame period, times the square
    root of 2: the amplitude of a tone of that power.
    """
    omega = loop_grid(plant, loop.hold[:-2, :-2], low)
    tone = tone_response(loop, plant, omega)
    size = weight_amplitudes(parameters, omega)[:, None, :]
    window = parameters["weights"]["rpe_window"]
    seen = rpe_weight(omega, window)[:, None, None]
    stack = [seen * tone.fundamental[:, :2] * size]
    if tone.camera is not None:
        power = np.zeros((omega.size, 2, 2), complex)
        for shift, gain in tone.sidebands:
            weighted = rpe_weight(np.abs(omega + shift), window)[:, None, None] * gain
            power += weighted.conj().swapaxes(1, 2) @ weighted
        values, vectors = np.linalg.eigh(power)
        root = np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.conj().swapaxes(1, 2)
        stack.append(root @ tone.camera * size)
    relative = np.linalg.norm(np.concatenate(stack, axis=1), ord=2, axis=(1, 2))
    return omega, tone.fundamental * size, np.asarray(relative)


def loop_grid(plant: StateSpace, A: FloatArray, low: float = 1e-2, high: float = 3e3) -> FloatArray:
    """Frequencies refined at the modes of the plant and of the closed loop [rad/s]."""
    closed = np.log(linalg.eigvals(A).astype(complex) + 1e-300) / DT
    return frequency_grid(np.concatenate([linalg.eigvals(plant.A), closed]), low, high, points=150, offsets=(0.0, 3.0))


@dataclass(frozen=True)
class ToneResponse:
    """Answer to tones ``exp(i w t)`` on the 22 disturbance inputs.

    Parameters
    ----------
    fundamental : ndarray, shape (k, 10, 22)
        Line of sight (2) and commands (8) at w.
    camera : ndarray, shape (k, 2, 22), or None
        Camera value at its frames; None where every tick has a frame.
    sidebands : list of (shift, gain)
        Line of sight at w + shift [rad/s] by the camera value, gains of shape (k, 2, 2).
    """

    fundamental: ComplexArray
    camera: ComplexArray | None
    sidebands: list[tuple[float, ComplexArray]]


def disturbance_response(loop: SampledLoop, plant: StateSpace, omega: FloatArray) -> ComplexArray:
    """Line of sight (2) and commands (8) at the frequency of tones on the 22 inputs, shape (k, 10, 22), complex."""
    return tone_response(loop, plant, omega).fundamental


def tone_response(loop: SampledLoop, plant: StateSpace, omega: FloatArray) -> ToneResponse:
    """Exact response at the ticks, the held camera value closed around the rest of the loop.

    Sidebands beyond the :data:`SIDEBANDS`-th to each side are left out; the hold attenuates them.
    """
    n, size, ticks = loop.plant_order, loop.hold.shape[0] - 2, loop.frame_ticks
    A, N = loop.hold[:size, :size], loop.noise_hold[:size]
    if ticks == 1:
        A, N = loop.frame[:size, :size], loop.noise_frame[:size]
    wanted = np.zeros((10, size))
    wanted[:2], wanted[2:, n : n + COMMANDS] = loop.truth[:, :size], np.eye(COMMANDS)
    enter, read = loop.hold[:size, size:], loop.frame[size:, :size]
    mu, W = eigenpairs(A)
    right, left = linalg.inv(W), np.vstack([wanted, read]) @ W
    z = np.exp(1j * omega * DT)
    rows = left[None] / (z[:, None, None] - mu)  # (k, 12, size), to be followed by `right`
    # Sensors feel the disturbance of the tick itself through the plant's feedthrough.
    felt = plant.D[:MEASUREMENTS, COMMANDS:]
    pushed = _pushed(plant, omega, rows, right[:, :n]) + rows @ (right @ (N @ felt))
    if ticks == 1:
        return ToneResponse(pushed[:, :10], None, [])
    pushed[:, 10:] += loop.noise_frame[size:] @ felt
    entry, ends = right @ enter, np.vstack([left[:2], left[10:]])
    loop_gain, sidebands = np.zeros((omega.size, 2, 2), complex), []
    for k in range(-SIDEBANDS, SIDEBANDS + 1):
        shift = 2.0 * np.pi * k / (ticks * DT)
        zk = np.exp(1j * (omega + shift) * DT)
        held = np.mean(zk[:, None] ** -np.arange(ticks), axis=1)[:, None, None]
        answer = (ends[None] / (zk[:, None, None] - mu)) @ entry * held
        loop_gain += answer[:, 2:]
        if k:
            sidebands.append((shift, answer[:, :2]))
    camera = np.linalg.solve(np.eye(2) - loop_gain, pushed[:, 10:])
    held = np.mean(z[:, None] ** -np.arange(ticks), axis=1)[:, None, None]
    return ToneResponse(pushed[:, :10] + rows[:, :10] @ entry @ (held * camera), camera, sidebands)


def _pushed(plant: StateSpace, omega: FloatArray, rows: ComplexArray, right: ComplexArray) -> ComplexArray:
    """What a tone adds to the plant's state over a tick, seen through `rows` (k, p, size) times `right` (size, n)."""
    values, vectors = eigenpairs(plant.A)
    drive = linalg.solve(vectors, plant.B[:, COMMANDS:])
    z, s, flow = np.exp(1j * omega * DT)[:, None], 1j * omega[:, None], np.exp(values * DT)
    near = np.abs(s - values) < 1e-9
    kick = np.where(near, DT * flow, (z - flow) / np.where(near, 1.0, s - values))
    return np.asarray((rows @ (right @ vectors) * kick[:, None, :]) @ drive)


def _noise(loop: SampledLoop, parameters: Parameters, sensors: str | None) -> tuple[float, float]:
    """Line of sight by sensor noise [rad rms over a frame period], plain and through the relative-error weight."""
    table: Any = parameters["sensors"]
    sigma = np.r_[
        np.tile(table["accelerometer_noise"], 3),
        np.full(2, table["camera_noise"]),
        np.full(2, table["strain_gauge_noise"]),
    ]
    if sensors == "platform":
        sigma[6:] = 0.0
    w = sampled(relative_error_weight(parameters["weights"]["rpe_window"]), DT)
    n, m = loop.hold.shape[0], w.order

    def extended(A: FloatArray, N: FloatArray) -> tuple[FloatArray, FloatArray]:
        both = np.block([[A, np.zeros((n, m))], [w.B @ loop.truth, w.A]])
        drive = np.vstack([N * sigma, np.zeros((m, sigma.size))])
        return both, drive @ drive.T

    outputs = (
        np.hstack([loop.truth, np.zeros((2, m))]),
        np.hstack([w.D @ loop.truth, w.C]),
    )
    frame, hold = extended(loop.frame, loop.noise_frame), extended(loop.hold, loop.noise_hold)
    ticks = [frame] + [hold] * (loop.frame_ticks - 1)
    period: FloatArray = np.eye(n + m)
    gathered: FloatArray = np.zeros((n + m, n + m))
    for A, Q in ticks:
        period, gathered = A @ period, A @ gathered @ A.T + Q
    P: FloatArray = np.asarray(linalg.solve_discrete_lyapunov(period, gathered), dtype=float)
    power = np.zeros(2)
    for A, Q in ticks:
        power += [np.trace(C @ P @ C.T) for C in outputs]
        P = A @ P @ A.T + Q
    plain, relative = np.sqrt(np.maximum(power / len(ticks), 0.0))
    return float(plain), float(relative)
