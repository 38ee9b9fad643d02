"""Plants near the limit of stability or of a singular loop, nested orders, problems that have no good answer."""

from __future__ import annotations

import numpy as np
import pytest
from support.tuned_plants import STATIC, tuned_plant

from lftkit.systems.system import System
from lftkit.tuning import HinfGain, TuningOptions, gain, tune
from lftkit.tuning.gains.algebraic_loop import LEAST
from lftkit.tuning.nested_orders import embedded, lower_order
from lftkit.tuning.problem import Problem
from lftkit.tuning.structures.structures import controller, pid, state_space


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


@pytest.mark.slow
def test_order_one_is_never_worse_than_static() -> None:
    """The static controller is the start of the first order: same seed, same options."""
    values = [
        tune(
            [masses(0.3)],
            [HinfGain("w", "z")],
            state_space([("y", 2)], [("u", 1)], order),
            options=TuningOptions(starts=1, iterations=4),
        ).soft
        for order in (0, 1)
    ]
    assert values[1] <= values[0] * (1 + 1e-9)


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


def test_direct_path_that_no_controller_changes_bounds_the_value() -> None:
    """z = x + 3 w: the gain at infinite frequency is 3 for every controller."""
    D = [[3.0, 0.0], [0.0, 0.0]]
    plant = tuned_plant([[-1.0]], [[1, 1]], [[1], [1]], D)
    result = tune([plant], [HinfGain("w", "z")], STATIC, initial=[[-1.0]], options=TuningOptions(starts=0))
    assert result.soft == pytest.approx(3.0, rel=1e-3) and result.soft >= 3.0


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
    assert 1.0 + 0.5 * k == pytest.approx(LEAST, rel=1e-2)
    assert result.soft == pytest.approx(1.0 / (1.0 - k / (1.0 + 0.5 * k)), rel=1e-6)
