"""The nu-gap: printed values, its laws, the winding number followed along the axis, margins of closed loops."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from oracles.accurate_response import extended_response
from scipy import linalg

from lftkit import System, hinf_norm, ncfmr, nu_gap, s, transfer
from lftkit.analysis.riccati import right_coprime_factors
from lftkit.synthesis import ncfsyn
from lftkit.systems.connection.feedback import close_loop
from lftkit.systems.sampled.bilinear import to_discrete


def random(rng: np.random.Generator, states: int, sizes: tuple[int, int]) -> System:
    p, m = sizes
    A, B, C = rng.standard_normal((states, states)), rng.standard_normal((states, m)), rng.standard_normal((p, states))
    return System(A, B, C, 0.3 * rng.standard_normal((p, m)), [("u", m)], [("y", p)])


def pairs(count: int) -> list[tuple[System, System]]:
    rng = np.random.default_rng(0)
    found = []
    for k in range(count):
        sizes = int(rng.integers(1, 3)), int(rng.integers(1, 3))
        first = random(rng, int(rng.integers(1, 4)), sizes)
        near = rng.standard_normal(first.A.shape)
        A, B, C, D = first.matrices
        close = System(A + 0.3 * near, B, C, D, first.inputs, first.outputs)
        found.append((first, close if k % 2 else random(rng, int(rng.integers(1, 4)), sizes)))
    return found


def root(matrix: Any) -> Any:
    return linalg.inv(linalg.sqrtm(matrix))


def test_published_values() -> None:
    """Zhou and Doyle, Essentials of Robust Control (1998), chapter 17."""
    one, two, three = ((e).system("u", "y") for e in (100 / (2 * s + 1), 100 / (2 * s - 1), 100 / (s + 1) ** 2))
    assert nu_gap(one, two).value == pytest.approx(0.02, abs=5e-5)
    assert nu_gap(one, three).value == pytest.approx(0.8988, abs=5e-5)
    assert nu_gap(two, three).value == pytest.approx(0.8941, abs=5e-5)


@pytest.mark.further
def test_the_winding_number_is_that_along_the_axis() -> None:
    """wno det(1 + G2~ G1) + the unstable poles of G1 - those of G2, from the change of phase."""
    omega = np.tan(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 601)[1:-1])
    seen = set()
    for first, second in pairs(8):
        one, two = (g.response(np.abs(omega)) for g in (first, second))
        one, two = (np.where(omega[:, None, None] < 0.0, g.conj(), g) for g in (one, two))
        eye = np.eye(one.shape[2])
        determinant = np.linalg.det(eye + two.conj().swapaxes(1, 2) @ one)
        turns = np.diff(np.unwrap(np.angle(determinant)))
        unstable = [int(np.sum(g.poles().real > 0.0)) for g in (first, second)]
        number = -round(turns.sum() / (2.0 * np.pi)) + unstable[0] - unstable[1]
        found = nu_gap(first, second)
        chordal = max(
            linalg.norm(root(np.eye(len(b)) + b @ b.conj().T) @ (b - a) @ root(eye + a.conj().T @ a), 2)
            for a, b in zip(one[300::8], two[300::8])
        )
        if chordal < 0.99:
            assert found.same_winding == (number == 0)
            seen.add(found.same_winding)
        if found.same_winding:
            assert chordal <= found.upper * (1.0 + 1e-9)
            assert found.value == pytest.approx(chordal, rel=0.02)
        else:
            assert found.value == found.upper == 1.0
    assert seen == {True, False}


def test_it_is_a_metric() -> None:
    rng = np.random.default_rng(3)
    systems = [random(rng, 2, (1, 1)) for _ in range(4)]
    gap = {(i, j): nu_gap(a, b).value for i, a in enumerate(systems) for j, b in enumerate(systems)}
    for i in range(4):
        assert gap[i, i] < 1e-7
        for j in range(4):
            assert gap[i, j] == pytest.approx(gap[j, i], abs=1e-6)
            for k in range(4):
                assert gap[i, k] <= gap[i, j] + gap[j, k] + 1e-6


def test_constants_have_the_chordal_distance() -> None:
    one, two = transfer([2.0], [1.0]), transfer([-1.0], [1.0])
    assert nu_gap(one, two).value == pytest.approx(min(1.0, 3.0 / math.sqrt(5.0 * 2.0)))


@pytest.mark.further
def test_a_margin_is_lost_by_at_most_the_gap() -> None:
    """asin(margin of G2) >= asin(margin of G1) - asin(gap), with the same controller, and a stable loop."""
    tried = 0
    for first, second in pairs(16):
        gap, design = nu_gap(first, second), ncfsyn(first)
        margin = 1.0 / design.value
        if gap.upper >= margin:
            continue
        tried += 1
        loop = close_loop(second, design.controller, ["u"], ["y"])
        assert linalg.eigvals(loop.A).real.max() < 0.0
        best = 1.0 / ncfsyn(second).lower
        assert math.asin(min(best, 1.0)) >= math.asin(margin) - math.asin(gap.upper) - 1e-6
    assert tried >= 3


@pytest.mark.parametrize("seed", range(2))
def test_it_is_at_most_the_error_of_reduced_coprime_factors(seed: int) -> None:
    given = random(np.random.default_rng(seed), 5, (2, 2))
    for order in range(1, 5):
        found = ncfmr(given, order)
        assert nu_gap(given, found.system).value <= found.error_bound * (1.0 + 1e-6)


def test_sampled_systems_have_the_gap_of_their_images() -> None:
    for first, second in pairs(6):
        images = [System(*to_discrete(*g.matrices, 0.1), g.inputs, g.outputs, dt=0.1) for g in (first, second)]
        assert nu_gap(*images).value == pytest.approx(nu_gap(first, second).value, abs=1e-6)
    unequal = (1 / (s + 1)).system("u", "y"), System([[0.5]], [[1.0]], [[1.0]], [[0.0]], [("u", 1)], [("y", 1)], dt=0.1)
    with pytest.raises(ValueError, match="same sampling period"):
        nu_gap(*unequal)


def test_coprime_factors_are_normalised_and_give_the_system() -> None:
    for given, _ in pairs(8):
        factors = System(*right_coprime_factors(given.matrices), given.inputs, [("nm", sum(given.D.shape))])
        assert linalg.eigvals(factors.A).real.max() < 0.0
        for response, value in zip(factors.response([0.0, 0.7, 30.0]), given.response([0.0, 0.7, 30.0])):
            N, M = response[: len(value)], response[len(value) :]
            assert np.allclose(N.conj().T @ N + M.conj().T @ M, np.eye(len(M)))
            assert np.allclose(N @ linalg.inv(M), value)


def test_systems_of_other_sizes_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match=r"systems must have the same size, got \(1, 1\) and \(2, 1\)"):
        nu_gap(random(rng, 1, (1, 1)), random(rng, 1, (2, 1)))


@pytest.mark.parametrize("seed", range(8))
def test_units_of_states_inputs_and_time_do_not_matter(seed: int) -> None:
    """Far below a gain of one the gap is the norm of the difference, in whatever units the states and the time are."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((6, 6))
    A = A - (linalg.eigvals(A).real.max() + 0.3) * np.eye(6)
    B, C, none = rng.standard_normal((6, 2)), rng.standard_normal((2, 6)), np.zeros((2, 2))
    ports = [("u", 2)], [("y", 2)]
    pair = [System(1e4 * factor * A, 1e6 * B, 1e-7 * C, none, *ports) for factor in (1.0, 1.02)]
    found = nu_gap(*pair)
    assert found.value == pytest.approx(hinf_norm(pair[0] - pair[1]).value, rel=1e-3)
    slow = [System(1e-4 * system.A, 1e-2 * system.B, 1e-2 * system.C, none, *ports) for system in pair]
    assert nu_gap(*slow).value == pytest.approx(found.value, rel=1e-5)


@pytest.mark.parametrize("seed", [3, 5, 8, 12, 33, 46])
def test_plants_of_large_gain_have_the_gap_of_their_responses(seed: int) -> None:
    """Gains of 1e4 to 1e7, whose factors have slow poles beside fast ones; in both orders, the same gap."""
    rng = np.random.default_rng(seed)
    n, m, p = int(rng.integers(1, 5)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    A, B = rng.standard_normal((n, n)), rng.standard_normal((n, m))
    C = rng.standard_normal((p, n)) * 10.0 ** rng.uniform(3.0, 7.5)
    ports = [("u", m)], [("y", p)]
    one, two = (System(X, B, C, np.zeros((p, m)), *ports) for X in (A, A + 0.05 * rng.standard_normal((n, n))))
    gaps = nu_gap(one, two), nu_gap(two, one)
    for omega in (gaps[0].omega, gaps[1].omega):
        G1, G2 = (extended_response(*plant.matrices, [omega])[0] for plant in (one, two))
        graph, normal = linalg.orth(np.vstack([G1, np.eye(m)])), linalg.orth(np.vstack([np.eye(p), -G2.conj().T]))
        distance = float(np.linalg.norm(normal.conj().T @ graph, 2))
        assert all(distance <= gap.upper * (1.0 + 1e-9) for gap in gaps)
    assert max(gap.value for gap in gaps) <= min(gap.upper for gap in gaps) * (1.0 + 1e-9)
    assert all(gap.upper <= 1.5 * gap.value for gap in gaps)


def test_equal_systems_have_no_gap_but_rounding() -> None:
    """Of one in thirty the difference was rounding alone, and its norm had not settled."""
    rng = np.random.default_rng(1)
    for _ in range(100):
        system = random(rng, int(rng.integers(2, 6)), (1, 1))
        gap = nu_gap(system, system)
        assert gap.same_winding and 0.0 <= gap.value <= gap.upper < 1e-5


@pytest.mark.parametrize("seed", [10, 17, 32, 50])
def test_the_winding_number_of_large_gains_is_not_that_of_rounding(seed: int) -> None:
    """Gains of 1e8: in one of both orders the gap was stated as 1, by zeros that rounding had moved over the axis."""
    rng = np.random.default_rng(seed)
    given = [random(rng, 3, (2, 1)) for _ in range(2)]
    large = [System(g.A, g.B, 1e8 * g.C, 0.0 * g.D, g.inputs, g.outputs) for g in given]
    for first, second in (large, large[::-1]):
        gap = nu_gap(first, second)
        graphs = [np.vstack([g.response([gap.omega])[0], np.eye(1)]) for g in (first, second)]
        assert gap.value == pytest.approx(np.sin(linalg.subspace_angles(*graphs)).max(), rel=1e-6)
