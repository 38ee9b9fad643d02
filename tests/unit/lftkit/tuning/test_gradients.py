"""Exact gradients of every kind of requirement against central differences, structure by structure."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.systems.connection.filters import transfer
from lftkit.systems.ports import Port
from lftkit.systems.system import System
from lftkit.tuning.gains.gains import singular_slopes
from lftkit.tuning.gains.plant_responses import PlantResponses
from lftkit.tuning.pieces import Piece
from lftkit.tuning.problem import Problem
from lftkit.tuning.requirements import ClosedLoopPoles, ControllerPoles, H2Gain, HinfGain
from lftkit.tuning.structures.decentralised import Decentralised
from lftkit.tuning.structures.stable_state_space import StableStateSpace
from lftkit.tuning.structures.structures import Structure, gain, gain_matrix_of, pid, state_space

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


@pytest.mark.parametrize(
    ("name", "delay"),
    [
        *((name, 0.05) for name in STRUCTURES),
        *((name, 0.0) for name in ("static", "full order 2")),
        *(
            pytest.param(name, 0.0, marks=pytest.mark.slow)
            for name in STRUCTURES
            if name not in ("static", "full order 2")
        ),
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


def test_gradient_of_the_gain_at_a_fixed_frequency_equals_the_analytic_derivative() -> None:
    """T is analytic in K: u^H T v is differentiated along the imaginary direction."""
    model = random_model(2)
    plant = PlantResponses(model, ("y",), ("u",), (HinfGain("w", "z"),))
    K = gain_matrix_of(System([[-1, 0.3], [0, -2]], 0.1 * np.ones((2, 3)), np.eye(2), 0.05 * np.ones((2, 3)), Y, U))
    omega = np.array([0.7])
    arrays = plant.arrays(omega)
    values, rows, columns = singular_slopes(plant, arrays, K, 2, 0)
    gradient = np.real(np.outer(rows[0, 0], columns[0, :, 0]))
    P11, P12, P21, P22 = arrays.P11[0][0], arrays.P12[0][0], arrays.P21[0][0], arrays.P22[0]

    def response(matrix: np.ndarray) -> np.ndarray:
        Kw = matrix[2:, 2:] + matrix[2:, :2] @ np.linalg.solve(0.7j * np.eye(2) - matrix[:2, :2], matrix[:2, 2:])
        return P11 + P12 @ np.linalg.solve(np.eye(2) - Kw @ P22, Kw @ P21)

    U_, s, Vh = np.linalg.svd(response(K))
    assert values[0, 0] == pytest.approx(s[0], rel=1e-12)
    # sigma is not analytic, u^H T v is: its derivative along every entry by one complex step in each of Re and Im
    left, right = U_[:, 0].conj(), Vh[0].conj()
    for i, j in np.ndindex(K.shape):
        step = 1e-7j
        moved = K.astype(complex)
        moved[i, j] += step
        other = K.astype(complex)
        other[i, j] -= step
        slope = left @ (response(moved) - response(other)) @ right / (2.0 * step)
        assert gradient[i, j] == pytest.approx(slope.real, rel=1e-7, abs=1e-9)


def test_decentralised_and_pid_pull_gradients_back() -> None:
    parts = (pid("e", "a", derivative_filter=0.1), state_space([("f", 2)], [("b", 1)], 2))
    structure = Decentralised(parts)
    rng = np.random.default_rng(0)
    x = structure.start(rng)
    G = rng.normal(size=structure.gain_matrix(x).shape)
    expected = [
        np.sum(G * (structure.gain_matrix(x + d) - structure.gain_matrix(x - d))) / 2e-6
        for d in 1e-6 * np.eye(structure.size)
    ]
    assert structure.pullback(x, G) == pytest.approx(expected, abs=1e-7)
    K = structure.gain_matrix(x)
    assert not K[4, 5:].any() and not K[:2, 2:4].any(), "each part sees its own measurements only"
