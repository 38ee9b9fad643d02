"""Verdicts at 95 % confidence are false in at most 5 % of the records, whatever the motion: a part of the benchmark."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.scripts import script

coverage = script(Path(__file__).parents[3] / "benchmarks" / "verdict_coverage.py")


@pytest.mark.parametrize("kind", ["white", "bursts 20 ms x 10", "slow variance, random T/10"])
def test_few_verdicts_are_false(kind: str) -> None:
    """By the correlation of the values alone 12 to 26 % are false in bursts of 20 ms and in a slow variance."""
    (row,) = coverage.coverage(kind, 10, 0.075, 1)
    assert row["records"] == 150
    assert max(row["falsely_compliant"] + row["falsely_not_compliant"]) <= row["most"], row
    assert np.all(np.sum([row[k] for k in list(row)[4:]], axis=0) == pytest.approx(100.0, abs=0.05))


def test_records_with_a_burst_are_told_apart() -> None:
    """What is not in a record no verdict can know: 37 % have none of one burst on average."""
    every, seen = coverage.coverage("bursts 20 ms x 1", 10, 0.05, 1)
    assert every["records"] == 100 and 45 < seen["records"] < 80
    values, _ = coverage.records("bursts 20 ms x 1", 10, 20, 1)
    largest = np.array([np.sort(one)[-5] for one in values])
    assert np.array_equal(largest > 4.2, coverage.has_burst("bursts 20 ms x 1", 10, 20, 1))


def test_white_noise_needs_no_more_than_1_3_times_the_samples() -> None:
    for part in (0.0, 0.3):
        found = coverage.seconds_for_a_verdict("white", 0.9, part, 30, 2)
        assert found["half"] <= 1.3 and found["nine_tenths"] <= 1.3
