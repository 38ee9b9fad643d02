"""Gains, noise and tones of the sampled loop against stepping it, power densities and sums that they must obey."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from scipy import signal
from small_loop import DT, small_controllers, small_plant
from support.loop_rows import COMMANDS, loop_rows

from los_loop import sampled_loop_norms
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.noise import correlation, covariances, covariances_in_window
from los_loop.sampled_loop import SampledLoop
from los_loop.sampled_loop_norms import disturbance_response, sampled_loop_metrics, tone_response, weighted_response
from los_loop.tone_model import ToneModel
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import weight_amplitudes

OMEGA = np.array([0.5, 12.0, 55.0, 170.0, 420.0, 900.0, 2100.0])
PLANT = ModalPlant.of(small_plant(), COMMANDS)
COMPLETE = 9  # 2 * SIDEBANDS + 1: no sideband is omitted and the response is exact


def at_rate(telescope: Telescope, frame_ticks: int) -> Telescope:
    return telescope.changed({"sensors": {"camera_rate": 1000.0 / frame_ticks}})


def closed(frame_ticks: int, stage: str = "fsm+pma") -> SampledLoop:
    return sampled_loop(PLANT, ControlLaws(*small_controllers(), stage, loop_rows(frame_ticks)))


def model(loop: SampledLoop, omega: float) -> ToneModel:
    """One tone of unit amplitude on each of the 22 inputs in turn."""
    return ToneModel(loop, PLANT, np.full(22, omega), np.eye(22, dtype=complex), np.full(8, 1e9))


def stepped(loop: SampledLoop, omega: float) -> np.ndarray:
    """Line of sight (2) and commands (8) of the steady state at each tick of a period over the tone, (N, 10, 22).

    The state that one period of ticks turns by the phase of the tone, found and checked by stepping.
    """
    frame, hold, through = model(loop, omega).forcing()
    n, N, size, turn = loop.plant_order, loop.frame_ticks, len(loop.hold), np.exp(1j * omega * DT)
    rows = np.zeros((N, 10, 22), complex)

    def period(state: np.ndarray) -> np.ndarray:
        for k in range(N):
            phasor = turn**k
            rows[k, :2] = loop.truth @ state / phasor + through
            rows[k, 2:] = state[n : n + 8] / phasor
            A, drive = (loop.hold, hold) if k else (loop.frame, frame)
            state = A @ state + drive * phasor
        return state

    free = np.linalg.multi_dot([*[loop.hold] * (N - 1), loop.frame]) if N > 1 else loop.frame
    start = np.linalg.solve(turn**N * np.eye(size) - free, period(np.zeros((size, 22), complex)))
    end = period(start)
    assert np.abs(end - turn**N * start).max() < 1e-9 * np.abs(end).max()
    return rows


@pytest.mark.parametrize("stage", ["isolator", "fsm", "fsm+pma"])
@pytest.mark.parametrize("frame_ticks", [1, 2, 4, 7, COMPLETE])
def test_the_response_is_that_of_the_settled_periodic_loop(stage: str, frame_ticks: int) -> None:
    """All sidebands included: equal to the solution of the periodic loop to rounding, above Nyquist too."""
    loop = closed(frame_ticks, stage)
    found = disturbance_response(loop, small_plant(), OMEGA)[:, :2]
    for k, w in enumerate(OMEGA):
        expected = model(loop, w).settled()
        assert np.abs(found[k] - expected).max() < 1e-8 * np.abs(expected).max()


def test_at_20_ticks_a_frame_nine_sidebands_are_enough_and_one_is_not(monkeypatch) -> None:
    loop = closed(20)

    def error() -> float:
        found = disturbance_response(loop, small_plant(), OMEGA[:5])[:, :2]
        expected = [model(loop, w).settled() for w in OMEGA[:5]]
        return max(float(np.abs(f - e).max() / np.abs(e).max()) for f, e in zip(found, expected))

    assert error() < 2e-2
    monkeypatch.setattr(sampled_loop_norms, "SIDEBANDS", 0)
    assert error() > 6e-2
    monkeypatch.setattr(sampled_loop_norms, "SIDEBANDS", 10)
    assert error() < 1e-8


@pytest.mark.parametrize("omega", [55.0, 400.0])
def test_commands_and_sidebands_are_those_of_the_stepped_loop(omega: float) -> None:
    """The discrete Fourier transform of a settled period has the fundamental first and the sidebands behind it."""
    loop = closed(COMPLETE)
    spectrum = np.fft.fft(stepped(loop, omega), axis=0) / COMPLETE
    tone = tone_response(loop, small_plant(), np.array([omega]))
    scale = np.abs(spectrum[0]).max(axis=1, keepdims=True)
    assert np.all(np.abs(tone.fundamental[0] - spectrum[0]) < 1e-6 * scale)
    assert tone.camera is not None and len(tone.sidebands) == COMPLETE - 1
    for shift, gain in tone.sidebands:
        k = round(shift * COMPLETE * DT / (2.0 * np.pi))
        assert np.abs(gain[0] @ tone.camera[0] - spectrum[k, :2]).max() < 1e-6 * np.abs(spectrum[0, :2]).max()
        assert np.abs(spectrum[k, :2]).max() > 1e-4 * np.abs(spectrum[0, :2]).max()  # they matter here


def relative_error_weight(omega: np.ndarray, window: float) -> np.ndarray:
    """The paper's weight, written out once more."""
    x = np.asarray(omega) * window
    return x * np.hypot(x, np.sqrt(12.0)) / np.hypot(12.0 - x**2, 6.0 * x)


@pytest.mark.parametrize("omega", [55.0, 217.0, 400.0])
def test_the_relative_error_counts_the_power_of_all_sidebands(omega: float, telescope, monkeypatch) -> None:
    loop = closed(COMPLETE)
    amplitude = weight_amplitudes(telescope, omega)[0]
    spectrum = np.fft.fft(stepped(loop, omega)[:, :2], axis=0) / COMPLETE
    shifts = 2.0 * np.pi * np.fft.fftfreq(COMPLETE, DT)
    weights = relative_error_weight(np.abs(omega + shifts), 0.02)
    whole = (weights[:, None, None] * spectrum * amplitude).reshape(-1, 22)
    expected = np.linalg.svd(whole)[1][0]
    assert expected > 1.01 * np.linalg.svd(whole[:2])[1][0]
    monkeypatch.setattr(sampled_loop_norms, "loop_grid", lambda *_: np.array([omega]))
    grid, response, relative = weighted_response(loop, PLANT, telescope)
    assert grid.tolist() == [omega]
    assert relative[0] == pytest.approx(expected, rel=1e-6)
    assert np.abs(response[0, :2] - spectrum[0] * amplitude).max() < 1e-6 * np.abs(spectrum[0] * amplitude).max()


def gains(loop: SampledLoop, omega: np.ndarray, telescope) -> np.ndarray:
    """Largest singular values to line of sight, mirror and forces from the settled loop, shape (k, 3)."""
    rows = []
    for w in omega:
        H = stepped(loop, w).mean(axis=0) * weight_amplitudes(telescope, w)[0]
        rows.append([np.linalg.norm(H[part], 2) for part in (slice(0, 2), slice(2, 4), slice(4, 10))])
    return np.array(rows)


@pytest.mark.parametrize("frame_ticks", [1, COMPLETE])
def test_metrics_are_the_peaks_over_their_limits(frame_ticks: int, telescope) -> None:
    """Reached at a frequency of the grid, and not exceeded on another one."""
    plant, controllers = small_plant(), small_controllers()
    found = sampled_loop_metrics(plant, *controllers, at_rate(telescope, frame_ticks), loop="fsm+pma", noise=False)
    loop = closed(frame_ticks)
    omega, response, relative = weighted_response(loop, plant, telescope)
    assert omega[0] == pytest.approx(1e-2) and omega[-1] == pytest.approx(3e3)
    assert found.rpe == pytest.approx(relative.max() / 4.84813681109536e-07, rel=1e-12)
    assert found.rpe_fine == pytest.approx(2.5 * found.rpe, rel=1e-12)
    assert relative[omega == found.omega_rpe] == relative.max()
    parts = slice(0, 2), slice(2, 4), slice(4, 10)
    norms = np.array([np.linalg.norm(response[:, part], 2, axis=(1, 2)) for part in parts])
    peaks = omega[norms.argmax(axis=1)]
    limits = np.array([4.84813681109536e-05, 5.3e-3, 31.6])
    expected = np.diag(gains(loop, peaks, telescope)) / limits
    assert [found.ape, found.mirror, found.force] == pytest.approx(expected, rel=1e-8)
    others = np.random.default_rng(3).uniform(np.log(1.0), np.log(2e3), 60)
    elsewhere = gains(loop, np.exp(others), telescope).max(axis=0) / limits
    assert np.all(elsewhere <= 1.001 * np.array([found.ape, found.mirror, found.force]))
    assert np.isnan(found.noise_ape) and np.isnan(found.noise_rpe)
    assert found.stable and found.radius == pytest.approx(loop.spectral_radius(), rel=1e-12)


@pytest.mark.parametrize("stage", ["fsm", "fsm+pma"])
def test_grid_resolves_the_resonances(stage: str, telescope) -> None:
    """Near every lightly damped pole of the loop there are several frequencies."""
    loop = closed(20, stage)
    omega, _, _ = weighted_response(loop, PLANT, telescope, 5.0)
    assert omega[0] == pytest.approx(5.0)
    for w in (12.0, 60.0, 180.0, 420.0):
        assert np.sum(np.abs(omega / w - 1.0) < 0.05) >= 3


def covariance(loop: SampledLoop, sigma: np.ndarray) -> tuple[float, float]:
    """Rms of the line of sight, plain and weighted, by iterating the covariance from zero until it is periodic."""
    t = 0.02
    numerator, denominator = [t**2, np.sqrt(12.0) * t, 0.0], [t**2, 6.0 * t, 12.0]
    one = signal.tf2ss(*signal.bilinear(numerator, denominator, 1.0 / DT))
    A, B, C, D = (np.kron(np.eye(2), M) for M in one)
    n, size = len(loop.hold), len(loop.hold) + 4
    P, power = np.zeros((size, size)), np.zeros(2)
    steps = []
    for transition, noise in ((loop.frame, loop.noise_frame), (loop.hold, loop.noise_hold)):
        F = np.zeros((size, size))
        F[:n, :n], F[n:, :n], F[n:, n:] = transition, B @ loop.truth, A
        G = np.vstack([noise @ np.diag(sigma), np.zeros((4, 22))])
        steps.append((F, G @ G.T))
    weighted = np.hstack([D @ loop.truth, C])
    periods = 24000 // loop.frame_ticks
    for k in range(periods * loop.frame_ticks):
        if k >= (periods - 1) * loop.frame_ticks:
            power += np.trace(loop.truth @ P[:n, :n] @ loop.truth.T), np.trace(weighted @ P @ weighted.T)
        F, Q = steps[1 if k % loop.frame_ticks else 0]
        P = F @ P @ F.T + Q
    return tuple(np.sqrt(power / loop.frame_ticks))


@pytest.mark.parametrize("sensors", [None, "platform"])
@pytest.mark.parametrize("frame_ticks", [1, 20])
def test_noise_is_the_settled_covariance(frame_ticks: int, sensors: str | None, telescope) -> None:
    """Sensors with different noise on every kind of channel, so that none is taken for another."""
    each = [1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3]
    table = {"accelerometer_noise": each, "camera_noise": 2e-3, "strain_gauge_noise": 5e-2}
    changed = at_rate(telescope, frame_ticks).changed({"sensors": table})
    sigma = np.r_[np.tile(each, 3), [2e-3] * 2, [5e-2] * 2]
    if sensors == "platform":
        sigma[6:] = 0.0
    given: dict[str, Any] = {"loop": "fsm+pma", "sensors": sensors}
    found = sampled_loop_metrics(small_plant(), *small_controllers(), changed, **given)
    expected = covariance(closed(frame_ticks), sigma)
    assert [found.noise_ape, found.noise_rpe] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("frame_ticks", [9, 20])
def test_an_unstable_loop_has_infinite_metrics(frame_ticks: int, telescope) -> None:
    k_fsm, k_pma = small_controllers()
    D = k_fsm.D.copy()
    D[:, 18:20] *= 8.0
    pair = replace(k_fsm, D=D), k_pma
    found = sampled_loop_metrics(small_plant(), *pair, at_rate(telescope, frame_ticks), loop="fsm")
    assert not found.stable and found.radius > 1.0
    values = found.ape, found.rpe, found.rpe_fine, found.mirror, found.force, found.noise_ape, found.noise_rpe
    assert values == (np.inf,) * 7
    assert np.isnan(found.omega_rpe)


def test_a_loop_with_a_motion_that_does_not_decay_is_unstable(telescope, monkeypatch) -> None:
    monkeypatch.setattr(SampledLoop, "spectral_radius", lambda _: 1.0)
    found = sampled_loop_metrics(small_plant(), *small_controllers(), telescope, loop="fsm")
    assert not found.stable and found.ape == np.inf


SIGMA = 1e-3 * np.linspace(0.5, 2.0, 22)
TICKS = 40000


def test_the_correlation_is_the_transform_of_the_power_density() -> None:
    """Of a loop with a sample of every sensor at each tick: a sum over frequencies, exact once it has decayed."""
    own = closed(1)
    poles, vectors = np.linalg.eig(own.frame)
    left, right = np.linalg.solve(vectors, own.noise_frame * SIGMA), own.truth @ vectors
    z = np.exp(2j * np.pi * np.arange(TICKS) / TICKS)
    G = np.einsum("ik,kn,kj->nij", right, 1.0 / (z - poles[:, None]), left)
    density = G @ G.conj().swapaxes(1, 2)
    found = correlation(own, SIGMA)
    for lag in (0, 1, 7, 30):
        expected = np.mean(density * z[:, None, None] ** lag, axis=0).real
        np.testing.assert_allclose(found(lag), expected, rtol=1e-6, atol=1e-9 * np.abs(found(0)).max())


@pytest.mark.parametrize("frame_ticks", [1, 20])
def test_without_a_lag_it_is_the_covariance(frame_ticks: int) -> None:
    telescope, own = load_telescope(), closed(frame_ticks)
    plain, _ = covariances(own, telescope, None)
    found = correlation(own, telescope.loop_ports.noise)(0)
    np.testing.assert_allclose(found, plain, rtol=1e-9)
    np.testing.assert_allclose(found, found.T, rtol=1e-9)


def test_a_unit_divides_the_line_of_sight() -> None:
    own = closed(20)
    one, thousandth = correlation(own, SIGMA)(3), correlation(own, SIGMA, unit=1e-3)(3)
    np.testing.assert_allclose(thousandth, 1e6 * one, rtol=1e-12)


@pytest.mark.parametrize("ticks", [1, 2, 9])
def test_what_is_within_a_window_is_the_whole_less_its_mean(ticks: int) -> None:
    """The mean square of x less its mean is that of x, less that of the mean; of one tick nothing is left."""
    found = correlation(closed(20), SIGMA)
    within = covariances_in_window(found, ticks)
    assert within.shape == (ticks, 2, 2)
    of_mean = np.mean(
        [[found(j - i) if j >= i else found(i - j).T for j in range(ticks)] for i in range(ticks)], (0, 1)
    )
    np.testing.assert_allclose(within.mean(axis=0), found(0) - of_mean, atol=1e-9 * np.abs(found(0)).max())


def test_a_window_that_is_no_whole_number_of_ticks_has_them_by_their_share() -> None:
    """The mean over the begins of disjoint windows, in closed form for white noise: 1 less the mean of the squares."""
    within = covariances_in_window(lambda lag: np.eye(2) * (lag == 0), 2.5)
    squares = [(1 + 1 + 0.25) / 2.5**2, (0.25 + 1 + 1) / 2.5**2]  # of the weights of windows that begin at 0 and 0.5
    np.testing.assert_allclose(within.mean(axis=0), (1 - np.mean(squares)) * np.eye(2), atol=1e-12)


def model_of(speeds: tuple[float, ...]):  # type: ignore[no-untyped-def]
    base = RunConfig(mode="inprocess", loop="isolator", scenario="imbalance", wheel_speed=speeds, noise=False)
    return RunParts(base).tone_model()


def test_wheels_of_one_speed_but_for_rounding_have_the_tones_of_wheels_of_one_speed() -> None:
    """Phasors of one frequency add up; of tones of several frequencies the squares do."""
    speed = 200.0
    same = model_of((speed, speed, 250.0, -270.0))
    near = model_of((speed, np.nextafter(speed, np.inf), 250.0, -270.0))
    apart = model_of((speed, speed * 1.001, 250.0, -270.0))
    assert near.omega.size == same.omega.size < apart.omega.size
    np.testing.assert_allclose(near.omega, same.omega, rtol=1e-12)
    assert near.relative_error(0.02) == pytest.approx(same.relative_error(0.02), rel=1e-6)
    assert apart.relative_error(0.02) != pytest.approx(same.relative_error(0.02), rel=1e-4)
