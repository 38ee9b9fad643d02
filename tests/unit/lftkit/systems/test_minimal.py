"""Minimal realisation: removes exactly what is too much, changes no response."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import Port, System, as_system, connect, real, s, state_space, static_gain, z
from lftkit.systems.minimal import SETTINGS, _is_same, minimal_realisation

POINT = {"k": 1.1, "m": 0.3}


def padded(system: System, rng: np.random.Generator, states: int, copies: int) -> System:
    """The same family with more states and occurrences, well mixed by similarity transformations."""
    n, q = system.order, len(system.channels)
    k_columns = [i for i, c in enumerate(system.channels) if c == "k"]
    A = np.block([[system.A, np.zeros((n, states))], [rng.standard_normal((states, n + states))]])
    B = np.vstack([system.B, rng.standard_normal((states, system.B.shape[1]))])  # reached, never seen
    C = np.hstack([system.C, np.zeros((system.C.shape[0], states))])
    T = rng.standard_normal((n + states, n + states)) + 3.0 * np.eye(n + states)
    A, B, C = T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T)
    # further channels of k that see everything but act on nothing
    B = np.hstack([B[:, :q], np.zeros((n + states, copies)), B[:, q:]])
    extra = rng.standard_normal((copies, n + states))
    C = np.vstack([C[:q], extra, C[q:]])
    D = np.insert(system.D, [q] * copies, 0.0, axis=1)
    D = np.insert(D, [q] * copies, rng.standard_normal((copies, D.shape[1])), axis=0)
    D[q : q + copies, q : q + copies] *= 0.1
    channels = (*system.channels, *(["k"] * copies))
    k = np.array([*k_columns, *range(q, q + copies)])
    M = rng.standard_normal((k.size, k.size)) + 3.0 * np.eye(k.size)
    B[:, k], D[:, k] = B[:, k] @ M, D[:, k] @ M
    C[k], D[k] = np.linalg.solve(M, C[k]), np.linalg.solve(M, D[k])
    return System(A, B, C, D, system.inputs, system.outputs, channels=channels, elements=system.parameters)


@pytest.mark.parametrize("seed", range(3))
def test_planted_redundancy_is_found_and_the_response_stays(make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    small = make(rng, 4)
    large = padded(small, rng, states=3, copies=2)
    result = minimal_realisation(large)
    assert (result.removed_states, result.removed_occurrences) == (3, {"k": 2, "m": 0})
    assert result.system.order == 4
    for values in ({}, POINT, {"k": 0.2, "m": 1.4}):
        np.testing.assert_allclose(result.system.at(values)(0.7j), small.at(values)(0.7j), rtol=1e-7, atol=1e-9)


def test_a_minimal_system_keeps_its_coordinates(make) -> None:
    system = make(np.random.default_rng(1)).sorted_channels()
    result = minimal_realisation(system)
    np.testing.assert_array_equal(result.system.A, system.A)
    assert str(result) == "removed 0 states"


def controllers(rng):
    """PID controllers with everyday gains in series with plants: integrators, derivatives, elements."""
    choose = lambda *values: float(rng.choice(values))  # noqa: E731
    kp, ki, kd, lag = choose(1, 2, 3, 10), choose(0.5, 1, 2, 0.38), choose(0.38, 1, 2.3), choose(0.1, 0.01, 0.001)
    pid = kp + ki / s + kd * s / (lag * s + 1)
    k, m = real("k", 2.0, percent=20), real("m", 2.0, percent=10)
    a = [choose(0.1, 0.5, 1, 2.3, 10) for _ in range(3)]
    for plant in (s * (s + 1) ** 3, s**2 + a[0] * s + k, m * s**2, (a[0] * s + 1) * (a[1] * s + 1) * (a[2] * s + 1)):
        yield from (k * pid / plant, pid / plant, 1 / (1 + k * pid / plant), k * (1 + 1 / s) ** 2 / plant)


@pytest.mark.parametrize("seed", range(3))
def test_a_controller_in_series_with_a_plant_loses_no_state(seed):
    """Rounding of 1e-30 in the matrices made balancing scale true couplings away: the integrator was gone."""
    for expression in controllers(np.random.default_rng(seed)):
        system = expression.system()
        for point in (0.3 + 1.1j, 0.01 + 0.1j, 1e-3j):
            assert system(point) == pytest.approx(expression(point), rel=1e-7)


def test_rounding_in_a_column_does_not_make_a_state_unreachable():
    A = [[-3.6e-30, 34.3, -97.0], [0.0, -1.0, 0.0], [-3.7e-30, 34.3, -100.0]]
    given = state_space(A, [[0.0], [1.0], [0.0]], [[2.0, 103.0, -293.0]], [[0.0]], [Port("u", 1)], [Port("y", 1)])
    assert minimal_realisation(given).system(2.0) == pytest.approx(given(2.0), rel=1e-12)


def test_the_order_of_factors_of_a_lead_and_a_notch_does_not_matter():
    q = real("q", 2.0, 1.0, 3.0)
    for one, other in (
        ((1 + s / q) / (1 + 0.1 * s), (1 + (1 / q) * s) / (1 + 0.1 * s)),
        (s * q / (s + 1), q * s / (s + 1)),
        ((s**2 + 0.1 * s * q + q**2) / (s**2 + s * q + q**2), (s**2 + 0.1 * q * s + q**2) / (s**2 + q * s + q**2)),
    ):
        systems = one.system(), other.system()
        assert systems[0].occurrences() == systems[1].occurrences() and systems[0].order == systems[1].order
        assert systems[0].at(q=1.3)(2j) == pytest.approx(other(2j, q=1.3), rel=1e-10)


def textbook_fractions():
    """Of which s occurs more often than there are states, with their orders."""
    J1, J2, c, k = (
        real("J1", 10.0, percent=5),
        real("J2", 2.0, percent=10),
        real("c", 0.4, 0.2, 0.8),
        real("k", 200, percent=30),
    )
    D1, D2, q = J1 * s**2 + c * s + k, J2 * s**2 + c * s + k, c * s + k
    wide = (s - 5e-4) * (s + 1e-4) * (s + 0.01) * (s + 0.2) * (s + 1) * (s + 100) ** 2
    ahead = z(0.1)
    return [
        (D2 / (D1 * D2 - q**2), 4),
        (q / (D1 * D2 - q**2), 4),
        ((s + k) ** 2 / (s + c) ** 2, 2),
        ((1 + k * s) / (1 + c * s) - 1 / (s + k) + k / (s + c) ** 2, 4),
        (2.0 * (s + 0.02) * (s + 0.05) * (s + 5) * (s + 10) / wide, 7),
        (-((ahead + k) ** 2) / (ahead**2 + c * ahead + 0.5), 2),
    ]


@pytest.mark.parametrize("number", range(6))
def test_a_proper_fraction_has_a_system(number):
    fraction, order = textbook_fractions()[number]
    made, rng = fraction.system(), np.random.default_rng(number)
    assert made.order == order
    for _ in range(5):
        values = {e.name: rng.uniform(e.lower, e.upper) for e in fraction.elements}
        point = 3.0 * complex(*rng.normal(size=2))
        assert made.at(values)(point) == pytest.approx(fraction(point, values), rel=1e-7)


def test_what_is_left_of_terms_that_cancel_is_no_pole():
    """0.1 + 0.2 - 0.3 is 5e-17."""
    k = real("k", 2.0, 1.0, 3.0)
    none = 0.1 * s + 0.2 * s - 0.3 * s
    assert ((s + k) ** 2 / (none * s**2 + (s + 1) ** 2)).system().order == 2
    assert ((none * s + s + 3) ** 2 / (s + 1) ** 2).system().order == 2


@pytest.mark.parametrize("seed", range(3))
def test_an_output_that_is_zero_by_cancellation_keeps_no_state(seed):
    """What is computed for it is rounding, before and after."""
    rng = np.random.default_rng(seed)
    w, zeta = rng.uniform(0.5, 20.0), 10.0 ** rng.uniform(-3, -1)
    A, B, C = np.array([[0.0, 1.0], [-w * w, -2 * zeta * w]]), np.array([[0.0], [1.0]]), rng.normal(size=(1, 2))
    A, B, C = np.kron(np.eye(2), A), np.vstack([B, B]), np.block([[C, np.zeros((1, 2))], [C, -C]])
    T = rng.normal(size=(4, 4)) + 3.0 * np.eye(4)
    turned = T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T)
    given = state_space(*turned, np.zeros((2, 1)), [Port("u", 1)], [Port("y", 2)])
    assert minimal_realisation(given).removed_states == 2


def test_integrating_an_acceleration_twice_over_is_found() -> None:
    """A body whose rate is integrated in two places: the trap of building spacecraft block by block."""
    f, a, v = Port("f", 1, "N"), Port("a", 1, "m/s2"), Port("v", 1, "m/s")
    mass = static_gain([[0.5]], [f], [a])
    integrator = state_space([[0.0]], [[1.0]], [[1.0]], [[0.0]], [a], [v])
    both = connect(
        {"mass": mass, "one": integrator, "two": integrator},
        [("f", "mass.f"), ("mass.a", "one.a"), ("mass.a", "two.a")],
        inputs=[f],
        outputs={"v": "one.v", "v2": "two.v"},
    )
    result = minimal_realisation(both)
    assert result.removed_states == 1
    assert abs(result.system.nominal()(2.0j)[0, 0] - 0.5 / 2.0j) < 1e-14


def test_a_badly_scaled_oscillator_keeps_its_states():
    given = state_space(
        [[0.0, 1e15], [-1e-15, -1e-3]], [[0.0], [1e-15]], [[1.0, 0.0]], [[0.0]], [Port("u", 1)], [Port("y", 1)]
    )
    assert minimal_realisation(given).removed_states == 0


def test_a_realisation_is_compared_at_its_fast_poles_too() -> None:
    """A fast pole without which the slow response is the same."""
    fast, slow = 1e-3 * s / (s + 1e3), 1.0 / (s + 1.0)
    full, reduced = (as_system(slow + term) for term in (fast, 0.0 * s))
    assert _is_same(full, full, SETTINGS) and not _is_same(minimal_realisation(reduced).system, full, SETTINGS)
