"""Bounds of reduced systems hold, are reached where theory says so, and do not depend on units of the states."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy import linalg

from lftkit import Port, System, balred, hankel_singular_values, hinf_norm, ncfmr, s, transfer, z
from lftkit.analysis.margins import disk_margin
from lftkit.reduction.balancing import balanced_truncation, gramian_factor, state_parts
from lftkit.synthesis import ncfsyn
from lftkit.systems.connection.feedback import close_loop


def random(seed: int, dt: float = 0.0, states: int = 7, edge: float = 0.9) -> System:
    """A random system; `edge` is the size of its largest pole in discrete time, or its least decay less 1."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((states, states))
    poles = linalg.eigvals(A)
    A = A * edge / np.abs(poles).max() if dt else A - (poles.real.max() + 1.0 - edge) * np.eye(states)
    B, C, D = rng.standard_normal((states, 2)), rng.standard_normal((3, states)), rng.standard_normal((3, 2))
    return System(A, B, C, D, [("u", 2)], [("y", 3)], "random", dt)


def norm(system: System) -> float:
    return hinf_norm(*system.matrices, dt=system.dt or None).value


def scaled(system: System, seed: int) -> System:
    """The same system with states in units from 1e-6 to 1e6."""
    units = 10.0 ** np.random.default_rng(seed).uniform(-6.0, 6.0, system.order)
    A, B, C, D = system.matrices
    matrices = A * units[:, None] / units, B * units[:, None], C / units, D
    return System(*matrices, system.inputs, system.outputs, system.name, system.dt)


def lag(pole: float, size: int, dt: float) -> System:
    """A lag on each of some channels."""
    eye = np.eye(size)
    return System(pole * eye, eye, 0.3 * eye, 0.01 * eye, [("i", size)], [("o", size)], "lag", dt)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("method", ["truncate", "matchdc"])
@pytest.mark.parametrize("order", range(8))
def test_the_error_is_within_its_bound(dt: float, method: str, order: int) -> None:
    given = random(order, dt)
    found = balred(given, order, method=method)
    assert found.system.order == order
    assert norm(given - found.system) <= found.error_bound * (1.0 + 1e-6) + 1e-12
    assert found.error_bound <= found.tail_bound * (1.0 + 1e-6)
    assert found.tail_bound == pytest.approx(2.0 * found.hankel_values[order:].sum())
    if method == "matchdc":
        still = 1.0 if dt else 0.0
        assert np.allclose(found.system(still), given(still), rtol=1e-8)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_units_of_states_do_not_matter(dt: float) -> None:
    given = random(3, dt)
    other = scaled(given, 5)
    assert hankel_singular_values(other) == pytest.approx(hankel_singular_values(given), rel=1e-8)
    first, second = balred(given, 4), balred(other, 4)
    assert second.error_bound == pytest.approx(first.error_bound, rel=1e-6)
    assert norm(first.system - second.system) <= 1e-8 * norm(given)


def test_small_hankel_values_keep_their_digits() -> None:
    """Of a system with the Gramians 1 / (i + j): 1e-10 of the largest one, 1e-8 would be lost from the Gramian."""
    n = 8
    given = System(-np.diag(np.arange(1.0, n + 1)), np.ones((n, 1)), np.ones((1, n)), [[0.0]], [("u", 1)], [("y", 1)])
    with mpmath.workdps(50):
        gramian = mpmath.matrix(n, n)
        for i in range(n):
            for j in range(n):
                gramian[i, j] = mpmath.mpf(1) / (i + j + 2)
        exact = sorted((float(value) for value in mpmath.eigsy(gramian, eigvals_only=True)), reverse=True)
    found = hankel_singular_values(given)
    assert exact[-1] < 1e-9 * exact[0]
    assert found == pytest.approx(exact, rel=1e-4)


def test_the_bound_is_reached_by_a_symmetric_system() -> None:
    """A = A', B = C': the error at zero frequency is twice the sum of what is left out."""
    rng = np.random.default_rng(2)
    M, b = rng.standard_normal((6, 6)), rng.standard_normal((6, 1))
    given = System(-(M @ M.T + 0.1 * np.eye(6)), b, b.T, [[0.0]], [("u", 1)], [("y", 1)])
    for order in range(5):
        found = balred(given, order)
        assert found.error_bound == pytest.approx(found.tail_bound, rel=1e-6)
        assert abs(given(0.0) - found.system(0.0)) == pytest.approx(found.tail_bound, rel=1e-6)


def test_an_all_pass_has_equal_values() -> None:
    """Nothing can be left out for less than the norm itself; every value is 1."""
    one = ((1 - s) / (1 + s) * (s**2 - s + 4) / (s**2 + s + 4)).system("u", "y")
    assert hankel_singular_values(one) == pytest.approx(np.ones(3), rel=1e-10)
    for order in range(3):
        found = balred(one, order)
        assert 1.0 - 1e-9 <= norm(one - found.system) <= found.error_bound * (1.0 + 1e-7) <= 6.0 + 1e-6


def test_repeated_values_are_kept_or_left_out_by_number() -> None:
    eye = np.eye(3)
    three = System(-eye, eye, eye, 0.0 * eye, [("u", 3)], [("y", 3)])
    found = balred(three, 2)
    assert found.system.order == 2
    assert found.hankel_values == pytest.approx([0.5] * 3)
    assert found.error_bound == pytest.approx(1.0)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_poles_that_are_not_stable_stay(dt: float) -> None:
    given = random(4, dt, edge=1.2)
    parts = state_parts(*given.matrices[:3], dt)
    other = parts.other[0]
    assert 0 < len(other) < 7
    found = balred(given, len(other) + 2)
    kept = found.system.poles()
    for pole in linalg.eigvals(other):
        assert np.abs(kept - pole).min() < 1e-9
    points = np.exp(1j * np.linspace(0.0, np.pi, 200)) if dt else 1j * np.geomspace(1e-2, 1e2, 200)
    gains = [linalg.norm(given(point) - found.system(point), 2) for point in points]
    assert 0.9 * found.error_bound < max(gains) <= found.error_bound * (1.0 + 1e-9)
    assert np.isinf(hankel_singular_values(given)[: len(other)]).all()
    with pytest.raises(ValueError, match=f"order must be at least {len(other)}"):
        balred(given, len(other) - 1)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("sides", ["in", "out", "both"])
def test_the_weighted_error_is_the_norm_of_the_weighted_difference(dt: float, sides: str) -> None:
    given = random(6, dt)
    at = 1.0 if dt else 0.0
    rows = {"weight_in": 2, "weight_out": 3}
    chosen = {"in": ["weight_in"], "out": ["weight_out"], "both": list(rows)}[sides]
    weights = {name: lag(at - 0.3, rows[name], dt) for name in chosen}
    found = balred(given, 4, **weights)
    error = given - found.system
    error = error @ weights["weight_in"] if "weight_in" in weights else error
    error = weights["weight_out"] @ error if "weight_out" in weights else error
    assert found.error_bound == pytest.approx(norm(error), rel=1e-6)
    assert np.isinf(found.tail_bound)
    assert not len(state_parts(*found.system.matrices[:3], dt).other[0])


def test_a_weight_makes_the_error_small_where_it_is_large() -> None:
    """Two resonances: the weight decides which one is kept."""
    slow, fast = 1 / (s**2 + 0.02 * s + 1), 2500 / (s**2 + s + 2500)
    given = (slow + 0.1 * fast).system("u", "y")
    weight = ((s / (s + 20)) ** 4).system("y", "z")
    assert np.abs(balred(given, 2).system.poles()) == pytest.approx([1.0, 1.0], rel=0.1)
    found = balred(given, 2, weight_out=weight)
    assert np.abs(found.system.poles()) == pytest.approx([50.0, 50.0], rel=0.1)
    assert found.error_bound < norm(weight @ (given - balred(given, 2).system))


def test_the_least_order_for_an_error() -> None:
    given = random(9)
    values = hankel_singular_values(given)
    for order in range(8):
        wanted = 2.0 * values[order:].sum()
        found = balred(given, error=wanted * (1.0 + 1e-9) + 1e-12)
        assert found.system.order == order and found.tail_bound <= wanted * (1.0 + 1e-9) + 1e-12


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(2))
def test_coprime_factors_of_the_reduced_system_are_within_the_bound(dt: float, seed: int) -> None:
    """A controller with a larger margin stabilises the reduced system, with a margin that is less by the error."""
    given = random(seed, dt, states=5, edge=1.2)
    design = ncfsyn(given)
    margin = 1.0 / design.value
    for order in range(5):
        found = ncfmr(given, order)
        assert found.error_bound <= found.tail_bound * (1.0 + 1e-6)
        if found.error_bound < margin:
            other = ncfsyn(found.system)
            closed = close_loop(found.system.renamed({}), design.controller, ["u"], ["y"])
            assert not len(state_parts(*closed.matrices[:3], dt).other[0])
            assert abs(np.arcsin(1.0 / other.lower) - np.arcsin(1.0 / design.lower)) <= np.arcsin(found.error_bound)


def test_coprime_factors_reduce_what_is_unstable() -> None:
    given = (1 / ((s - 1) * (0.01 * s + 1))).system("u", "y")
    found = ncfmr(given, 1)
    assert found.system.poles().real == pytest.approx([1.0], abs=0.1)
    assert disk_margin(found.system @ transfer([4.0], [1.0])).size > 0.5
    same = ncfmr(given, 2)
    assert same.system is given and same.error_bound == 0.0


def test_sampled_factors_are_those_of_the_bilinear_image() -> None:
    q = z(0.1)
    given = (0.1 * (q + 0.5) / ((q - 1.2) * (q - 0.1))).system("u", "y")
    assert ncfmr(given, 1).system.poles().real == pytest.approx([1.2], abs=0.1)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_factors_solve_the_lyapunov_equation(dt: float) -> None:
    given = random(11, dt)
    A, B = given.A, given.B[:, :1]
    L = gramian_factor(A, B, dt)
    P = L @ L.T
    rest = A @ P @ A.T - P + B @ B.T if dt else A @ P + P @ A.T + B @ B.T
    assert L.shape == A.shape and np.abs(rest).max() < 1e-11 * np.abs(P).max()
    assert not gramian_factor(A, 0.0 * B, dt).any()


def test_what_is_asked_for_must_make_sense() -> None:
    given = random(0)
    for arguments, message in (
        ({}, "one of order and error must be given, got None and None"),
        ({"order": 2, "error": 0.1}, "one of order and error must be given"),
        ({"order": 1.5}, "order must be an integer, got 1.5"),
        ({"order": -1}, "order must be at least 0"),
        ({"error": -0.1}, "error must be at least 0, got -0.1"),
        ({"order": 1, "method": "best"}, "method must be one of truncate, matchdc, got 'best'"),
        ({"error": 0.1, "weight_in": lag(-1.0, 2, 0.0)}, "order must be given where there are weights"),
        ({"order": 1, "weight_in": transfer([1.0], [1.0, 1.0])}, "weight_in must have 2 outputs, got 1"),
        ({"order": 1, "weight_out": transfer([1.0], [1.0, 1.0])}, "weight_out must have 3 inputs, got 1"),
    ):
        with pytest.raises(ValueError, match=message):
            balred(given, **arguments)  # type: ignore[arg-type]
    unstable = transfer([1.0], [1.0, -1.0])
    with pytest.raises(ValueError, match="weight_in must be stable, got poles"):
        balred(transfer([1.0], [1.0, 1.0]), 0, weight_in=unstable)
    with pytest.raises(ValueError, match="order must be at least 0, got -1"):
        ncfmr(given, -1)
    blind = System([[1.0]], [[1.0]], [[0.0]], [[0.0]], [Port("u", 1)], [Port("y", 1)], "blind")
    with pytest.raises(ValueError, match="blind: the system must be stabilisable and detectable"):
        ncfmr(blind, 0)


@pytest.mark.parametrize("seed", range(4))
def test_weights_of_slow_systems_in_large_units(seed: int) -> None:
    """Poles of 1e-6 rad/s beside inputs of 1e6: the chain with a weight has entries of 1e6 beside its poles."""
    rng = np.random.default_rng(seed)

    def slow(n: int, inputs: int, outputs: int, unit: float, names: tuple[str, str]) -> System:
        A = rng.standard_normal((n, n))
        A = 1e-6 * (A - (linalg.eigvals(A).real.max() + 0.3) * np.eye(n))
        B, C = unit * rng.standard_normal((n, inputs)), rng.standard_normal((outputs, n)) / unit
        return System(A, B, C, np.zeros((outputs, inputs)), [(names[0], inputs)], [(names[1], outputs)])

    given, before = slow(3, 2, 2, 1e6, ("u", "y")), slow(2, 2, 2, 1.0, ("v", "u"))
    found = balred(given, 2, weight_in=before)
    omega = np.geomspace(1e-9, 1e-3, 200)
    error = (given.response(omega) - found.system.response(omega)) @ before.response(omega)
    assert np.linalg.norm(error, 2, axis=(1, 2)).max() <= found.error_bound * (1.0 + 1e-6)


@pytest.mark.parametrize("order", range(8))
def test_a_truncation_of_all_states_is_within_twice_the_sum_of_what_is_left_out(order: int) -> None:
    given = random(order)
    P = linalg.solve_continuous_lyapunov(given.A, -given.B @ given.B.T)
    Q = linalg.solve_continuous_lyapunov(given.A.T, -given.C.T @ given.C)
    hankel = np.sort(np.sqrt(np.abs(linalg.eigvals(P @ Q))))[::-1]
    found = balanced_truncation(given, order)
    assert found.order == order and np.array_equal(found.D, given.D)
    assert not order or linalg.eigvals(found.A).real.max() < 0.0
    assert norm(given - found) <= 2.0 * hankel[order:].sum() + 1e-9 * hankel[0]


def test_what_cannot_be_truncated_is_refused() -> None:
    A, B, C, D = random(0).matrices
    for matrices, order, message in (
        ((A, B, C, D), 8, "order must be between 0 and 7, got 8"),
        ((np.eye(7), B, C, D), 2, "must be stable with 2 states"),
        ((A, B, 0.0 * C, D), 1, "reached and seen"),
    ):
        with pytest.raises(ValueError, match=message):
            balanced_truncation(System(*matrices, [("u", 2)], [("y", 3)]), order)
