"""Controllers of more gain, and where descents from them lead."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.systems.system import System
from lftkit.tuning.descent.gain_moves import FURTHER, GAINS, descended, gain_moves, with_gain
from lftkit.tuning.descent.grid_source import point_at
from lftkit.tuning.problem import Problem
from lftkit.tuning.published_plants import PLANTS
from lftkit.tuning.requirements import HinfGain
from lftkit.tuning.structures.stable_state_space import StableStateSpace
from lftkit.tuning.structures.structures import Structure, controller, gain, pid, state_space

W = np.array([0.0, 0.3, 2.0, 50.0])


def response(model: System) -> np.ndarray:
    A, B, C, D = model.matrices
    return np.array([C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B) + D for w in W])


@pytest.mark.parametrize(
    "structure",
    [
        gain([("y", 2)], [("u", 1)]),
        state_space([("y", 2)], [("u", 1)], 2),
        state_space([("y", 2)], [("u", 1)], 2, form="tridiagonal"),
        StableStateSpace([("y", 2)], [("u", 1)], 2),
    ],
)
@pytest.mark.parametrize("factor", [10.0, 0.3, 0.0])
def test_the_controller_is_multiplied(structure: Structure, factor: float) -> None:
    x = structure.start(np.random.default_rng(3))
    more = with_gain(structure, x, factor)
    assert more is not None
    expected = factor * response(controller(structure, x))
    np.testing.assert_allclose(response(controller(structure, more)), expected, rtol=1e-9, atol=1e-12)


def test_structures_with_fixed_entries_have_no_such_controller() -> None:
    fixed = gain([("y", 2)], [("u", 1)]).with_fixed({(0, 0): -1.0})
    assert with_gain(fixed, np.array([0.5]), 3.0) is None
    x = np.ones(pid("y", "u", derivative_filter=0.1).size)
    found = with_gain(pid("y", "u", derivative_filter=0.1), x, 2.0)
    assert found is None or np.isfinite(found).all()


def test_moves_are_stable_and_go_farther_along_the_last_displacement() -> None:
    """1 / (s + 1) with u = k y is stable for k < 1."""
    plant = System([[-1]], [[1, 1]], [[1], [1]], np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)])
    problem = Problem([plant], [HinfGain("w", "z")], gain([("y", 1)], [("u", 1)]))
    found = [float(x[0]) for x in gain_moves(problem, np.array([-2.0]), np.array([-1.5]))]
    assert found == pytest.approx([*(-2.0 * factor for factor in GAINS), *(-2.0 - 0.5 * t for t in FURTHER)])
    assert gain_moves(problem, np.array([0.5])) == [], "5 and 1.5 are unstable"


def test_a_descent_from_more_gain_is_lower_where_the_infimum_is_at_infinite_gains() -> None:
    plant = PLANTS["HE2"]()
    problem = Problem([plant], [HinfGain("w", "z")], gain([("y", 2)], [("u", 2)]))
    x = np.array([413.6, -697.6, 264.7, -446.4])
    here = point_at(problem, x)
    ends = [descended(problem, more, 80, np.inf, -np.inf)[0] for more in gain_moves(problem, x)]
    assert len(ends) == len(GAINS)
    assert min(end.soft for end in ends) < here.soft * (1.0 - 1e-3)
    assert max(end.soft for end in ends) < here.soft
