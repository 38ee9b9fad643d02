"""Missing ticks are stepped over on held samples, up to the limit."""

from __future__ import annotations

import numpy as np
import pytest

from pointing_analysis.replay.gap_stepping import GAP_LIMIT, GapStepper


class Recorder:
    def __init__(self) -> None:
        self.samples: list[np.ndarray] = []

    def step(self, sample: np.ndarray, out: np.ndarray) -> None:
        self.samples.append(sample.copy())
        out[0] = len(self.samples)


@pytest.mark.parametrize(("gap", "steps"), [(0, 1), (1, 2), (GAP_LIMIT, GAP_LIMIT + 1), (GAP_LIMIT + 1, 1), (10**6, 1)])
def test_a_gap_costs_as_many_steps_up_to_the_limit(gap: int, steps: int) -> None:
    core, out = Recorder(), np.zeros(1)
    stepper = GapStepper(core.step, 3, slice(1, 2))
    stepper(np.array([1.0, 2.0, 3.0]), 0, out)
    stepper(np.array([4.0, 5.0, 6.0]), gap, out)
    assert out[0] == len(core.samples) == 1 + steps
    assert core.samples[0].tolist() == [1.0, 2.0, 3.0]
    assert core.samples[-1].tolist() == [4.0, 5.0, 6.0]
    for held in core.samples[1:-1]:
        np.testing.assert_array_equal(held, [1.0, np.nan, 3.0])


def test_the_sample_is_copied() -> None:
    core, out, sample = Recorder(), np.zeros(1), np.ones(2)
    stepper = GapStepper(core.step, 2)
    stepper(sample, 0, out)
    sample[:] = 7.0
    stepper(np.zeros(2), 1, out)
    assert core.samples[1].tolist() == [1.0, 1.0]
