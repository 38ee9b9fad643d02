"""From the proven relative error to the proven MTF: the steps, and the line beside the measured values."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pointing_analysis.image.motion_blur import covariance, exposures, motion_transfer, worst_transfer
from pointing_analysis.image.optics import Optics
from pointing_analysis.requirements.image_guarantee import least_transfer
from pointing_analysis.units import RAD_PER_MAS
from titop_plant.telescope.weights import rpe_weight

MAS, WINDOW = RAD_PER_MAS, 0.02
OPTICS = Optics(wavelength=550e-9, pixel_mas=38.0, aperture_diameter=1.5, obscuration=0.3)


def largest_variance(y: Any) -> Any:
    """Largest variance of cos(w t + phase) within a window over all phases, y = w times the window."""
    s = np.sinc(y / math.pi)
    half = np.sinc(y / (2 * math.pi))
    return np.maximum(1 - s, 1 + s - 2 * half**2) / 2


def test_the_largest_variance_of_a_tone() -> None:
    """Its two extreme phases, by brute force over the phases."""
    t = (np.arange(4000) + 0.5) / 4000 - 0.5
    for y in (0.3, 1.7, 4.0, 9.0, 40.0):
        tones = np.cos(y * t + np.linspace(0.0, math.pi, 181)[:, None])
        assert tones.var(axis=1).max() == pytest.approx(largest_variance(y), rel=1e-4)


def test_no_exposure_has_a_larger_rms_than_the_weighted_amplitude() -> None:
    """What `Statement.relative` says, at 200 000 frequencies; towards zero the ratio is 1 - y^2 / 20."""
    y = np.geomspace(1e-3, 1e5, 200_000)
    ratio = largest_variance(y) / rpe_weight(y, 1.0) ** 2
    assert ratio[y > 0.02].max() < 1.0
    small = y[(y > 0.02) & (y < 0.2)]
    assert np.allclose(1 - ratio[(y > 0.02) & (y < 0.2)], small**2 / 20, rtol=0.02)


@pytest.mark.parametrize("hertz", [0.7, 42.0, 333.0])
def test_every_exposure_of_a_tone_keeps_the_bound(hertz: float) -> None:
    """An elliptic motion whose weighted amplitude is at the level: rms and MTF of all exposures."""
    level, omega, rng = 20 * MAS, 2 * math.pi * hertz, np.random.default_rng(int(hertz))
    a = rng.standard_normal(2) + 1j * rng.standard_normal(2)
    a *= level / rpe_weight(omega, WINDOW) / np.sqrt(np.sum(np.abs(a) ** 2))
    t = 5e-5 * np.arange(400 * 300 + 1)
    paths = exposures((a * np.exp(1j * omega * t)[:, None]).real, 5e-5, WINDOW)
    rms = np.sqrt(np.trace(covariance(paths), axis1=1, axis2=2))
    assert rms.max() <= level * (1 + 1e-6)
    for part in (0.2, 0.5, 0.8):
        f = part * OPTICS.nyquist
        assert worst_transfer(paths, f)[0].min() >= least_transfer(level, f) - 1e-9


def test_the_bound_is_attained_and_ends() -> None:
    rms, f = 10 * MAS, 0.8 * OPTICS.nyquist
    assert least_transfer(rms, f) == pytest.approx(math.cos(2 * math.pi * f * rms))
    assert least_transfer(rms, f) > 1 - 2 * (math.pi * f * rms) ** 2
    assert least_transfer(rms, 0.25 / rms) == 0.0 and least_transfer(rms, 1e12) == 0.0
    two_places = np.zeros((1, 2001, 2))
    two_places[0, 1001:, 0] = 2 * rms
    found = abs(motion_transfer(two_places, np.array([[f, 0.0]]))[0, 0])
    assert found == pytest.approx(least_transfer(rms, f), abs=1e-3)
    with pytest.raises(ValueError, match="rms and frequency must not be negative, got -1 and 0"):
        least_transfer(-1.0, 0.0)
