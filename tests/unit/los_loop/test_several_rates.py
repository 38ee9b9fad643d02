"""A loop whose sensors have samples at several rates: matrices of each tick, product over the period, slow modes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from los_design.synthesis.store import load_designs
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop import SampledLoop
from titop_plant.interface import DT
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

DAMPING, HIGHEST = 0.05, 60.0


@pytest.fixture(scope="module")
def loop() -> SampledLoop:
    """Random matrices; one sensor at every tick of 6, one at 0, 2 and 4."""
    rng, n = np.random.default_rng(2), 13
    frame, hold, some = rng.standard_normal((3, n, n)) / n
    noise = rng.standard_normal((3, n, 22))
    between = dict.fromkeys((2, 4), (some, noise[2]))
    return SampledLoop(frame, hold, noise[0], noise[1], np.zeros((2, n)), 6, 3, between)


def test_each_tick_has_the_matrices_of_the_sensors_that_are_due(loop: SampledLoop) -> None:
    expected = [loop.frame, loop.hold, loop.between[2][0], loop.hold, loop.between[4][0], loop.hold]
    for k in range(12):
        assert loop.at(k)[0] is expected[k % 6]
    made = []

    def make(A: np.ndarray, N: np.ndarray) -> tuple[float, float]:
        made.append(A)
        return float(A[0, 0]), float(N[0, 0])

    assert [entry[0] for entry in loop.each_tick(make)] == [A[0, 0] for A in expected]
    assert len(made) == 3


def test_the_period_is_the_product_of_its_ticks(loop: SampledLoop) -> None:
    product = np.eye(len(loop.hold))
    for k in range(6):
        product = loop.at(k)[0] @ product
    np.testing.assert_allclose(loop.period, product, rtol=1e-12, atol=1e-15)


def test_a_change_is_made_to_all_matrices(loop: SampledLoop) -> None:
    changed = loop.changed(lambda A: 2.0 * A, lambda N: 3.0 * N, loop.truth)
    for k in range(6):
        assert np.array_equal(changed.at(k)[0], 2.0 * loop.at(k)[0])
        assert np.array_equal(changed.at(k)[1], 3.0 * loop.at(k)[1])
    np.testing.assert_allclose(changed.period, 2.0**6 * loop.period, rtol=1e-12)


@pytest.mark.parametrize("frame_ticks", [20, 100, 250])
def test_slow_modes_of_a_long_period_are_those_of_its_parts(frame_ticks: int) -> None:
    """Loops open: modes of telescope and controllers, also where others are alike over a period."""
    plant = control_loop_plant(load_telescope()).at({})
    pair = load_designs("implemented")
    loop = sampled_loop(plant, ControlLaws(*pair, "isolator", 0.1), frame_ticks=frame_ticks)
    poles = np.concatenate([linalg.eigvals(plant.A), *(np.log(linalg.eigvals(K.A)) / DT for K in pair)])
    light = (poles.imag > 0.0) & (poles.imag < HIGHEST) & (-poles.real < DAMPING * np.abs(poles))
    expected = np.sort(poles[light].imag)
    found = loop.slow_modes(loop.multipliers(), HIGHEST, DAMPING)
    assert len(expected) > 8
    assert all(np.abs(found - w).min() < 1e-5 * w for w in expected)
    if frame_ticks > 52:  # above half the frame rate the frequency is told from the states
        assert len(found) == len(expected)
