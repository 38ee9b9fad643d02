"""What a row of the stage comparison says of its limits."""

from types import SimpleNamespace

import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.summary.worst_case_rows import figure, level, limits_met

from pointing_analysis.formatting.number_text import ABSENT
from pointing_analysis.spectra.tone_budget import ToneBudget

OMEGA = 3.0
REQUIREMENTS = RunParts(RunConfig()).telescope.requirements


def summary(fast: float, noise: float, noise_error: float) -> SimpleNamespace:
    budget = ToneBudget(noise, 0.0, fast, 30.0, {}, noise_error)
    return SimpleNamespace(budget=budget, ape_p997=11.0, rpe_windows_p997=30.0, window=0.02)


@pytest.mark.parametrize(
    ("fast", "noise", "noise_error", "text"),
    [
        (17.0, 10.0, 0.3, "meets 100 and 40"),
        (17.0, 12.0, 0.7, "meets 100, 40 within the scatter"),
        (17.0, 12.4, 0.1, "meets 100, exceeds 40"),
        (17.0, 12.4, float("nan"), "meets 100, exceeds 40"),
        (66.7, 11.2, 0.5, "meets 100, exceeds 40"),
        (482.0, 11.2, 0.5, "exceeds 100 and 40"),
    ],
)
def test_a_limit_is_kept_or_broken_only_beyond_the_scatter_of_the_noise(
    fast: float, noise: float, noise_error: float, text: str
) -> None:
    assert limits_met(summary(fast, noise, noise_error), "slow", OMEGA, REQUIREMENTS) == text


def test_a_record_that_does_not_resolve_its_tone_has_no_level() -> None:
    """Such a loop has not diverged, and no limit is met or exceeded."""
    unresolved = summary(float("nan"), float("nan"), float("nan"))
    assert limits_met(unresolved, "slow", OMEGA, REQUIREMENTS) == "tones not resolved"
    assert figure(level(unresolved, "slow", OMEGA), "mas") == ABSENT
    assert figure(level(summary(3.0, 4.0, 0.1), "APE", OMEGA), "arcsec") == "11 arcsec"
