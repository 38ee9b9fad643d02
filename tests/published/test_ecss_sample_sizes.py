"""Sample sizes and factors printed in the literature on pointing statistics (ESSB-HB-E-003; Clopper & Pearson 1934)."""

from __future__ import annotations

import pytest

from pointing_analysis.indices import confidence


@pytest.mark.parametrize(
    ("probability", "exceedances", "samples"),
    [
        (0.997, 0, 998),
        (0.997, 1, 1580),
        (0.997, 2, 2097),
        (0.997, 5, 3502),
        (0.95, 0, 59),
        (0.95, 1, 93),
        (0.95, 2, 124),
        (0.95, 5, 208),
    ],
)
def test_samples_needed_at_95_percent_confidence(probability: float, exceedances: int, samples: int) -> None:
    assert confidence.samples_needed(probability, 0.95, exceedances) == samples
