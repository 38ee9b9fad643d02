"""What a row of the stage comparison says of its limits."""

from types import SimpleNamespace

import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.summary.worst_case_rows import level, limits_met

from pointing_analysis.spectra.tone_budget import ToneBudget
from titop_plant.telescope.error_budget import combined_level

OMEGA = 3.0
REQUIREMENTS = RunParts(RunConfig()).telescope.requirements


def summary(fast: float, noise: float, noise_error: float) -> SimpleNamespace:
    budget = ToneBudget(noise, 0.0, fast, 30.0, {}, noise_error)
    return SimpleNamespace(budget=budget, ape_p997=11.0, rpe_windows_p997=30.0, window=0.02)


@pytest.mark.parametrize(
    ("fast", "noise", "noise_error", "text"),
    [
        (17.0, 10.0, 0.3, "meets 100 and 40"),
        (17.0, 11.0, 0.5, "meets 100, 40 within the scatter"),
        (17.0, 12.0, 0.7, "meets 100, 40 within the scatter"),
        (17.0, 11.5, 0.7, "meets 100, 40 within the scatter"),
        (17.0, 12.4, 0.1, "meets 100, exceeds 40"),
        (17.0, 12.4, float("nan"), "meets 100, exceeds 40"),
        (66.7, 11.2, 0.5, "meets 100, exceeds 40"),
        (482.0, 11.2, 0.5, "exceeds 100 and 40"),
        (float("nan"), 11.2, 0.5, "exceeds 100 and 40"),
    ],
)
def test_a_limit_is_kept_or_broken_only_beyond_the_scatter_of_the_noise(
    fast: float, noise: float, noise_error: float, text: str
) -> None:
    assert limits_met(summary(fast, noise, noise_error), "slow", OMEGA, REQUIREMENTS) == text


def test_what_is_shown_is_the_level_of_the_record_itself() -> None:
    assert level(summary(19.4, 12.4, 0.7), "fast", OMEGA) == pytest.approx(
        combined_level(19.4, 12.4, 0.997, turn=0.02 * OMEGA)
    )
    assert limits_met(summary(19.4, 12.4, 0.7), "APE", OMEGA, REQUIREMENTS) == "exceeds 10"
