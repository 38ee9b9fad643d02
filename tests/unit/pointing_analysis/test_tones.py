"""Tones of known size: their parts of the relative error, and stated deviations against their scatter."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal
from scipy.signal import lfilter

from pointing_analysis.indices import metrics
from pointing_analysis.indices.errors import RAD_PER_MAS, ErrorSeries
from pointing_analysis.indices.weights import rpe_discrete
from pointing_analysis.spectra import record_lines, spectra
from pointing_analysis.spectra.prediction import ToneComparison
from pointing_analysis.spectra.spectra import background, lines
from pointing_analysis.spectra.tone_budget import tone_budget

T = 1e-3 * np.arange(60_000)


def series(values: np.ndarray) -> ErrorSeries:
    return ErrorSeries(values * RAD_PER_MAS, 1e-3, 0.0, 0)


def run_with(**parameters: object) -> SimpleNamespace:
    return SimpleNamespace(parameters=parameters)


def test_tones_and_noise_of_known_size_are_found() -> None:
    rng = np.random.default_rng(3)
    slow, fast = 20.0, 300.0
    tones = np.column_stack([100.0 * np.sin(slow * T), 15.0 * np.cos(fast * T + 0.3)])
    noise = 5.0 * rng.standard_normal(tones.shape)
    found = tone_budget(run_with(tones_rad_s=[slow, fast]), series(tones + noise), 0.02, 40.0, 0.997)
    weights = rpe_discrete(np.array([slow, fast]), 20, 1e-3)
    assert found.slow == pytest.approx(100.0 * weights[0], rel=0.01)
    assert found.fast == pytest.approx(15.0 * weights[1], rel=0.02)
    assert found.noise == pytest.approx(5.0 * math.sqrt(2.0 * 19 / 20), rel=0.02)
    assert found.total == 40.0 and found.allowances == {}


def test_tones_of_a_recording_that_was_cut_off_are_no_noise() -> None:
    """Its end has their names, too. With gaps everywhere no line is looked for: nothing is said of either."""
    noise = 5.0 * np.random.default_rng(3).standard_normal((len(T), 2))
    values = np.column_stack([15.0 * np.cos(300.0 * T), 0.0 * T]) + noise
    cut, holed = values.copy(), values.copy()
    cut[int(0.6 * len(T)) :] = math.nan
    holed[::3] = math.nan
    whole, found = (tone_budget(run_with(), series(e), 0.02, 40.0, 0.997) for e in (values, cut))
    assert (found.noise, found.fast) == (pytest.approx(whole.noise, rel=0.02), pytest.approx(whole.fast, rel=0.02))
    gaps = tone_budget(run_with(), series(holed), 0.02, 40.0, 0.997)
    assert math.isnan(gaps.noise) and "too many samples are missing" in str(gaps)


@pytest.mark.parametrize("pole", [0.0, 0.95])
def test_the_noise_of_short_records_scatters_as_its_error_says(pole: float) -> None:
    """White noise, and noise that is correlated over several windows."""
    found = []
    for seed in range(60):
        white = np.random.default_rng(seed).standard_normal((6000, 2))
        values = lfilter([1.0], [1.0, -pole], white, axis=0)[1000:]
        found.append(tone_budget(run_with(tones_rad_s=[300.0]), series(values), 0.02, 1.0, 0.997))
    noise, errors = np.array([f.noise for f in found]), np.array([f.noise_error for f in found])
    assert errors.mean() == pytest.approx(noise.std(ddof=1), rel=0.3)
    below = np.mean(noise - 1.645 * errors > math.sqrt(np.mean(noise**2)))
    assert below < 0.15, "5 % are expected"


def test_tones_that_nobody_has_named_are_tones_and_no_noise() -> None:
    rng = np.random.default_rng(3)
    cooler = 2.0 * np.pi * 45.0
    tones = np.column_stack([100.0 * np.sin(20.0 * T) + 30.0 * np.sin(cooler * T), 12.0 * np.cos(2.0 * cooler * T)])
    values = series(tones + 5.0 * rng.standard_normal(tones.shape))
    found = tone_budget(run_with(tones_rad_s=[20.0]), values, 0.02, 40.0, 0.997)
    weights = rpe_discrete(np.array([20.0, cooler, 2.0 * cooler]), 20, 1e-3)
    assert found.slow == pytest.approx(100.0 * weights[0], rel=0.01)
    assert found.fast == pytest.approx(math.hypot(30.0 * weights[1], 12.0 * weights[2]), rel=0.02)
    assert found.noise == pytest.approx(5.0 * math.sqrt(2.0 * 19 / 20), rel=0.02)
    rows = found.as_dict()["lines_found"]
    assert [row["hz"] for row in rows] == pytest.approx([45.0, 90.0], abs=1e-3)
    for row, amplitude in zip(rows, ([30.0, 0.0], [0.0, 12.0])):
        assert all(a <= x <= b for a, x, b in zip(row["lower_mas"], amplitude, row["upper_mas"]))


def test_long_records_are_searched_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tone that drifts over the record is a tone in each part; one that comes late counts for its time."""
    monkeypatch.setattr(record_lines, "LONGEST", 15_000)
    drift = 2.0 * np.pi * (45.0 * T + 0.5 * 5e-4 * T**2)
    late = np.where(T > 30.0, 20.0 * np.sin(700.0 * T), 0.0)
    values = np.column_stack([10.0 * np.sin(drift), late]) + np.random.default_rng(5).standard_normal((T.size, 2))
    values[7] = np.nan
    found, rest = record_lines.unnamed_lines(values, 1e-3)
    assert [line.omega for line in found] == pytest.approx([2.0 * np.pi * 45.015, 700.0], abs=0.03)
    assert found[0].amplitude[0] == pytest.approx(10.0, rel=0.02)
    assert found[1].amplitude[1] == pytest.approx(20.0 / math.sqrt(2.0), rel=0.02)
    assert np.isnan(rest[7]).all() and np.nanstd(rest) == pytest.approx(1.0, abs=0.02)


def test_what_the_fit_of_named_tones_leaves_of_a_record_without_noise_is_no_line() -> None:
    time = 1e-3 * np.arange(10_000)
    tones = np.column_stack([np.sin(100.0 * time), np.cos(333.0 * time)])
    crumbs = 1e-6 * np.column_stack([np.sin(200.0 * time), np.sin(250.0 * time)])
    named = spectra.lines(tones + crumbs, 1e-3, [100.0, 333.0], 0.02)
    found, rest = record_lines.unnamed_lines(tones + crumbs, 1e-3, named)
    assert found == () and np.abs(rest).max() < 1e-4


SLOW_TONES = 2.0 * math.pi * np.array([2.0, 4.0, 6.0, 8.0, 10.0])
SHORT = T[:7000]


def with_pulse(size: float) -> ErrorSeries:
    """7 s of noise of 5 mas, a slow tone of 30 and a fast one of 15, and the answer to a pulse that dies away."""
    rng = np.random.default_rng(3)
    tones = np.column_stack([30.0 * np.sin(SLOW_TONES[4] * SHORT), 15.0 * np.cos(300.0 * SHORT + 0.3)])
    decay = size * np.exp(-SHORT / 1.5)[:, None] * np.array([1.0, 0.3])
    return series(tones + decay + 5.0 * rng.standard_normal(tones.shape))


@pytest.mark.parametrize("size", [0.0, 3e4])
def test_a_pulse_is_no_tone(size: float) -> None:
    """Without a taper the tones would be several times the whole."""
    record = with_pulse(size)
    found = tone_budget(run_with(tones_rad_s=[*SLOW_TONES, 300.0]), record, 0.02, 40.0, 0.997)
    weights = rpe_discrete(np.array([SLOW_TONES[4], 300.0]), 20, 1e-3)
    assert found.slow == pytest.approx(30.0 * weights[0], abs=0.5)
    assert found.fast == pytest.approx(15.0 * weights[1], rel=0.03)
    whole = math.hypot(*metrics.rpe_rms(record.values, 1e-3, 0.02)) / RAD_PER_MAS
    assert math.sqrt(found.noise**2 + 0.5 * (found.slow**2 + found.fast**2)) == pytest.approx(whole, rel=0.03)
    assert found.noise < whole


def test_a_drift_is_no_line_of_a_wheel() -> None:
    """3 arcsec of random walk: without a taper 0.1 mas of it appear at 166.7 Hz, in every recording."""
    rng = np.random.default_rng(8)
    walk = np.cumsum(rng.standard_normal((30_000, 2)), axis=0) * 10.0 + 0.01 * rng.standard_normal((30_000, 2))
    time = 1e-3 * np.arange(30_000)
    values = RAD_PER_MAS * (walk + 30.0 * np.sin(378.2 * time)[:, None])
    above, within = spectra.above_noise(spectra.lines(values, 1e-3, [378.2, 1047.2], 0.02), values, 1e-3)
    assert [line.omega for line in above] == [378.2] and [line.omega for line in within] == [1047.2]
    assert above[0].amplitude == pytest.approx([30.0 * RAD_PER_MAS] * 2, rel=0.02)


def test_tones_that_cannot_be_told_are_not_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spectra, "LEAK", 0.5)
    found = tone_budget(run_with(tones_rad_s=[300.0], rpe_budget_mas={"total": 40}), with_pulse(0.0), 0.02, 33.0, 0.997)
    assert "tones cannot be distinguished from the rest" in str(found) and "total (99.7 %) 33 of 40" in str(found)
    content = found.as_dict()
    assert [content[part] for part in ("noise", "slow", "fast", "total")] == [None, None, None, 33.0]


DT, TICKS, OMEGA = 1e-3, 3000, 100.0
RECORDS = 200


def comparison(seed, axes, pole, phasor):
    """A tone in noise of a first-order filter with `pole`, and its size on each axis."""
    rng = np.random.default_rng(seed)
    white = rng.standard_normal((TICKS + 3000, 2)) * axes
    noise = signal.lfilter([1.0 - pole], [1.0, -pole], white, axis=0)[3000:]
    turning = np.exp(1j * (OMEGA * DT * np.arange(TICKS) + rng.uniform(0.0, 2.0 * np.pi)))
    record = noise + np.outer(turning, phasor).real
    line = lines(record, DT, [OMEGA], 0.02)[0]
    beside = background(noise, DT, [OMEGA], [phasor])[0]
    return ToneComparison(OMEGA, 1, float(np.linalg.norm(phasor)), float(np.hypot(*line.amplitude)), *beside)


@pytest.mark.parametrize(
    ("axes", "pole", "phasor"),
    [
        ([1.0, 1.0], 0.0, [1.0, 0.0]),
        ([1.0, 0.01], 0.99, [1.0, 0.0]),
        ([1.0, 0.01], 0.99, [1.0, 1.0j]),
        ([0.01, 1.0], 0.99, [1.0, 0.0]),
        ([1.0, 0.3], 0.99, [1.0, -1.0]),
    ],
)
def test_nineteen_of_twenty_ratios_are_within_two_standard_deviations(axes, pole, phasor):
    """Of noise on both axes, along the tone, on one of its axes, across it."""
    gain = (1.0 - pole) / abs(1.0 - pole * np.exp(-1j * OMEGA * DT))
    size = 10.0 * gain * np.hypot(*axes) * np.sqrt(6.0 / TICKS)
    tone = size * np.array(phasor) / np.linalg.norm(phasor)
    found = [comparison(seed, axes, pole, tone) for seed in range(RECORDS)]
    assert not any(one.in_noise for one in found)
    within = np.mean([abs(one.ratio - 1.0) <= one.uncertainty for one in found])
    assert 0.90 <= within <= 0.99
