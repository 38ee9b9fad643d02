"""Lines are told from noise: false lines at the stated rate, lines 10 dB above the noise found, bounds that hold."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import binom

from pointing_analysis.spectra.line_search import SETTINGS, amplitude_bounds, find_lines
from pointing_analysis.spectra.sidebands import FoundLine
from pointing_analysis.spectra.spectra import psd

DT, SAMPLES = 1e-3, 10_000
DURATION = DT * SAMPLES
T = DT * np.arange(SAMPLES)
KINDS = ("white", "1/f", "modulated", "narrow band")
LEAST, MOST = 10.0, 40.0
"""dB above the noise of the lines."""


@dataclass(frozen=True)
class Known:
    """A record whose lines are known."""

    kind: str
    values: np.ndarray
    hertz: np.ndarray
    amplitude: np.ndarray
    level: np.ndarray


def shaped(rng: np.random.Generator, density: np.ndarray, n: int) -> np.ndarray:
    """Gaussian noise of a one-sided density (m,) [1/Hz], shape (n, 2), twice as long as needed and cut."""
    bins = len(density)
    size = 2 * (bins - 1)
    white = rng.standard_normal((bins, 2)) + 1j * rng.standard_normal((bins, 2))
    made = np.fft.irfft(white * np.sqrt(density * size / (4.0 * DT))[:, None], size, axis=0)
    return np.asarray(made[:n])


def noise(rng: np.random.Generator, kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Noise (n, 2), and its density (m,) of each axis before they are mixed, at frequencies (m,)."""
    hertz = np.fft.rfftfreq(2 * SAMPLES, DT)
    density: np.ndarray = np.full(hertz.size, 2.0 * DT)
    if kind == "1/f":
        density = density * (20.0 / np.maximum(hertz, hertz[1])) ** rng.uniform(0.5, 2.0)
    if kind == "narrow band":  # a carrier that noise of at least 2 Hz modulates, on a floor
        centre, width = rng.uniform(10.0, 400.0), 2.0 * 10.0 ** rng.uniform(0.0, 1.0)
        peak = 10.0 ** rng.uniform(1.0, 3.0)
        density = density * (1.0 + peak / (1.0 + ((hertz - centre) / (0.5 * width)) ** 2))
    values = shaped(rng, density, SAMPLES)
    if kind == "modulated":
        depth, rate = rng.uniform(0.3, 1.0), 10.0 ** rng.uniform(-1.0, 1.0)
        values *= (1.0 + depth * np.sin(2.0 * np.pi * rate * T + rng.uniform(0.0, 6.0)))[:, None]
        density = density * (1.0 + 0.5 * depth**2)
    return values, density, hertz


def record(seed: int, apart: float = 3.0, pairs: bool = False) -> Known:
    """Noise of one kind, its axes unlike and correlated, with 0 to 6 lines at 10 to 40 dB above it.

    Lines are `apart` / T from each other; every second is within 4 / T of the one before if they are in `pairs`.
    """
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    values, density, grid = noise(rng, kind)
    mixed = np.array([[1.0, 0.0], [rng.uniform(-0.7, 0.7), rng.uniform(0.3, 1.0)]])
    values = values @ mixed.T
    own = np.square(mixed).sum(axis=1)
    hertz: list[float] = []
    count = int(rng.integers(0, 7))
    while len(hertz) < count:
        new = 10.0 ** rng.uniform(0.0, math.log10(490.0))
        if pairs and len(hertz) % 2:
            new = max(hertz[-1] + rng.choice([-1.0, 1.0]) * rng.uniform(apart, 4.0) / DURATION, 1.0)
        if all(abs(new - other) > apart / DURATION for other in hertz):
            hertz.append(new)
    level = np.where(rng.random(count) < 0.5, LEAST, rng.uniform(LEAST, MOST, count))
    amplitudes = np.zeros((count, 2))
    for k, (f, dB) in enumerate(zip(hertz, level)):
        beside = float(np.interp(f, grid, density)) * own
        power = 10.0 ** (dB / 10.0) * SETTINGS.band * beside.sum()
        turn = rng.uniform(0.0, 0.5 * np.pi)
        amplitudes[k] = math.sqrt(2.0 * power) * np.array([math.cos(turn), math.sin(turn)])
        phases = rng.uniform(0.0, 2.0 * np.pi, 2)
        values = values + amplitudes[k] * np.cos(2.0 * np.pi * f * T[:, None] + phases)
    return Known(kind, values, np.array(hertz), amplitudes, level)


@dataclass
class Score:
    """What was found in some records."""

    lines: int = 0
    detected: int = 0
    found: int = 0
    false: int = 0
    records_with_false: int = 0
    bounds: int = 0
    inside: int = 0

    def add(self, known: Known, found: tuple[FoundLine, ...]) -> None:
        """Compare one record with what is known of it."""
        own = np.array([line.omega / (2.0 * np.pi) for line in found if not line.is_sideband])
        lines = [line for line in found if not line.is_sideband]
        false = sum(not np.any(np.abs(known.hertz - f) < 1.0 / DURATION) for f in own)
        self.lines += known.hertz.size
        self.found += own.size
        self.false += false
        self.records_with_false += bool(false)
        for f, amplitude in zip(known.hertz, known.amplitude):
            near = [line for line in lines if abs(line.omega / (2.0 * np.pi) - f) < 1.0 / DURATION]
            self.detected += bool(near)
            if near:
                self.bounds += 2
                self.inside += int(np.sum((near[0].lower <= amplitude) & (amplitude <= near[0].upper)))


def scored(seeds: range, apart: float = 3.0, pairs: bool = False) -> Score:
    score = Score()
    for seed in seeds:
        known = record(seed, apart, pairs)
        score.add(known, find_lines(known.values, DT))
    return score


def judge(seeds: range) -> Score:
    score = scored(seeds)
    assert score.false <= max(0.01 * score.found, binom.isf(1e-4, len(seeds), SETTINGS.false_lines)), score
    assert score.records_with_false <= binom.isf(1e-4, len(seeds), SETTINGS.false_lines), score
    assert score.detected >= 0.95 * score.lines, score
    assert score.inside >= binom.isf(0.999, score.bounds, 0.95), score
    return score


@pytest.mark.further
def test_lines_of_forty_records() -> None:
    judge(range(40))


@pytest.mark.slow
def test_lines_of_a_thousand_records() -> None:
    """At most 1 % of the found lines are false, 95 % of the lines from 10 dB are found, 95 % of the bounds hold."""
    score = judge(range(1000))
    assert score.false <= 0.01 * score.found


@pytest.mark.slow
def test_close_lines_of_many_records() -> None:
    """Pairs 1 to 4 / T apart, 400 records of other seeds: 95 % found, at most 1 % false, 95 % of the bounds hold."""
    score = scored(range(10_000, 10_400), apart=1.0, pairs=True)
    assert score.detected >= 0.95 * score.lines and score.false <= 0.01 * score.found, score
    assert score.inside >= binom.isf(0.999, score.bounds, 0.95), score


def settling(seed: int) -> np.ndarray:
    """White noise and an exponential decay, up to 1e5 times as large, of both axes."""
    rng = np.random.default_rng([5, seed])
    n = int(10.0 ** rng.uniform(2.5, 3.7))
    values = rng.standard_normal((n, 2))
    decay = np.exp(-np.arange(n) / n / 10.0 ** rng.uniform(-2.5, 0.5))
    return np.asarray(values + 10.0 ** rng.uniform(0.0, 5.0, 2) * decay[:, None])


@pytest.mark.parametrize("seed", [275, 497, 770, 910])
def test_settling_has_no_lines(seed: int) -> None:
    """The far spectrum of a decay falls by decades within the neighbours of a frequency."""
    assert find_lines(settling(seed), DT) == ()


@pytest.mark.slow
def test_false_lines_of_settling_and_of_gaps() -> None:
    """As many as in noise alone: the bound holds for 400 records of each."""
    false = {"settling": 0, "gaps": 0}
    for seed in range(400):
        values = settling(1000 + seed)
        false["settling"] += bool(find_lines(values, DT))
        rng = np.random.default_rng([6, seed])
        values = rng.standard_normal((len(values), 2))
        long = int(10.0 ** rng.uniform(0.0, math.log10(0.1 * len(values))))
        for begin in rng.integers(0, len(values) - long, max(len(values) // (10 * long), 1)):
            values[begin : begin + long] = np.nan
        false["gaps"] += bool(find_lines(values, DT))
    assert max(false.values()) <= binom.isf(1e-4, 400, SETTINGS.false_lines), false


def test_gaps_take_from_the_evidence_of_a_line_what_they_take_of_its_power() -> None:
    """The statistics of fit and noise have one taper: a tenth missing, a tenth less."""
    ratios = []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        values = rng.standard_normal((4000, 2))
        values[:, 0] += 0.3 * np.sin(2.0 * np.pi * 61.3 * T[:4000])
        (whole,) = find_lines(values, DT)
        values[(np.arange(4000) // 50) % 10 == 3] = np.nan
        (part,) = find_lines(values, DT)
        ratios.append(math.log(part.chance) / math.log(whole.chance))
    assert 0.8 < np.mean(ratios) < 0.95


def test_level_is_that_of_the_peak_over_the_noise_in_the_spectrum_of_the_report() -> None:
    rng = np.random.default_rng(5)
    t = DT * np.arange(240_000)
    amplitude = math.sqrt(2.0 * 100.0 * SETTINGS.band * 2.0 * 2.0 * DT)
    values = rng.standard_normal((t.size, 2))
    values[:, 0] += amplitude * np.sin(2.0 * np.pi * 40.0 * t)
    (line,) = find_lines(values, DT)
    assert line.level == pytest.approx(20.0, abs=0.5)
    spectrum = psd(values, DT)
    total = spectrum.density.sum(axis=1)
    peak, beside = total[160], np.median(total[100:150])
    assert 10.0 * math.log10(peak / beside) == pytest.approx(20.0, abs=0.7)


def test_bounds_of_small_and_large_amplitudes_hold_as_stated() -> None:
    rng = np.random.default_rng(2)
    for true in (0.0, 1.0, 5.0, 40.0):
        seen = np.abs(true + rng.standard_normal(4000) + 1j * rng.standard_normal(4000))
        low, high = amplitude_bounds(seen, np.ones(4000), np.full(4000, 1e7), 0.95)
        assert 0.94 < np.mean((low <= true) & (true <= high)) <= 1.0


def modulated_tone(depth: float, rate: float, in_angle: bool) -> np.ndarray:
    """A tone of 90 Hz on white noise, modulated in angle or in amplitude, on both axes."""
    slow = depth * np.sin(2.0 * np.pi * rate * T)
    tone = np.cos(2.0 * np.pi * 90.0 * T + slow) if in_angle else (1.0 + slow) * np.cos(2.0 * np.pi * 90.0 * T)
    return 0.1 * np.random.default_rng(7).standard_normal((SAMPLES, 2)) + np.outer(tone, [1.0, 0.5])


@pytest.mark.parametrize("in_angle", [True, False])
def test_sidebands_of_a_modulated_tone_name_it(in_angle: bool) -> None:
    lines = find_lines(modulated_tone(0.3, 4.0, in_angle), DT)
    carrier = max(lines, key=lambda line: line.power)
    sidebands = [line for line in lines if line.is_sideband]
    assert carrier.omega == pytest.approx(2.0 * np.pi * 90.0, abs=0.02) and not carrier.is_sideband
    assert {round(line.omega / (2.0 * np.pi)) for line in sidebands} >= {86, 94}
    assert {line.carrier for line in sidebands} == {carrier.omega} and len(sidebands) == len(lines) - 1


def test_harmonics_and_lines_of_their_own_are_no_sidebands() -> None:
    values = 0.1 * np.random.default_rng(8).standard_normal((SAMPLES, 2))
    for f, amplitude, phase in ((45.0, 1.0, 0.0), (90.0, 1.5, 1.0), (135.0, 1.0, 2.0), (60.0, 0.7, 0.3)):
        values[:, 0] += amplitude * np.cos(2.0 * np.pi * f * T + phase)
    lines = find_lines(values, DT)
    assert [round(line.omega / (2.0 * np.pi)) for line in lines] == [45, 60, 90, 135]
    assert not any(line.is_sideband for line in lines)


@pytest.mark.parametrize("offset", [-3.0, -1.3, 1.3, 3.0])
@pytest.mark.parametrize("turn", [0.0, 0.8])
def test_a_weak_line_beside_a_strong_one_is_a_line_of_its_own(offset: float, turn: float) -> None:
    """On the strong line's axis only (turn 0), and across it: 1.3 and 3 / T away, 20 dB below."""
    values = 0.1 * np.random.default_rng(11).standard_normal((SAMPLES, 2))
    values[:, 0] += np.cos(2.0 * np.pi * 60.0 * T)
    weak = 0.1 * np.cos(2.0 * np.pi * (60.0 + offset / DURATION) * T + 1.0)
    values += np.outer(weak, [math.cos(turn), math.sin(turn)])
    first, second = find_lines(values, DT)
    assert not first.is_sideband and not second.is_sideband


@pytest.mark.further
def test_close_lines_have_their_own_names() -> None:
    """Pairs 1 to 4 / T apart, of any levels from 10 dB: 95 % are found under their own name."""
    score = scored(range(40), apart=1.0, pairs=True)
    assert score.detected >= 0.95 * score.lines and score.false <= 1, score


@pytest.mark.parametrize("sweep", [0.05, 0.2, 5.0, 100.0])
def test_a_tone_that_moves_is_one_tone_or_none(sweep: float) -> None:
    """Hz by which a tone of 60 Hz moves in the record: less than its resolution, or so far that it is no line."""
    angle = 2.0 * np.pi * (60.0 * T + 0.5 * sweep * T**2 / DURATION)
    values = 0.1 * np.random.default_rng(9).standard_normal((SAMPLES, 2)) + np.cos(angle)[:, None]
    lines = [line for line in find_lines(values, DT) if not line.is_sideband]
    assert len(lines) == (1 if sweep < 0.1 else len(lines)) and len(lines) <= 1


def test_gaps_one_axis_and_records_that_are_too_short() -> None:
    values = np.random.default_rng(3).standard_normal((SAMPLES, 2))
    values[:, 1] = 0.0
    values[:, 0] += 0.3 * np.sin(2.0 * np.pi * 45.0 * T)
    values[4000:4500] = np.nan
    (line,) = find_lines(values, DT)
    assert line.omega == pytest.approx(2.0 * np.pi * 45.0, abs=0.1) and line.amplitude[1] == 0.0
    assert line.lower[0] <= 0.3 <= line.upper[0]
    assert find_lines(values[:50], DT) == () and find_lines(np.zeros((1000, 2)), DT) == ()
    values[: SAMPLES // 2] = np.nan
    assert find_lines(values, DT) == ()


def test_lines_close_together_are_told_apart_and_weak_ones_beside_strong_ones_found() -> None:
    values = 0.05 * np.random.default_rng(4).standard_normal((SAMPLES, 2))
    for f, amplitude in ((50.0, 10.0), (50.6, 8.0), (51.5, 0.02), (53.0, 0.02)):
        values += amplitude * np.cos(2.0 * np.pi * f * T[:, None] + np.array([f, 2.0 * f]))
    lines = find_lines(values, DT)
    assert [line.omega / (2.0 * np.pi) for line in lines] == pytest.approx([50.0, 50.6, 51.5, 53.0], abs=0.03)
    assert not any(line.is_sideband for line in lines)


@pytest.mark.parametrize("decimals", [None, 9, 6])
@pytest.mark.parametrize("hertz", [3.3, 30.0, 41.2357])
def test_a_tone_without_noise_is_a_line(hertz: float, decimals: int | None) -> None:
    """It had only what the taper leaves of it to stand out of, and was called noise."""
    t = 1e-3 * np.arange(55_000)
    tone = 9.0 * np.column_stack([np.sin(2.0 * np.pi * hertz * t), 0.2 * np.sin(2.0 * np.pi * hertz * t + 0.3)])
    lines = find_lines(tone if decimals is None else np.round(tone, decimals), 1e-3)
    line = max(lines, key=lambda one: one.power)  # rounding that repeats itself has lines of its own
    assert line.omega == pytest.approx(2.0 * np.pi * hertz, rel=1e-7)
    assert np.abs(line.phasor) == pytest.approx([9.0, 1.8], rel=1e-5)
