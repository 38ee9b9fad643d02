"""Exact gradients and values against central differences and norms; starts of full order; small matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.slow_cases import slow

from lftkit.analysis.batched_linalg import (
    determinants,
    largest_gains,
    leading_pairs,
    smooth_gains,
    smooth_slopes,
    solve,
)
from lftkit.analysis.frequency_response import direct_response
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.connection.filters import transfer
from lftkit.systems.ports import Port
from lftkit.systems.system import System
from lftkit.tuning.descent.exact_value import ExactValue
from lftkit.tuning.descent.smooth_objective import SmoothObjective
from lftkit.tuning.full_order import reduced_starts
from lftkit.tuning.gains.plant_responses import PlantResponses
from lftkit.tuning.gains.prefeedback import prefeedback
from lftkit.tuning.pieces import Piece
from lftkit.tuning.problem import Problem
from lftkit.tuning.published_plants import PLANTS
from lftkit.tuning.requirements import ClosedLoopPoles, ControllerPoles, H2Gain, HinfGain
from lftkit.tuning.structures.stable_state_space import StableStateSpace
from lftkit.tuning.structures.structures import Structure, controller, gain, state_space

Y, U = (Port("y", 3),), (Port("u", 2),)


def random_model(seed: int, n: int = 6) -> System:
    """Stable plant with feedthrough everywhere except on the H2 channel."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(n)
    D = np.zeros((7, 5))
    D[4:, :3] = 0.3 * rng.normal(size=(3, 3))
    D[:2, 3:] = rng.normal(size=(2, 2))
    D[4:, 3:] = 0.2 * rng.normal(size=(3, 2))
    ports_in = [("w", 2), ("n", 1), ("u", 2)]
    ports_out = [("z", 2), ("e", 2), ("y", 3)]
    return System(A, rng.normal(size=(n, 5)), rng.normal(size=(7, n)), D, ports_in, ports_out, f"m{seed}")


REQUIREMENTS = [
    HinfGain("w", "z", weight_out=transfer([1, 2], [1, 5], 2)),
    HinfGain(("n", "w"), "z", bound=2.0, weight_in=transfer([2], [1, 2], 3), hard=True, name="weighted in"),
    H2Gain("n", "e", weight_out=transfer([1], [1, 3], 2)),
    ClosedLoopPoles(min_decay=0.1, min_damping=0.3, max_frequency=30),
    ControllerPoles(min_decay=0.3, min_damping=0.2),
]


def started(structure: Structure) -> np.ndarray:
    x = 0.06 * structure.start(np.random.default_rng(3))
    n = structure.order
    if n and hasattr(structure, "base"):
        K = structure.gain_matrix(x)
        K[:n, :n] -= 0.5 * np.eye(n)
        x = structure.parameters_of(System(K[:n, :n], K[:n, n:], K[n:, :n], K[n:, n:], Y, U))
    return x


STRUCTURES = {
    "full order 2": state_space(Y, U, 2),
    "modal order 4": state_space(Y, U, 4, form="modal"),
    "tridiagonal order 3, no feedthrough": state_space(Y, U, 3, form="tridiagonal", feedthrough=False),
    "static": gain(Y, U),
    "fixed entry": gain(Y, U).with_fixed({(0, 1): 0.1}),
    "stable order 3": StableStateSpace(Y, U, 3),
}


@pytest.mark.further
@pytest.mark.parametrize(
    ("name", "delay"),
    [
        *((name, 0.05) for name in STRUCTURES if name != "fixed entry"),
        ("static", 0.0),
        ("fixed entry", 0.0),
        *(slow(name, 0.0) for name in STRUCTURES if name not in ("static", "fixed entry")),
    ],
)
def test_gradient_equals_central_differences(name: str, delay: float) -> None:
    structure = STRUCTURES[name]
    problem = Problem([random_model(0), random_model(1)], REQUIREMENTS, structure, loop_delay=delay)
    x = started(structure)
    # the largest piece of every requirement and model is a maximum over frequency: follow its value
    found = problem.evaluate(x, band=0.01)
    slopes = np.zeros((len(x), *found.values.shape))
    for i in range(len(x)):
        h = 2e-6 * max(1.0, abs(x[i]))
        ends = []
        for side in (1.0, -1.0):
            moved = x.copy()
            moved[i] += side * h
            ends.append(problem.evaluate(moved, gradients=False).values)
        with np.errstate(invalid="ignore"):  # a controller requirement has one value, beside the first model
            slopes[i] = (ends[0] - ends[1]) / (2.0 * h)
    pieces = largest(found.pieces)
    for piece in pieces:
        g = slopes[:, piece.requirement, piece.model]
        assert np.abs(g - piece.gradient).max() <= 1e-6 * max(1.0, np.abs(g).max()), (
            piece.requirement,
            piece.peak_frequency,
        )
    assert {p.requirement for p in pieces} >= ({0, 1, 2, 3, 4} if structure.order else {0, 1, 2, 3})


def largest(pieces: tuple[Piece, ...]) -> list[Piece]:
    best: dict[tuple[int, int], Piece] = {}
    for piece in pieces:
        key = (piece.requirement, piece.model)
        if key not in best or piece.value > best[key].value:
            best[key] = piece
    return list(best.values())


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
def test_smooth_gradient_equals_central_differences(power: float, delay: float) -> None:
    p, x = problem(delay)
    objective = SmoothObjective(p, x, p.evaluate(x))
    objective.power = power
    _, gradient = objective(x)
    h = 1e-6
    differences = [(objective(x + h * e)[0] - objective(x - h * e)[0]) / (2 * h) for e in np.eye(len(x))]
    assert gradient == pytest.approx(differences, rel=1e-5, abs=1e-6 * float(np.abs(gradient).max()))


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


COMMANDS, MEASURED = ("u", 2), ("y", 3)


def stable_plant(seed: int, through: float = 0.0) -> System:
    """Stable plant of five states; `through` scales the direct path from the command to the measurement."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((5, 5))
    A -= (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(5)
    D = 0.1 * rng.standard_normal((5, 4))
    D[2:, 2:] *= through
    return System(
        A,
        rng.standard_normal((5, 4)),
        rng.standard_normal((5, 5)),
        D,
        [("w", 2), COMMANDS],
        [("z", 2), MEASURED],
        f"plant {seed}",
    )


def complex_stack(*shape: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


@pytest.mark.parametrize("through", [0.0, 1.0])
def test_value_is_the_largest_norm_and_the_gradient_its_derivative(through: float) -> None:
    needs = [HinfGain("w", "z", weight_out=transfer([1, 2], [1, 5], 2)), HinfGain("w", "y", bound=2.0)]
    structure = state_space([MEASURED], [COMMANDS], 1)
    problem = Problem([stable_plant(0, through), stable_plant(1, through)], needs, structure)
    x = 0.05 * np.random.default_rng(2).standard_normal(structure.size)
    x[0] = -1.0
    assert ExactValue.suits(problem) and problem.abscissa(x) < 0.0
    value, gradient = ExactValue(problem)(x)
    assert not np.isfinite(ExactValue(problem)(x * [-1.0, *np.ones(len(x) - 1)])[0]), "unstable"
    assert np.exp(value) == pytest.approx(problem.evaluate(x, gradients=False).values.max(), rel=1e-6)
    f = ExactValue(problem)
    differences = [(f(x + h)[0] - f(x - h)[0]) / 2e-6 for h in 1e-6 * np.eye(len(x))]
    assert gradient == pytest.approx(np.array(differences), abs=1e-6 * float(np.linalg.norm(gradient)) + 1e-8)


@pytest.mark.parametrize("form", ["full", "modal", "tridiagonal"])
def test_full_order_controllers_stabilise_and_one_is_nearly_optimal(form: str) -> None:
    """With as many states as the plant nothing is reduced: the H-infinity one is near the optimum of AC4, 0.557291."""
    model = PLANTS["AC4"]()
    problem = Problem(
        [model], [HinfGain("w", "z")], state_space([model.outputs[1]], [model.inputs[1]], model.order, form=form)
    )
    found = reduced_starts(problem)
    assert found and all(problem.abscissa(x) < 0.0 for x in found)
    values = [problem.evaluate(x, gradients=False).values.max() for x in found]
    assert 0.557291 * (1 - 1e-6) <= min(values) <= 1.3 * 0.557291


def test_the_lqg_start_has_the_least_h2_norm() -> None:
    model = stable_plant(0)
    D = model.D.copy()
    D[:2, :2] = 0.0
    model = replace(model, D=D)
    structure = state_space([MEASURED], [COMMANDS], model.order, feedthrough=False)
    problem = Problem([model], [H2Gain("w", "z")], structure)
    lqg = reduced_starts(problem)[0]
    best = problem.evaluate(lqg, gradients=False).values.max()
    rng = np.random.default_rng(0)
    for _ in range(20):
        other = lqg * (1.0 + 0.1 * rng.standard_normal(len(lqg)))
        assert problem.evaluate(other, gradients=False).values.max() >= best * (1.0 - 1e-5)


def test_solutions_determinants_and_vectors_of_two_by_two_matrices() -> None:
    M, X, T = complex_stack(9, 2, 2), complex_stack(9, 2, 5), complex_stack(9, 2, 4)
    T[0, 1] = 0.0
    T[1] = 0.0
    T[2] = np.eye(2, 4)
    assert solve(M, X) == pytest.approx(np.linalg.solve(M, X), rel=1e-10)
    assert determinants(M) == pytest.approx(np.linalg.det(M), rel=1e-12)
    for wide in (T, T.conj().swapaxes(1, 2)):
        s, left, right = leading_pairs(wide)
        assert s == pytest.approx(np.linalg.svd(wide, compute_uv=False), rel=1e-12, abs=1e-7)
        assert wide @ right == pytest.approx(left * s[:, None, :], abs=1e-7)


@pytest.mark.parametrize("shape", [(3, 5), (6, 4)])
@pytest.mark.parametrize("power", [2.0, 40.0, 600.0])
def test_smooth_gains_bound_the_largest_and_have_the_stated_slopes(shape: tuple[int, int], power: float) -> None:
    T, step = complex_stack(4, *shape), complex_stack(4, *shape)[::-1]
    gains = smooth_gains(T, power)
    assert np.all(gains >= largest_gains(T) * (1 - 1e-12))
    assert np.all(gains <= largest_gains(T) * min(shape) ** (1.0 / power) * (1 + 1e-12))
    slope = (smooth_gains(T + 1e-6 * step, power) - smooth_gains(T - 1e-6 * step, power)) / 2e-6
    assert np.real(np.sum(smooth_slopes(T, power).conj() * step, axis=(1, 2))) == pytest.approx(slope, rel=1e-6)
