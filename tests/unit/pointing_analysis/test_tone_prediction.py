"""Stated deviations of a measured tone against its scatter in records of noise of known direction."""

import numpy as np
import pytest
from scipy import signal

from pointing_analysis.spectra.prediction import ToneComparison
from pointing_analysis.spectra.spectra import background, lines

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
