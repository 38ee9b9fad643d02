"""Budget of the relative error: combined level against drawn errors, limits, weights of the bands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from titop_plant.telescope.error_budget import (
    ABSOLUTE_ON_AXIS,
    APE_NOISE,
    APE_TONE,
    TONE,
    TOTAL_NOISE,
    combined_level,
    error_budget,
    largest_tone,
)
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.requirements import window_probability
from titop_plant.telescope.weights import band_error_weight, rpe_weight

PROBABILITY, BAND_EDGE = 0.997, 85.0


@pytest.mark.parametrize(("tone", "noise"), [(20.0, 11.0), (5.0, 10.0), (30.0, 3.0), (0.0, 8.0)])
def test_the_level_holds_for_drawn_errors(tone: float, noise: float) -> None:
    """99.7 % of a million drawn errors are inside; the standard deviation of their count is 1.8 % of 0.3 %."""
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((2, 1_000_000)) * noise / np.sqrt(2.0)
    error = np.hypot(x + tone * np.sin(rng.uniform(0.0, 2.0 * np.pi, x.size)), y)
    outside = np.mean(error > combined_level(tone, noise, PROBABILITY, on_axis=0.5))
    assert outside == pytest.approx(1.0 - PROBABILITY, rel=0.09)


@pytest.mark.parametrize("omega", [3.0, 85.0, 150.0, 230.0, 402.0, 900.0])
@pytest.mark.parametrize("on_axis", [0.5, 0.75])
def test_the_level_holds_for_windows_of_records(omega: float, on_axis: float) -> None:
    """Rms of 20 ms of a tone of any phase with noise that is a ramp there: 400 000 windows of 200 samples."""
    rng = np.random.default_rng(1)
    count, tone, noise, length = 400_000, 19.0, 11.0, 0.02
    time = (np.arange(200) + 0.5) * (length / 200) - 0.5 * length
    ramp = time / np.sqrt(np.mean(time**2))
    amplitude = tone / abs(rpe_weight_of_window(omega, length))
    phase = rng.uniform(0.0, 2.0 * np.pi, count)
    # The window's mean square from the three inner products of cosine, sine and ramp.
    parts = np.stack([np.cos(omega * time), np.sin(omega * time), ramp])
    parts -= parts.mean(axis=1, keepdims=True)
    products = parts @ parts.T / time.size
    along, across = rng.standard_normal((2, count)) * noise * np.sqrt([[on_axis], [1.0 - on_axis]])
    weights = np.stack([amplitude * np.sin(phase), amplitude * np.cos(phase), along])
    square = np.einsum("in,ij,jn->n", weights, products, weights) + across**2
    level = combined_level(tone, noise, PROBABILITY, on_axis, turn=omega * length)
    assert np.mean(square > level**2) == pytest.approx(1.0 - PROBABILITY, rel=0.12)


def rpe_weight_of_window(omega: float, length: float) -> float:
    """Rms over all phases of a tone in a window, over that of the tone."""
    return float(np.sqrt(1.0 - np.sinc(omega * length / (2.0 * np.pi)) ** 2))


def test_closed_forms_at_the_ends() -> None:
    """Noise alone: Rayleigh, r sqrt(ln(1/0.003)); a tone alone: the sine is above the level for 0.3 % of its phases."""
    equal = combined_level(0.0, 10.0, PROBABILITY, on_axis=0.5)
    assert equal == pytest.approx(10.0 * np.sqrt(-np.log(1.0 - PROBABILITY)), rel=1e-9)
    one_axis = combined_level(0.0, 10.0, PROBABILITY, on_axis=1.0)
    assert one_axis == pytest.approx(10.0 * stats.norm.isf(0.5 * (1.0 - PROBABILITY)), rel=1e-6)
    assert combined_level(10.0, 0.0, PROBABILITY) == pytest.approx(10.0 * np.sin(0.5 * np.pi * PROBABILITY), rel=1e-12)
    assert largest_tone(16.7, 40.0, PROBABILITY) == 0.0
    assert combined_level(largest_tone(11.0, 40.0, PROBABILITY), 11.0, PROBABILITY) == pytest.approx(40.0, rel=1e-9)
    with pytest.raises(ValueError, match="must not be negative, got -1"):
        combined_level(-1.0, 2.0, PROBABILITY)
    with pytest.raises(ValueError, match=r"on_axis must be from 0\.1 to 1, got 1\.5"):
        combined_level(1.0, 2.0, PROBABILITY, on_axis=1.5)
    assert combined_level(10.0, 0.0, PROBABILITY, turn=400.0) == pytest.approx(10.0 / np.sqrt(2.0), rel=5e-3)


def test_the_largest_level_of_several_is_found_beside_the_largest_so_far() -> None:
    tones = [(10.0, 0.0), (24.0, 8.0), (24.1, 8.0), (9.0, 3.0), (0.0, 0.0), (25.0, 7.0), (4000.0, 2.0), (30.0, 0.0)]
    alone = [combined_level(tone, 3.0, PROBABILITY, turn=turn) for tone, turn in tones]
    level = 0.0
    for k, (tone, turn) in enumerate(tones):
        level = combined_level(tone, 3.0, PROBABILITY, turn=turn, least=level)
        assert level == max(alone[: k + 1])
    assert alone[2] > alone[1] > alone[0] > alone[3]


def test_the_shares_keep_the_limit_and_the_weights_are_those_of_the_window() -> None:
    telescope = load_telescope()
    budget = error_budget(telescope)
    for tone, omega in ((budget.slow, 0.0), (budget.fast_mirror, 250.0)):
        alone = combined_level(tone, budget.noise, PROBABILITY, turn=0.02 * omega)
        assert alone <= telescope.weights.rpe_limit
    assert combined_level(budget.tone, budget.total_noise, PROBABILITY) == pytest.approx(budget.limit, rel=1e-3)
    assert pytest.approx(largest_tone(TOTAL_NOISE, 1.0, PROBABILITY), abs=1e-4) == TONE
    assert pytest.approx(largest_tone(APE_NOISE, 1.0, PROBABILITY, ABSOLUTE_ON_AXIS), abs=1e-4) == APE_TONE
    absolute = combined_level(budget.ape_tone, budget.ape_noise, PROBABILITY, ABSOLUTE_ON_AXIS)
    assert absolute == pytest.approx(telescope.weights.ape_limit, rel=1e-3)
    fast = combined_level(budget.fast, budget.total_noise, PROBABILITY, turn=0.02 * 160.0)
    assert fast <= budget.limit and budget.fast < budget.fast_mirror
    weight = band_error_weight(telescope, "fast").to_control()
    assert abs(weight(700j)[0, 0]) == pytest.approx(rpe_weight(700.0, 0.02), rel=1e-5)


def test_the_parts_are_those_of_the_requirements(tmp_path: Path) -> None:
    """A smaller part of the windows leaves more for the tones, and makes another design; the APE has its own part."""
    texts = {"finest": "95 %", "APE": "0.9"}
    paths = {name: tmp_path / f"{name}.toml" for name in texts}
    for name, entry in (("finest", "RPE, finest"), ("APE", "APE")):
        quantity = "|APE| < 10 arcsec" if name == "APE" else "rms RPE(20 ms) < 40 mas"
        stages = "" if name == "APE" else 'loop = ["fsm+pma"]'
        text = f"prob({quantity}) >= {texts[name]} at 95 % confidence"
        paths[name].write_text(f'[[requirement]]\nname = "{entry}"\ntext = "{text}"\n{stages}\n')
    reference, finest, ape = load_telescope(), load_telescope(paths["finest"]), load_telescope(paths["APE"])
    parts = [window_probability(p.requirements) for p in (reference, finest, ape)]
    assert parts == [PROBABILITY, 0.95, PROBABILITY]
    own = error_budget(finest)
    assert own.limit == error_budget(reference).limit and own.tone > 1.05 * error_budget(reference).tone
    assert combined_level(own.tone, own.total_noise, 0.95) == pytest.approx(own.limit)
    absolute = error_budget(ape)
    assert absolute.tone == error_budget(reference).tone and absolute.ape_tone > 1.05 * error_budget(reference).ape_tone
    limit = ape.weights.ape_limit
    assert combined_level(absolute.ape_tone, absolute.ape_noise, 0.9, ABSOLUTE_ON_AXIS) == pytest.approx(limit)
    assert len({p.parameters_hash for p in (reference, finest, ape)}) == 3
