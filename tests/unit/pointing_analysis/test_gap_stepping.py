"""Missing ticks are stepped over on a straight line or on held samples, up to the limit."""

from __future__ import annotations

import numpy as np
import pytest

from pointing_analysis.replay.gap_stepping import FILLS, GAP_LIMITS, HOLD, LINE, GapStepper

GAP_LIMIT = GAP_LIMITS[HOLD]


class Recorder:
    def __init__(self) -> None:
        self.samples: list[np.ndarray] = []

    def step(self, sample: np.ndarray, out: np.ndarray) -> None:
        self.samples.append(sample.copy())
        out[0] = len(self.samples)


@pytest.mark.parametrize(("gap", "steps"), [(0, 1), (1, 2), (GAP_LIMIT, GAP_LIMIT + 1), (GAP_LIMIT + 1, 1), (10**6, 1)])
def test_a_gap_costs_as_many_steps_up_to_the_limit(gap: int, steps: int) -> None:
    core, out = Recorder(), np.zeros(1)
    stepper = GapStepper(core.step, 3, slice(1, 2), HOLD)
    stepper(np.array([1.0, 2.0, 3.0]), 0, out)
    stepper(np.array([4.0, 5.0, 6.0]), gap, out)
    assert out[0] == len(core.samples) == 1 + steps
    assert core.samples[0].tolist() == [1.0, 2.0, 3.0]
    assert core.samples[-1].tolist() == [4.0, 5.0, 6.0]
    for held in core.samples[1:-1]:
        np.testing.assert_array_equal(held, [1.0, np.nan, 3.0])


@pytest.mark.parametrize("gap", [1, 2, 7, GAP_LIMITS[LINE]])
def test_a_line_is_met_exactly_and_a_bend_no_worse_than_by_a_held_sample(gap: int) -> None:
    """Of a ramp no missing sample is wrong; the error of a tone is at most its bend, (w dt (gap + 1))^2 / 8."""
    ticks, frequency = np.arange(gap + 2), 0.3 / (gap + 1)
    for truth, bound in ((2.0 - 0.5 * ticks, 1e-12), (np.sin(frequency * ticks + 0.7), 0.3**2 / 8)):
        worst = {}
        for fill in FILLS:
            core, out = Recorder(), np.zeros(1)
            stepper = GapStepper(core.step, 1, fill=fill)
            stepper(truth[:1], 0, out)
            stepper(truth[-1:], gap, out)
            worst[fill] = np.abs(np.ravel(core.samples) - truth).max()
        assert worst[LINE] <= bound < worst[HOLD]


def test_where_the_line_is_not_finite_the_sample_before_is_held() -> None:
    core, out = Recorder(), np.zeros(1)
    stepper = GapStepper(core.step, 4, slice(0, 1))
    stepper(np.array([1.0, 2.0, -1.7e308, np.nan]), 0, out)
    stepper(np.array([5.0, np.nan, 1.7e308, 3.0]), 1, out)
    np.testing.assert_array_equal(core.samples[1], [np.nan, 2.0, -1.7e308, np.nan])


def test_a_gap_beyond_half_a_period_of_the_fast_tones_is_left_out() -> None:
    core, out = Recorder(), np.zeros(1)
    stepper = GapStepper(core.step, 1)
    stepper(np.zeros(1), 0, out)
    stepper(np.ones(1), GAP_LIMITS[LINE] + 1, out)
    assert [float(sample[0]) for sample in core.samples] == [0.0, 1.0]
