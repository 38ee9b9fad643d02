"""Many ticks at once have the bits of single ones, and what another order of summation makes of them is bounded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.loop_rows import controller_of, estimator_of

from lftkit.systems.sampled.rounding import rounding_bound
from lftkit.systems.sampled.sampled_system import SampledSystem
from pointing_analysis.replay.gap_stepping import FILLS, GapStepper
from titop_plant.interface import CAMERA, DT, K_FSM_INPUTS, K_FSM_OUTPUTS, K_PMA_INPUTS, K_PMA_OUTPUTS, STAGES

seeds = st.integers(0, 2**32 - 1)
ROWS = 256
"""Rows whose products `OrderedProduct.recur` keeps together."""


def system(rng: np.random.Generator, order: int, ports: tuple, radius: float = 0.99) -> SampledSystem:
    """A random law with this spectral radius."""
    m, p = (sum(port.size for port in side) for side in ports)
    A = rng.standard_normal((order, order))
    A *= radius / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1e-9)
    B, C, D = (rng.standard_normal(shape) for shape in ((order, m), (p, order), (p, m)))
    return SampledSystem(A, B, C, D, *ports, DT)


def one_by_one(step, inputs: np.ndarray, width: int) -> np.ndarray:
    out = np.zeros((len(inputs), width))
    for given_, result in zip(inputs, out):
        step(given_, result)
    return out


@given(seeds, st.integers(0, 6), st.sampled_from([0, 1, 2, ROWS - 1, ROWS, ROWS + 1, 3 * ROWS + 7]))
def test_a_system_in_rows(seed: int, order: int, ticks: int) -> None:
    rng = np.random.default_rng(seed)
    law, state = system(rng, order, (K_PMA_INPUTS, K_PMA_OUTPUTS)), rng.standard_normal(order)
    inputs = rng.standard_normal((ticks, 6))
    law.reset(state)
    single, after = one_by_one(law.step, inputs, 6), law.state
    law.reset(state)
    assert np.array_equal(law.steps(inputs), single) and np.array_equal(law.state, after)


@given(seeds, st.integers(1, 40))
def test_an_observer_in_rows_holds_what_its_camera_saw(seed: int, ticks: int) -> None:
    rng = np.random.default_rng(seed)
    estimator = estimator_of(system(rng, 3, (K_FSM_INPUTS, K_FSM_OUTPUTS)))
    estimator.start_at(rng.standard_normal(3), rng.standard_normal(2))
    samples = rng.standard_normal((ticks, 22))
    samples[rng.random(ticks) < 0.6, CAMERA] = np.nan
    samples[rng.random(ticks) < 0.2, CAMERA.start] = np.nan
    estimator.reset()
    single, held = one_by_one(estimator.step, samples, 2), estimator.held.values.copy()
    for cut in (0, ticks // 2, ticks):
        estimator.reset()
        parts = [estimator.steps(part) for part in (samples[:cut], samples[cut:]) if len(part)]
        assert np.array_equal(np.concatenate(parts), single) and np.array_equal(estimator.held.values, held)


@given(seeds, st.sampled_from(STAGES[1:]), st.lists(st.sampled_from(STAGES[1:]), max_size=3), st.integers(1, 60))
def test_a_controller_in_rows_fades_as_it_does(seed: int, first: str, stages: list[str], ticks: int) -> None:
    rng = np.random.default_rng(seed)
    law = system(rng, 2, (K_PMA_INPUTS, K_PMA_OUTPUTS))
    samples = rng.standard_normal((len(stages) + 1, ticks, 8))
    results = []
    for in_rows in (False, True):
        controller = controller_of(law, first, los_sensitivity=0.1, fsm_authority=5.0, pma_authority=3.0)
        controller.reset()
        found = []
        for stage, part in zip([first, *stages], samples):
            if stage != controller.loop:
                controller.switch(stage)
            if in_rows:
                found.append(controller.steps(part[:, :2], part[:, 2:]))
            else:
                found.append(np.zeros((ticks, 8)))
                for sample, out in zip(part, found[-1]):
                    controller.step(sample[:2], sample[2:], out)
        results.append(np.concatenate(found))
    assert np.array_equal(*results)


@given(seeds, st.sampled_from(FILLS), st.lists(st.sampled_from([0, 0, 0, 1, 3, 60]), min_size=1, max_size=30))
def test_gaps_are_stepped_over_in_rows(seed: int, fill: str, gaps: list[int]) -> None:
    rng = np.random.default_rng(seed)
    law, samples = system(rng, 3, (K_PMA_INPUTS, K_PMA_OUTPUTS)), rng.standard_normal((len(gaps), 6))
    single, rows = np.zeros((2, len(gaps), 6))
    stepper = GapStepper(law.step, 6, fill=fill)
    for sample, gap, out in zip(samples, gaps, single):
        stepper(sample, gap, out)
    law.reset()
    GapStepper(law.step, 6, fill=fill, in_rows=law.steps).rows(samples, np.array(gaps), rows)
    assert np.array_equal(single, rows)


@given(seeds, st.integers(0, 8), st.sampled_from([0.5, 0.99, 0.9999, 1.001]), st.integers(1, 700))
def test_another_order_of_summation_stays_within_the_bound(seed: int, order: int, radius: float, ticks: int) -> None:
    rng = np.random.default_rng(seed)
    law = system(rng, order, (K_PMA_INPUTS, K_PMA_OUTPUTS), radius)
    state, inputs = rng.standard_normal(order), rng.standard_normal((ticks, 6)) * 10.0 ** rng.uniform(-6, 6, 6)
    bound = rounding_bound(law, state, [inputs])
    pieces = np.split(inputs, [ticks // 3, ticks // 2])  # of any lengths, and of none
    np.testing.assert_allclose(rounding_bound(law, state, pieces), bound, rtol=1e-9)
    law.reset(state)
    ordered = law.steps(inputs)
    turned, x = np.zeros_like(ordered), state
    for u, y in zip(inputs, turned):
        y[:] = law.D[:, ::-1] @ u[::-1] + law.C[:, ::-1] @ x[::-1]
        x = law.B[:, ::-1] @ u[::-1] + law.A[:, ::-1] @ x[::-1]
    assert np.all(np.abs(turned - ordered).max(axis=0) <= bound)


def test_an_error_beyond_rounding_is_beyond_the_bound() -> None:
    """Of a billionth of the outputs."""
    rng = np.random.default_rng(3)
    law, inputs = system(rng, 4, (K_PMA_INPUTS, K_PMA_OUTPUTS), 0.9), rng.standard_normal((500, 6))
    outputs = law.steps(inputs)
    assert np.all(np.abs(1e-9 * outputs).max(axis=0) > rounding_bound(law, np.zeros(4), [inputs]))


def test_a_state_that_overflows_has_no_bound() -> None:
    law = SampledSystem([[1e3]], [[1.0]], [[1.0]], [[0.0]], [("u", 1)], [("y", 1)], DT)
    assert rounding_bound(law, np.ones(1), [np.ones((400, 1))]) == pytest.approx([np.inf])
