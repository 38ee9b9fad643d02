"""Level of tones and noise in a window: drawn errors, integrals by other means, closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, optimize, special, stats

from titop_plant.telescope.error_budget import largest_tone
from titop_plant.telescope.weights import rpe_weight, window_ratio
from titop_plant.telescope.window_noise import SETTINGS, WindowNoise, combined_level, ramp, tone_shape

PROBABILITY = 0.997


def ramps(rms: float, on_axis: float = 0.7) -> WindowNoise:
    """Noise that is slow beside a window."""
    return WindowNoise(rms, on_axis, np.outer(ramp(64), ramp(64)))


@pytest.mark.parametrize(("tone", "noise"), [(20.0, 11.0), (5.0, 10.0), (30.0, 3.0), (0.0, 8.0)])
def test_the_level_holds_for_drawn_errors(tone: float, noise: float) -> None:
    """99.7 % of a million drawn errors are inside; the standard deviation of their count is 1.8 % of 0.3 %."""
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((2, 1_000_000)) * noise / np.sqrt(2.0)
    error = np.hypot(x + tone * np.sin(rng.uniform(0.0, 2.0 * np.pi, x.size)), y)
    outside = np.mean(error > combined_level(tone, WindowNoise(noise, 0.5), PROBABILITY))
    assert outside == pytest.approx(1.0 - PROBABILITY, rel=0.09)


BANDS = {"slow": [(0.05, 1.0)], "narrow": [(9.0, 1.0)], "wide": [(0.1, 0.5), (2.0, 0.2), (6.0, 0.2), (20.0, 0.1)]}


@pytest.mark.parametrize("bands", BANDS)
@pytest.mark.parametrize(
    ("turn", "tone", "slow"), [(0.0, 19.0, 0.0), (2.6, 19.0, 0.0), (9.0, 34.0, 0.0), (4.0, 15, 13)]
)
def test_the_level_holds_for_windows_of_records(bands: str, turn: float, tone: float, slow: float) -> None:
    """Rms in 200 000 windows of 100 samples: tones of any phase, noise as sums of sines and cosines."""
    rng = np.random.default_rng(1)
    count, rms, on_axis = 200_000, 10.49, 0.7
    time = (np.arange(100) + 0.5) / 100 - 0.5
    turns, powers = np.array(BANDS[bands]).T
    waves = np.vstack([np.cos(np.outer(turns, time)), np.sin(np.outer(turns, time))])
    waves -= waves.mean(axis=1, keepdims=True)
    sizes = np.sum(waves.reshape(2, len(turns), -1) ** 2, axis=(0, 2)) / len(time)
    waves *= np.tile(rms * np.sqrt(powers / sizes), 2)[:, None]
    phase, other = rng.uniform(0.0, 2.0 * np.pi, (2, count))
    fast = np.exp(1j * max(turn, 1e-4) * time)
    fast -= fast.mean()
    fast /= np.sqrt(np.mean(np.abs(fast) ** 2))
    along = rng.standard_normal((count, len(waves))) @ waves * np.sqrt(on_axis)
    along += tone * (np.exp(1j * phase)[:, None] * fast).real
    along += slow * np.sin(other)[:, None] * time / np.sqrt(np.mean(time**2))
    across = rng.standard_normal((count, len(waves))) @ waves * np.sqrt(1.0 - on_axis)
    error = np.sqrt(np.mean(along**2 + across**2, axis=1))
    noise = WindowNoise.of_spectrum(rms, on_axis, turns, powers)
    level = combined_level(tone, noise, PROBABILITY, turn, slow=slow)
    assert np.mean(error > level) == pytest.approx(1.0 - PROBABILITY, rel=0.15)
    assert level <= combined_level(tone, WindowNoise(rms, on_axis), PROBABILITY, turn, slow=slow) * (1.0 + 1e-6)


def test_no_noise_at_one_frequency_is_worse_than_a_ramp_or_noise_at_the_tone() -> None:
    """Of which the larger level is taken where the shape is not known."""
    for turn, tone in ((1.0, 20.0), (2.6, 19.0), (5.0, 25.0), (9.0, 34.0), (20.0, 30.0)):
        for rms in (4.0, 10.5):
            any_shape = combined_level(tone, rms, PROBABILITY, turn)
            for at in (0.3, 0.7 * turn, 0.9 * turn, 1.1 * turn, 1.5 * turn, 3.0 * turn, 40.0):
                narrow = WindowNoise.of_spectrum(rms, 0.7, np.array([at]), np.ones(1))
                assert combined_level(tone, narrow, PROBABILITY, turn) <= any_shape * 1.002


def by_quadrature(tone: float, rms: float, on_axis: float, level: float) -> float:
    """Probability that (a sin phi + n1, n2) is beyond a level."""
    along, across = rms * np.sqrt(on_axis), rms * np.sqrt(1.0 - on_axis)
    shifts = tone * np.sin((np.arange(400) + 0.5) * np.pi / 400)

    def inside(y: float) -> float:
        half = np.sqrt(level**2 - y**2)
        within = special.ndtr((half - shifts) / along) - special.ndtr((-half - shifts) / along)
        return float(np.mean(within) * np.exp(-0.5 * (y / across) ** 2) / (across * np.sqrt(2.0 * np.pi)))

    return 1.0 - 2.0 * float(integrate.quad(inside, 0.0, min(level, 9.0 * across), epsabs=1e-12, limit=200)[0])


@pytest.mark.parametrize("rms", [20.0, 6.0, 2.1, 1.9, 0.7, 0.3])
@pytest.mark.parametrize("probability", [0.5, 0.9, PROBABILITY, 0.99999])
def test_both_ways_to_the_distribution_are_the_integral(rms: float, probability: float) -> None:
    """The contour beside noise of a fifth of the tone or more, the saddle point beside less."""
    expected = optimize.brentq(lambda x: by_quadrature(10.0, rms, 0.7, x) - (1.0 - probability), 1e-3, 200.0, xtol=1e-9)
    rel = 1e-5 if rms > 10.0 * SETTINGS.small_noise else 4e-4
    assert combined_level(10.0, ramps(rms), probability) == pytest.approx(expected, rel=rel)


def test_closed_forms_at_the_ends() -> None:
    """Noise alone: Rayleigh, r sqrt(ln(1/0.003)); a tone alone: the sine is above the level for 0.3 % of its phases."""
    equal = combined_level(0.0, WindowNoise(10.0, 0.5), PROBABILITY)
    assert equal == pytest.approx(10.0 * np.sqrt(-np.log(1.0 - PROBABILITY)), rel=1e-7)
    one_axis = combined_level(0.0, WindowNoise(10.0, 1.0), PROBABILITY)
    assert one_axis == pytest.approx(10.0 * stats.norm.isf(0.5 * (1.0 - PROBABILITY)), rel=1e-6)
    assert combined_level(10.0, 0.0, PROBABILITY) == pytest.approx(10.0 * np.sin(0.5 * np.pi * PROBABILITY), rel=1e-12)
    assert largest_tone(16.7, 40.0, PROBABILITY) == 0.0
    assert combined_level(largest_tone(11.0, 40.0, PROBABILITY), 11.0, PROBABILITY) == pytest.approx(40.0, rel=1e-7)
    with pytest.raises(ValueError, match="must not be negative, got -1"):
        combined_level(-1.0, 2.0, PROBABILITY)
    with pytest.raises(ValueError, match="noise must not be negative, got -2"):
        combined_level(1.0, -2.0, PROBABILITY)
    with pytest.raises(ValueError, match=r"on_axis must be from 0\.1 to 1, got 1\.5"):
        WindowNoise(2.0, 1.5)
    assert combined_level(10.0, 0.0, PROBABILITY, turn=400.0) == pytest.approx(10.0 / np.sqrt(2.0), rel=5e-3)


def test_a_slow_tone_is_a_ramp() -> None:
    assert np.allclose(tone_shape(0.02, 64).imag, ramp(64), atol=1e-3)
    near, slow = (combined_level(17.0, ramps(11.0), PROBABILITY, turn) for turn in (0.02, 0.0))
    assert near == pytest.approx(slow, rel=1e-4)


def test_the_largest_level_of_several_is_found_beside_the_largest_so_far() -> None:
    tones = [(10.0, 0.0), (24.0, 8.0), (24.1, 8.0), (9.0, 3.0), (0.0, 0.0), (25.0, 7.0), (4000.0, 2.0), (30.0, 0.0)]
    alone = [combined_level(tone, ramps(3.0), PROBABILITY, turn) for tone, turn in tones]
    level = 0.0
    for k, (tone, turn) in enumerate(tones):
        level = combined_level(tone, ramps(3.0), PROBABILITY, turn, least=level)
        assert level == max(alone[: k + 1])
    assert alone[2] > alone[1] > alone[0] > alone[3]


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1, 3.0])
def test_two_tones_beside_little_noise(noise: float) -> None:
    """Of independent phases, 10 and 8: at most their sum, and near it in 0.3 % of the windows."""
    level = combined_level(10.0, ramps(noise), PROBABILITY, slow=8.0)
    phase = np.random.default_rng(2).uniform(0.0, 2.0 * np.pi, (2, 400_000))
    drawn = np.abs(10.0 * np.sin(phase[0]) + 8.0 * np.sin(phase[1]))
    if noise < 1.0:
        assert np.quantile(drawn, PROBABILITY) * 0.999 < level < 18.5
    else:
        assert level > combined_level(10.0, ramps(noise), PROBABILITY) + 5.0


@pytest.mark.parametrize("omega", [20.0, 85.0, 200.0, 275.0, 339.4, 400.0, 900.0])
def test_the_level_of_a_weighted_tone_is_that_of_its_windows(omega: float) -> None:
    """The rational weight is up to 4.5 % below the error in windows, as in a record of finely sampled windows."""
    phase, place = np.linspace(0.0, 2.0 * np.pi, 2000)[:, None], (np.arange(400) + 0.5) / 400
    sizes = np.std(10.0 * np.cos(0.02 * omega * place + phase), axis=1)
    tone = 10.0 * float(rpe_weight(omega, 0.02)) * float(window_ratio(0.02 * omega))
    assert combined_level(tone, 0.0, PROBABILITY, 0.02 * omega) == pytest.approx(
        np.quantile(sizes, PROBABILITY), rel=1e-3
    )
