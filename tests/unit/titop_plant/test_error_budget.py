"""Budget of the relative error: limits, weights of the bands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from titop_plant.telescope.error_budget import APE_NOISE, APE_TONE, TONE, TOTAL_NOISE, error_budget, largest_tone
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.requirements import window_probability
from titop_plant.telescope.weights import band_error_weight, rpe_weight
from titop_plant.telescope.window_noise import WindowNoise, combined_level, ramp

PROBABILITY = 0.997


def test_the_shares_keep_the_limit_and_the_weights_are_those_of_the_window() -> None:
    telescope = load_telescope()
    budget = error_budget(telescope)
    slow_noise = WindowNoise(budget.noise, shape=np.outer(ramp(64), ramp(64)))
    for tone, omega in ((budget.slow, 0.0), (budget.fast_mirror, 250.0)):
        alone = combined_level(tone, slow_noise, PROBABILITY, 0.02 * omega)
        assert alone <= telescope.weights.rpe_limit
    assert combined_level(budget.tone, budget.total_noise, PROBABILITY) == pytest.approx(budget.limit, rel=1e-3)
    assert pytest.approx(largest_tone(TOTAL_NOISE, 1.0, PROBABILITY), abs=1e-4) == TONE
    assert pytest.approx(largest_tone(APE_NOISE, 1.0, PROBABILITY), abs=1e-4) == APE_TONE
    absolute = combined_level(budget.ape_tone, budget.ape_noise, PROBABILITY)
    assert absolute == pytest.approx(telescope.weights.ape_limit, rel=1e-3)
    fast = combined_level(budget.fast, slow_noise.changed(budget.total_noise), PROBABILITY, 0.02 * 160.0)
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
        paths[name].write_text(f'base = "reference"\n[[requirement]]\nname = "{entry}"\ntext = "{text}"\n{stages}\n')
    reference, finest, ape = load_telescope(), load_telescope(paths["finest"]), load_telescope(paths["APE"])
    parts = [window_probability(p.requirements) for p in (reference, finest, ape)]
    assert parts == [PROBABILITY, 0.95, PROBABILITY]
    own = error_budget(finest)
    assert own.limit == error_budget(reference).limit and own.tone > 1.05 * error_budget(reference).tone
    assert combined_level(own.tone, own.total_noise, 0.95) == pytest.approx(own.limit)
    absolute = error_budget(ape)
    assert absolute.tone == error_budget(reference).tone and absolute.ape_tone > 1.05 * error_budget(reference).ape_tone
    limit = ape.weights.ape_limit
    assert combined_level(absolute.ape_tone, absolute.ape_noise, 0.9) == pytest.approx(limit)
    assert len({p.parameters_hash for p in (reference, finest, ape)}) == 3
