"""A waterfall of known coefficients, noise and a fixed resonance gives them back, and a source of its mean square."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from los_testbed.parts.disturbance_files import entries_of, make_sources
from support.slow_cases import slow

from lftkit.arrays import FloatArray
from titop_plant.disturbances.signals import noise_of_density
from titop_plant.disturbances.source_kinds import RunConditions
from titop_plant.disturbances.waterfall import identify
from titop_plant.telescope.load import load_telescope

RATE, SECONDS, MEANS = 800.0, 4.0, 6
ORDERS = np.array([1.0, 2.0, 3.3, 5.6])
COEFFICIENTS = np.array(
    [
        [8e-6, 8e-6, 1e-6, 0, 0, 0],
        [3e-6, 3e-6, 0, 0, 0, 0],
        [0, 0, 6e-6, 2e-7, 2e-7, 0],
        [1.5e-6, 1.5e-6, 1.5e-6, 0, 0, 0],
    ]
)
"""Amplitude over the speed in turns per second squared."""
NOISE = 2e-3 * np.array([1, 1, 1, 0.1, 0.1, 0.1])
"""Rms value of the white noise up to half of the rate [N, Nm]."""
RESONANCE = 87.0
"""Frequency of a mode of the test stand [Hz], damped by 2 %, that noise excites."""


@dataclass(frozen=True)
class Measured:
    """Waterfall of time records, and the mean square (s, 6) of these."""

    speeds: FloatArray
    frequency: FloatArray
    amplitude: FloatArray
    mean_square: FloatArray
    bandwidth: float


def measured(seed: int, hann: bool, spectra: int = 20) -> Measured:
    """Records of a wheel at several speeds, their spectra averaged as an analyser does."""
    rng, n = np.random.default_rng(seed), int(RATE * SECONDS)
    t, frequency = np.arange(n) / RATE, np.fft.rfftfreq(n, 1 / RATE)
    window = np.hanning(n + 1)[:-1] if hann else np.ones(n)
    mode = 0.3 / np.abs(1 - (frequency / RESONANCE) ** 2 + 0.04j * frequency / RESONANCE)
    speeds = np.linspace(15.0, 50.0, spectra) + 0.013
    power, square = np.zeros((2, spectra, n // 2, 6)), np.zeros((spectra, 6))
    for j, speed in enumerate(speeds):
        for _ in range(MEANS):
            noise = np.fft.rfft(rng.standard_normal((n, 6)), axis=0) * mode[:, None]
            record = NOISE * (rng.standard_normal((n, 6)) + np.fft.irfft(noise, n, axis=0))
            for order, size in zip(ORDERS, COEFFICIENTS):
                phase = rng.uniform(0, 2 * np.pi, 6)
                record += size * speed**2 * np.sin(2 * np.pi * order * speed * t[:, None] + phase)
            spectrum = 2 * np.abs(np.fft.rfft(record * window[:, None], axis=0)) / window.sum()
            power[0, j] += spectrum[: n // 2] ** 2 / MEANS
            square[j] += np.square(record).mean(axis=0) / MEANS
    power[0, :, 0] = 0.0
    bandwidth = n * np.square(window).sum() / window.sum() ** 2
    return Measured(speeds, frequency[: n // 2], np.sqrt(power[0]), square, float(bandwidth))


@pytest.fixture(scope="module", params=[slow(False), True], ids=["rectangular", "Hann"])
def waterfall(request: pytest.FixtureRequest) -> Measured:
    return measured(1, request.param)


@pytest.mark.further
def test_coefficients_noise_and_mode_are_those_of_the_wheel(waterfall: Measured) -> None:
    model = identify(waterfall.speeds, waterfall.frequency, waterfall.amplitude, waterfall.bandwidth)
    assert model.orders == pytest.approx(ORDERS, abs=2e-3)
    large = COEFFICIENTS > 0
    assert model.coefficients[large] == pytest.approx(COEFFICIENTS[large], rel=0.05)
    assert not model.coefficients[~large].any()
    assert model.modes == pytest.approx([RESONANCE], abs=1.0)
    density = model.density_at(33.0)
    away = (waterfall.frequency > 200.0) & (waterfall.frequency < 380.0)
    level = np.sqrt(density[away].mean(axis=0))
    assert level == pytest.approx(NOISE / np.sqrt(RATE / 2), rel=0.1)
    peak = density[np.abs(waterfall.frequency - RESONANCE) < 0.5].mean(axis=0)
    assert (peak > 20 * level**2).all()


@pytest.mark.further
def test_a_run_has_the_rms_of_the_record(waterfall: Measured, tmp_path) -> None:
    speed, file = waterfall.speeds[12], tmp_path / "a.npz"
    grid = np.meshgrid(waterfall.speeds * 60, waterfall.frequency, indexing="ij")
    columns = dict(zip(("Fx", "Fy", "Fz", "Tx", "Ty", "Tz"), waterfall.amplitude.reshape(-1, 6).T))
    np.savez(file, **{"speed (rpm)": grid[0].ravel(), "frequency (Hz)": grid[1].ravel()}, **columns)
    text = f'file = "a.npz"\nspeed = {2 * np.pi * speed}\nbandwidth = {waterfall.bandwidth}\n'
    (tmp_path / "a.toml").write_text(f'base = "reference"\n[[disturbance]]\nname = "a"\nkind = "waterfall"\n{text}')
    run = RunConditions((200.0,) * 4, 40.0, 1)
    (found,) = make_sources(entries_of([str(tmp_path / "a.toml")]), load_telescope(), run)
    values = np.vstack([found.signal.tick(k, np.array([0.0, 0.5])) for k in range(16_000)])
    assert values.std(axis=0) == pytest.approx(np.sqrt(waterfall.mean_square[12]), rel=0.06)
    assert found.signal.lines == pytest.approx(2 * np.pi * speed * ORDERS, rel=2e-3)
    assert any("modes at 8" in text for text in found.remarks)


def test_noise_alone_has_no_harmonics() -> None:
    """Also without averages, where every bin is a chance."""
    rng = np.random.default_rng(4)
    amplitude = np.abs(rng.standard_normal((2, 20, 800, 6))).T.swapaxes(0, 2)
    table = np.sqrt(np.square(amplitude).sum(axis=-1)).swapaxes(0, 1)
    model = identify(np.linspace(10.0, 50.0, 20), np.arange(800.0) / 2, table.reshape(20, 800, 6))
    assert model.orders.size == 0 and model.modes.size == 0


def test_a_frequency_of_all_speeds_is_noise() -> None:
    """Mains at 50 Hz through which harmonics pass, and sparse spectra without any noise."""
    speeds, frequency = np.linspace(20.0, 40.0, 9), np.arange(0.0, 300.0, 0.5)
    table = np.zeros((9, 600, 6))
    table[:, 100] = 0.3
    for row, speed in zip(table, speeds):
        for order, size in ((2.0, 1e-4), (3.3, 5e-5)):
            row[round(2 * order * speed), 0] += size * speed**2
    model = identify(speeds, frequency, table)
    assert model.orders == pytest.approx([2.0, 3.3], abs=0.01)
    assert model.coefficients[:, 0] == pytest.approx([1e-4, 5e-5], rel=1e-6)
    assert model.modes == pytest.approx([50.0])
    rng = np.random.default_rng(1)
    noise = noise_of_density(frequency, model.density_at(30.0)[:, [1] * 6], 600.0, 1e-3, rng)
    assert np.square(noise.values).mean() == pytest.approx(0.5 * 0.3**2, rel=0.1)
