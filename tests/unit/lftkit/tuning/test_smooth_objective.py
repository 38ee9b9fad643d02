"""The smooth objective, its metric and the pre-feedback against differences and identities."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.analysis.frequency_response import direct_response
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.system import System
from lftkit.tuning.descent.metric import metric_of
from lftkit.tuning.descent.quasi_newton import _updated, quasi_newton
from lftkit.tuning.descent.smooth_objective import PENALTY, SmoothObjective
from lftkit.tuning.gains.plant_responses import PlantResponses
from lftkit.tuning.gains.prefeedback import prefeedback
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import ClosedLoopPoles, H2Gain, HinfGain
from lftkit.tuning.structures.structures import controller, gain, state_space


def oscillator(damping: float = 0.0) -> System:
    """Undamped mass on a spring: force and disturbance at the mass, position and rate measured."""
    A, B = [[0, 1], [-4, -damping]], [[0, 0], [1, 1]]
    return System(A, B, [[1, 0], [1, 0], [0, 1]], np.zeros((3, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 2)])


def problem(delay: float = 0.0) -> tuple[Problem, np.ndarray]:
    requirements = [
        HinfGain("w", "z", name="peak"),
        H2Gain("w", "z", name="rms"),
        HinfGain("w", "z", bound=0.3, hard=True, name="bound"),
        ClosedLoopPoles(min_decay=0.05),
    ]
    structure = state_space([("y", 2)], [("u", 1)], 1)
    x = structure.parameters_of(System([[-1.0]], [[0.2, 0.1]], [[0.3]], [[-0.5, -0.4]], [("y", 2)], [("u", 1)]))
    return Problem([oscillator(), oscillator(0.1)], requirements, structure, loop_delay=delay), x


@pytest.mark.parametrize("delay", [0.0, 0.05])
@pytest.mark.parametrize("power", [5.0, 40.0])
def test_gradient_equals_central_differences(power: float, delay: float) -> None:
    p, x = problem(delay)
    objective = SmoothObjective(p, x, p.evaluate(x))
    objective.power = power
    _, gradient = objective(x)
    h = 1e-6
    differences = [(objective(x + h * e)[0] - objective(x - h * e)[0]) / (2 * h) for e in np.eye(len(x))]
    assert gradient == pytest.approx(differences, rel=1e-5, abs=1e-6 * float(np.abs(gradient).max()))


def test_power_norm_tends_to_the_largest_value() -> None:
    p, x = problem()
    objective = SmoothObjective(p, x, p.evaluate(x))
    objective.power = 5000.0
    soft, hard = objective.largest(x)
    assert objective(x)[0] == pytest.approx(soft + PENALTY * max(hard, 0.0) ** 2, rel=1e-3)


def test_unstable_point_is_infinite() -> None:
    p, x = problem()
    objective = SmoothObjective(p, x, p.evaluate(x))
    unstable = p.structure.parameters_of(System([[-1.0]], [[0.0, 0.0]], [[0.0]], [[0.0, 0.4]], [("y", 2)], [("u", 1)]))
    assert objective(unstable)[0] == np.inf and objective.largest(unstable) == (np.inf, np.inf)


def test_metric_of_a_matrix_turns_it_into_the_identity() -> None:
    G = np.random.default_rng(0).normal(size=(6, 4)) * [1.0, 1e3, 1e-3, 1.0]
    metric = metric_of(G.T @ G)
    changed = metric.T.T @ G.T @ G @ metric.T
    assert changed == pytest.approx(np.eye(4), abs=1e-9)
    assert metric.T @ metric.inverse == pytest.approx(np.eye(4), abs=1e-9)
    g = np.arange(4.0)
    assert metric.gradient(g) @ metric.coordinates(np.ones(4)) == pytest.approx(g.sum())


def test_quasi_newton_solves_a_badly_scaled_quadratic_in_its_own_metric() -> None:
    scales = np.array([1.0, 1e4, 1e8])
    result = quasi_newton(
        lambda x: (0.5 * float(x @ (scales * x)), scales * x),
        np.ones(3),
        metric_of(np.diag(scales)),
        steps=30,
        tolerance=1e-30,
    )
    assert result.value < 1e-12 and result.steps < 20


def test_prefeedback_moves_undamped_poles_and_leaves_the_closed_loop() -> None:
    plant = oscillator()
    A, B, C = plant.A, plant.B, plant.C
    F = prefeedback(A, B[:, 1:], C[1:], np.zeros((2, 1)))
    poles = np.linalg.eigvals(A + B[:, 1:] @ F @ C[1:])
    assert np.all(np.abs(poles.real) > 1e-3 * np.abs(poles))
    assert not prefeedback(oscillator(0.5).A, B[:, 1:], C[1:], np.zeros((2, 1))).any()
    K = gain([("y", 2)], [("u", 1)])
    x = np.array([-0.3, -0.7])
    responses = PlantResponses(plant, ("y",), ("u",), (HinfGain("w", "z"),))
    omega = np.array([0.0, 1.0, 2.0, 5.0])  # 2 rad/s is the open-loop pole
    own = responses.controller(K.gain_matrix(x), 0, omega)
    T = responses.closed(responses.arrays(omega), own, (0,))[0][0]
    loop = close_loop(plant, controller(K, x), ["w"], ["z"])
    expected = [direct_response(*loop.matrices, w) for w in omega]
    assert np.abs(T - np.array(expected)).max() < 1e-9


@pytest.mark.parametrize("size", [1.0, 1e-97, 1e-170])
def test_the_quasi_newton_update_maps_the_gradient_change_to_the_step_of_any_length(size: float) -> None:
    step, change = np.array([1.0, 2.0]), np.array([3.0, 1.0])
    H = _updated(np.eye(2), size * step, size * change)
    assert H is not None and H @ change == pytest.approx(step)


@pytest.mark.parametrize("scale", [1e-4, 1e3])
def test_metric_of_soft_values_does_not_depend_on_their_size_beside_hard_ones(scale: float) -> None:
    """It is one of logarithms: soft values that are far below the hard ones have the same share in it."""
    x = np.array([-0.7, 0.2])
    matrices = []
    for bound in (1.0, 1.0 / scale):
        needs = [HinfGain("w", "z", bound=bound), HinfGain("w", "effort", bound=2.0, hard=True)]
        problem = Problem([two_measurements()], needs, gain([("y", 2)], [("u", 1)]))
        objective = SmoothObjective(problem, x, problem.evaluate(x, gradients=False))
        matrices.append(objective.gauss_newton(x))
    assert matrices[1] == pytest.approx(matrices[0], rel=1e-9)


def two_measurements() -> System:
    """Two lags; disturbance and command drive both; outputs: sum of the states, command, both states."""
    C = [[1, 1], [0, 0], [1, 0], [0, 1]]
    D = [[0, 0], [0, 1], [0, 0], [0, 0]]
    inputs, outputs = [("w", 1), ("u", 1)], [("z", 1), ("effort", 1), ("y", 2)]
    return System([[-1, 0], [0, -4]], [[1, 1], [2, 1]], C, D, inputs, outputs)
