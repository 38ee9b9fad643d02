"""Sums of proven bounds: against simulated errors, what is left out, words of margins."""

from __future__ import annotations

import math

import numpy as np
import pytest

from los_design.verification.error_sums import error_sums
from los_design.verification.figure_texts import bound_text, margin_text
from pointing_analysis.units import RAD_PER_ARCSEC, RAD_PER_MAS
from titop_plant.telescope.budget import ON_AXIS
from titop_plant.telescope.parameters import load_parameters

TONES = {"APE": 6.9 * RAD_PER_ARCSEC, "slow": 19.0 * RAD_PER_MAS, "fast": 20.0 * RAD_PER_MAS}
NOISE = (1.6 * RAD_PER_ARCSEC, 11.0 * RAD_PER_MAS)


def sums(tones: dict[str, float], noise: tuple[float, float] | None) -> dict[str, float]:
    return {row.name: row.value for row in error_sums(load_parameters(), "fsm+pma", tones, noise)}


def test_tones_and_noise_are_below_the_sum_as_often_as_is_asked() -> None:
    """Errors of slow and fast tones of norm 1 in all, any shares, and Gaussian noise: 99.7 % within the sum."""
    found = sums(TONES, NOISE)
    bound = found["RPE, slow and fast tone, norm 1 in all, and noise"]
    rng = np.random.default_rng(0)
    count = 400_000
    noise = rng.normal(size=(count, 2)) * 11.0 * np.sqrt([ON_AXIS, 1.0 - ON_AXIS])
    phases = np.sin(rng.uniform(0.0, 2.0 * math.pi, size=(count, 2)))
    for share in np.linspace(0.0, 1.0, 9):
        tone = 19.0 * share * phases[:, 0] + 20.0 * math.sqrt(1.0 - share**2) * phases[:, 1]
        within = float(np.mean(np.hypot(tone + noise[:, 0], noise[:, 1]) <= bound))
        assert within >= 0.997
    single = found["RPE, slow tone of norm 1 and noise"]
    assert np.mean(np.hypot(19.0 * phases[:, 1] + noise[:, 0], noise[:, 1]) <= single) >= 0.9965
    assert found["RPE, fast tone of norm 1 and noise"] < bound


def test_what_is_missing_is_left_out() -> None:
    assert sums({}, NOISE) == {} and sums({}, None) == {}
    names = sums({"slow": TONES["slow"]}, NOISE)
    alone = "RPE, slow tone of norm 1 and noise"
    assert list(names) == [alone, "slow, each of 22 channels at its own weight, norm 4.69, without noise"]
    assert names.popitem()[1] == pytest.approx(19.0 * math.sqrt(22.0))
    assert len(sums(TONES, None)) == 3 and len(sums(TONES, NOISE)) == 7


def test_a_disk_margin_in_words_is_never_more_than_what_is_proven() -> None:
    """Factors at the ends of the printed intervals keep ``|d| Ms <= 1``."""
    for peak in (1.1, 1.37, 1.777, 2.0, 3.3):
        low, high = (float(part.strip(",").strip("x")) for part in margin_text("sensitivity", peak).split()[4:7:2])
        assert abs(1.0 - 1.0 / low) * peak <= 1.0 + 1e-9 and abs(1.0 - 1.0 / high) * peak <= 1.0 + 1e-9
        low, high = (float(part.strip(",").strip("x")) for part in margin_text("gain x0.5", peak).split()[1:4:2])
        assert max(1.0 - low, high - 1.0) * peak <= 1.0 + 1e-9
    assert bound_text("sensitivity, mirror", 0.9, 2.0).startswith("sensitivity, mirror 1.8 of 2 (disk margin 0.555:")
    assert bound_text("one more tick, mirror", 0.5, 1.0) == "one more tick, mirror 0.5 of 1 (kept)"
