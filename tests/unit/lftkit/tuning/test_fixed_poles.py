"""Plants near the limit of stability or of a singular loop, nested orders, poles that no controller moves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg
from support.tuned_plants import STATIC, tuned_plant

from lftkit.systems.system import System
from lftkit.tuning import HinfGain, TuningOptions, gain, state_space, tune, tune_discrete
from lftkit.tuning.fixed_poles import MIN_DECAY, slow_fixed_pole
from lftkit.tuning.nested_orders import embedded, lower_order
from lftkit.tuning.problem import Problem
from lftkit.tuning.status import TuningStatus, inaccurate
from lftkit.tuning.structures.structures import controller, pid


def masses(ground: float, measured: int = 2) -> System:
    """Two unit masses, a spring of 1 N/m between them and one of stiffness `ground` to the ground; no damping at all.

    Force on the first, disturbance on the second, whose position counts; position and rate of the first are measured.
    """
    K = np.array([[1.0 + ground, -1.0], [-1.0, 1.0]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, np.zeros((2, 2))]])
    B = np.array([[0.0, 0, 0, 1], [0, 0, 1, 0]]).T
    C = np.array([[0.0, 1, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0]])[: 2 + measured]
    D = np.zeros((2 + measured, 2))
    D[1, 1] = 1.0
    return System(A, B, C, D, [("w", 1), ("u", 1)], [("z", 2), ("y", measured)], "two masses")


def check_certified(result) -> None:
    """Certificate and tuned value agree, or the status does not promise it."""
    assert result.certificate is not None and result.certificate.stable
    if result.status == "converged":
        assert result.certificate.values.max() == pytest.approx(result.soft, rel=1e-3)
        assert result.certificate.upper.max() == pytest.approx(result.soft, rel=1e-3)


@pytest.mark.further
@pytest.mark.parametrize(
    ("ground", "order"),
    [
        (1e-4, 0),
        *(pytest.param(g, n, marks=pytest.mark.slow) for g in (0.0, 1e-4, 0.3) for n in (0, 1) if n or g != 1e-4),
    ],
)
def test_undamped_modes_are_tuned_and_certified(ground: float, order: int) -> None:
    """From an unstable start and from a random one; once the tuned value was 4588 and the certificate 27.5."""
    structure = state_space([("y", 2)], [("u", 1)], order)
    options = TuningOptions(starts=1, iterations=40)
    result = tune([masses(ground)], [HinfGain("w", "z")], structure, options=options)
    check_certified(result)
    assert result.soft < 6.0


@pytest.mark.parametrize("form", ["full", "tridiagonal", "modal"])
def test_embedded_controller_has_the_same_values(form: str) -> None:
    plant = masses(0.3)
    structure = state_space([("y", 2)], [("u", 1)], 2, form=form)
    lower = lower_order(structure)
    assert lower is not None and lower.order == 1 and lower.size == state_space([("y", 2)], [("u", 1)], 1).size
    x = lower.parameters_of(System([[-2.0]], [[0.3, 0.1]], [[0.2]], [[-0.4, -0.9]], [("y", 2)], [("u", 1)]))
    needs = [HinfGain("w", "z")]
    before = Problem([plant], needs, lower).evaluate(x).values
    problem = Problem([plant], needs, structure)
    points = embedded(structure, lower, x, problem)
    assert len(points) == 3
    for point in points:
        assert problem.evaluate(point).values == pytest.approx(before, rel=1e-6)
        assert np.linalg.eigvals(controller(structure, point).A).real.max() < 0.0


def test_structures_without_a_lower_order() -> None:
    assert lower_order(gain([("y", 2)], [("u", 1)])) is None
    assert lower_order(pid("y", "u", derivative_filter=0.1)) is None
    assert lower_order(state_space([("y", 1)], [("u", 1)], 2, form="companion")) is None
    assert lower_order(state_space([("y", 1)], [("u", 1)], 1, feedthrough=False)) is None, "no parameter would be left"


def test_the_ports_of_the_controller_may_be_those_of_a_requirement() -> None:
    """Gain from the command to the measurement with the loop closed: g / (1 - g k) with g = 1 / (s + 1)."""
    plant = System([[-1.0]], [[1.0]], [[1.0]], [[0.0]], [("u", 1)], [("y", 1)])
    needs = [HinfGain("u", "y"), HinfGain("u", "y", bound=0.25, hard=True, name="bound")]
    result = tune([plant], needs, STATIC, initial=[[-1.0]], options=TuningOptions(starts=0, iterations=20))
    assert result.feasible and result.soft <= 0.25 * (1 + 1e-6)


def test_a_loop_without_a_solution_is_an_unstable_one() -> None:
    """``y = x + u`` with u = y: which gain a search meets exactly depends on the last bits."""
    plant = tuned_plant([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 1.0]])
    problem = Problem([plant], [HinfGain("w", "z")], STATIC)
    assert problem.abscissa(np.array([1.0])) == np.inf and problem.abscissa(np.array([0.0])) == pytest.approx(-1.0)


def test_a_value_that_falls_up_to_the_singular_loop_ends_before_it() -> None:
    """x' = -x + w + u, y = x - u / 2, u = k y: x = w / (s + 1 - k / (1 + k / 2)), singular at k = -2."""
    plant = tuned_plant([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, -0.5]])
    requirements = [HinfGain("w", "z", name="gain"), HinfGain("w", "z", bound=10.0, hard=True, name="bound")]
    options = TuningOptions(starts=0)
    result = tune([plant], requirements, STATIC, initial=[[-0.5]], options=options)
    k = result.x.item()
    assert 1.0 + 0.5 * k == pytest.approx(1e-3, rel=1e-2)
    assert result.soft == pytest.approx(1.0 / (1.0 - k / (1.0 + 0.5 * k)), rel=1e-6)


LAW = state_space([("y", 1)], [("u", 1)], 1)
QUICK = TuningOptions(starts=1, iterations=40, seed=0)
BRIEF = TuningOptions(starts=1, target=1e6)


def weighted(pole: float) -> System:
    """1 / (s + 1) whose error is weighted by (s + 2) / (2 (s + pole)): the law does not see the weight's state."""
    A = [[-1.0, 0.0], [-0.5 * (2.0 - pole), -pole]]
    B = [[0.0, 1.0], [0.5 * (2.0 - pole), 0.0]]
    C = [[-0.5, 1.0], [0.0, 0.0], [-1.0, 0.0]]
    D = [[0.5, 0.0], [0.0, 0.1], [1.0, 0.0]]
    return System(A, B, C, D, [("w", 1), ("u", 1)], [("z", 2), ("y", 1)], "weighted")


def test_a_weight_as_slow_as_the_least_decay_asked_for_is_named() -> None:
    """Once: not stabilised after 40 s, "raise the order"; the loop is stable with any stable law."""
    pole = 1e-6
    found = tune([weighted(pole)], [HinfGain("w", "z")], LAW, min_decay=pole, options=QUICK)
    assert found.status is TuningStatus.NOT_STABILISED and found.certificate is None and found.soft == np.inf
    assert f"the pole {-pole:.6g} rad/s of weighted" in found.advice
    assert "min_decay = 1e-06" in found.advice and "order" not in found.advice
    assert found.evaluations == 1


@pytest.mark.parametrize("pole", [0.0, 1e-15])
def test_a_pole_that_rounding_does_not_tell_from_the_axis_is_named(pole: float) -> None:
    found = tune([weighted(pole)], [HinfGain("w", "z")], LAW, options=QUICK)
    assert found.status is TuningStatus.NOT_STABILISED and "no controller moves the pole" in found.advice
    assert "smaller min_decay" not in found.advice


@pytest.mark.parametrize("pole", [1e-6, 1e-9])
def test_without_a_least_decay_slow_weights_are_those_of_any_other_pole(pole: float) -> None:
    """The optimum of a nearly integrating weight does not depend on how slow its pole is.

    At the start the value is 1e8 times that: such an end was once taken for an infimum of zero. A start that ends
    within the gap of the lower bound is the last one.
    """
    found = tune([weighted(pole)], [HinfGain("w", "z")], LAW, options=TuningOptions(starts=3, seed=0))
    assert found.certificate is not None and found.certificate.stable
    assert found.soft == pytest.approx(0.534981, rel=1e-3)
    if found.lower_bound > 0.0:
        assert found.status is TuningStatus.CONVERGED and found.gap <= 1e-3 and found.evaluations < 4000


def test_a_slower_weight_that_becomes_active_later_is_admitted_too() -> None:
    """Once: not stabilised in the second round of a robust design whose box has the pole of the weight."""
    problem = Problem([weighted(1e-4)], [HinfGain("w", "z")], LAW)
    assert problem.min_decay == MIN_DECAY
    problem.add_model(weighted(1e-8))
    assert problem.min_decay == pytest.approx(0.5e-8) and problem.stable(np.array([-1.0, 0.0, 0.0, 0.0]))
    asked = Problem([weighted(1e-4)], [HinfGain("w", "z")], LAW, min_decay=1e-6)
    asked.add_model(weighted(1e-8))
    assert asked.min_decay == 1e-6


def test_the_peak_of_a_slower_weight_is_seen() -> None:
    """A static law has S(0) = 1 / 2, the weight 1 / pole; the grid once began at 0.3 times the pole, 4 % lower."""
    problem = Problem([weighted(1e-11)], [HinfGain("w", "z")], LAW)
    found = problem.evaluate(np.array([-1.0, 0.0, 0.0, 1.0]), gradients=False)
    assert found.values[0, 0] == pytest.approx(0.5e11, rel=1e-6)


def test_a_fixed_pole_is_one_in_rounded_coordinates_too() -> None:
    """Once, for a sampled plant in other coordinates: no start made every model stable, "raise the order"."""
    plant = weighted(1e-8)
    rounded = System(plant.A + 4e-14, plant.B, plant.C, plant.D, plant.inputs, plant.outputs)
    assert Problem([rounded], [HinfGain("w", "z")], LAW).min_decay == pytest.approx(0.5e-8, rel=1e-3)


def test_a_discrete_weight_is_admitted_too_and_named_where_a_decay_is_asked_for() -> None:
    pole = 1.0 - 1e-8  # -1e-6 rad/s at a period of 0.01 s
    plant = System(
        [[0.99, 0.0], [-0.01, pole]],
        [[0.0, 0.01], [0.01, 0.0]],
        [[-0.5, 1.0], [0.0, 0.0], [-1.0, 0.0]],
        [[0.5, 0.0], [0.0, 0.1], [1.0, 0.0]],
        [("w", 1), ("u", 1)],
        [("z", 2), ("y", 1)],
        "sampled",
        dt=0.01,
    )
    named = tune_discrete([plant], [HinfGain("w", "z")], LAW, min_decay=1e-6, options=QUICK)
    assert named.status is TuningStatus.NOT_STABILISED and "the pole -1e-06 rad/s of sampled" in named.advice
    assert named.soft == np.inf and named.certificate is None
    admitted = tune_discrete([plant], [HinfGain("w", "z")], LAW, options=BRIEF)
    assert admitted.status is not TuningStatus.NOT_STABILISED and np.isfinite(admitted.soft)


def test_what_does_not_reach_the_pole_is_named() -> None:
    unreached = System(
        [[1, 0], [0, -1]],
        [[1, 0], [0, 1]],
        [[1, 1], [1, 1]],
        np.zeros((2, 2)),
        [("w", 1), ("u", 1)],
        [("z", 1), ("y", 1)],
    )
    found = slow_fixed_pole([unreached], LAW, 1e-6)
    assert found is not None and found.missing == "commands" and found.value == 1.0


@pytest.mark.parametrize("seed", range(3))
def test_poles_that_a_law_reaches_are_not_fixed_however_slow_or_fast(seed: int) -> None:
    """Random plants in random coordinates, unstable and slow poles included: none is called fixed."""
    rng = np.random.default_rng(seed)
    T = rng.standard_normal((5, 5))
    A = T @ np.diag([1.0, 0.0, -1e-5, -1e3, -1.0]) @ linalg.inv(T)
    plant = System(
        A,
        rng.standard_normal((5, 2)),
        rng.standard_normal((2, 5)),
        np.zeros((2, 2)),
        [("w", 1), ("u", 1)],
        [("z", 1), ("y", 1)],
    )
    assert slow_fixed_pole([plant], LAW, 1e-6) is None


def test_inaccurate_says_both_values() -> None:
    assert "a tuned value is 3, its certificate 1.9e+06" in inaccurate([[1.0, 3.0]], [[1.0, 1.9e6]])
    assert "no optimum" in inaccurate([3.0], [705.0]) and "no optimum" not in inaccurate([3.0], [3.005])
