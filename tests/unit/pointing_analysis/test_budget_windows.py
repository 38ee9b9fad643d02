"""Random processes of a budget within an exposure, against integrals over frequency and closed forms."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from pointing_analysis.budget import sources as kinds
from pointing_analysis.budget.file import load_budget
from pointing_analysis.budget.total import evaluate
from pointing_analysis.indices.metrics import windows

HEAD = 'unit = "mas"\n[[requirement]]\ntext = "prob(|RPE(1 s)| < 20 mas) >= 0.997 at 95 % confidence"\n'


def source(tmp_path: Path, text: str) -> kinds.ErrorSource:
    """The one source of a budget."""
    (tmp_path / "budget.toml").write_text(f"{HEAD}[sources.a]\n{text}\n")
    return load_budget(tmp_path / "budget.toml").sources[0]


def flat(low: float, high: float, density: float, window: float) -> float:
    """Sigma within a window of a constant density: integral of S (1 - sinc(f T)^2)."""
    f = np.linspace(low, high, 400_001)
    return math.sqrt(np.trapezoid(density * (1 - np.sinc(f * window) ** 2), f))


@pytest.mark.parametrize(
    ("low", "high", "density", "window"),
    [(39.8, 40.2, 250.0, 1.0), (39.3, 39.7, 250.0, 1.0), (1.0, 500.0, 0.1, 10.0), (1.0, 500.0, 0.1, 0.02)],
)
def test_a_spectrum_above_the_parts_of_a_window(
    tmp_path: Path, low: float, high: float, density: float, window: float
) -> None:
    """The covariance had been sampled at 40 positions: 2.06 in place of 10 for a cooler at 40 Hz in 1 s."""
    found = source(tmp_path, f'type = "spectrum"\nfrequency = [{low}, {high}]\npsd = [{density}, {density}]')
    expected = flat(low, high, density, window)
    assert found.sigma(window) == pytest.approx([expected] * 2, rel=1e-5)
    rng = np.random.default_rng(4)
    assert found.draw(rng, rng.random(200_000), window).std(axis=0) == pytest.approx([expected] * 2, rel=0.01)


def test_a_narrow_spectrum_is_the_tone_of_its_power(tmp_path: Path) -> None:
    """And the total breaks the limit that the tone breaks."""
    narrow = source(tmp_path, 'type = "spectrum"\nfrequency = [39.8, 40.2]\npsd = [250, 250]')
    tone = kinds.tones(("a",), [80 * math.pi], [[math.sqrt(200)], [math.sqrt(200)]])
    assert narrow.sigma(1.0) == pytest.approx(tone.sigma(1.0), rel=1e-4)
    (verdict,) = evaluate(load_budget(tmp_path / "budget.toml"))
    assert verdict.total == pytest.approx(34.09, rel=0.02) and not verdict.compliant


def test_a_spectrum_at_a_position(tmp_path: Path) -> None:
    """At the end of a window more is left than at its middle; slow spectra keep their digits."""
    found = source(tmp_path, 'type = "spectrum"\nfrequency = [1e-9, 2e-9]\npsd = [1e18, 1e18]')
    rng = np.random.default_rng(5)
    ends, middle = (found.draw(rng, np.full(100_000, u), 1.0).std() for u in (0.0, 0.5))
    rate = 2 * math.pi * math.sqrt(1e18 * (8e-27 - 1e-27) / 3)
    assert found.sigma(1.0) == pytest.approx([rate / math.sqrt(12)] * 2, rel=1e-5)
    assert ends == pytest.approx(rate * (0.5 - 0.5 / kinds.POSITIONS), rel=0.01) and middle < 0.03 * ends


def test_a_peak_between_the_steps_of_a_wide_spectrum(tmp_path: Path) -> None:
    """A line of 0.02 Hz and power 10 at 40 Hz beside nine decades of little."""
    text = "[1e-6, 39.985, 39.99, 40.01, 40.015, 1000]\npsd = [1e-9, 1e-9, 500, 500, 1e-9, 1e-9]"
    found = source(tmp_path, f'type = "spectrum"\nfrequency = {text}')
    flanks = 2 * 0.005 * 500 / math.log(5e11)
    assert found.sigma(None) ** 2 == pytest.approx([10 + flanks] * 2, rel=1e-3)


@pytest.mark.parametrize("ratio", [1e-7, 1e-3, 0.099, 0.101, 1.0, 30.0, 1e3, 1e7])
def test_the_closed_form_of_exponential_correlation(ratio: float) -> None:
    """Also where the window is far shorter or longer than the correlation."""
    found = kinds.correlated(("a",), [3.0, 0.0], 1 / ratio)
    if ratio > 0.01:
        expected = 1 - 2 / ratio * (1 - (1 - math.exp(-ratio)) / ratio)
    else:
        expected = ratio / 3 - ratio**2 / 12 + ratio**3 / 60
    assert found.sigma(1.0) ** 2 == pytest.approx([9 * expected, 0.0], rel=1e-9)


def test_exponential_correlation_at_each_position() -> None:
    """Against the covariance at 2000 instants of the window."""
    window, tau, parts = 0.02, 0.03, kinds.POSITIONS
    t = (np.arange(50 * parts) + 0.5) / (50 * parts) * window
    table = np.exp(-np.abs(t[:, None] - t) / tau)
    expected = (1 - 2 * table.mean(axis=0) + table.mean()).reshape(parts, 50).mean(axis=1)
    found, rng = kinds.correlated(("a",), [1.0], tau), np.random.default_rng(6)
    for k in (0, 3, parts // 2, parts - 1):
        drawn = found.draw(rng, np.full(100_000, (k + 0.5) / parts), window)
        assert drawn.std() == pytest.approx(math.sqrt(expected[k]), rel=0.01)


@pytest.mark.parametrize("window", [0.012, 0.0125])
def test_a_tone_of_a_sampled_loop_is_that_of_its_record(window: float) -> None:
    """Also in windows that are no whole number of samples: of 12.5 ms, 12 samples had been taken."""
    omega, dt = 2 * np.pi * 41.0, 1e-3
    los = np.sin(omega * dt * np.arange(50_000))
    expected = windows(np.column_stack([los, los]), dt, window).variance.mean()
    found = kinds.tones(("tone",), [omega], np.ones((1, 1)), dt)
    assert found.sigma(window)[0] ** 2 == pytest.approx(expected, rel=2e-3)
    rng = np.random.default_rng(1)
    assert np.square(found.draw(rng, rng.random(40_000), window)).mean() == pytest.approx(expected, rel=0.02)
