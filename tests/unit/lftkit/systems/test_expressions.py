"""Expressions of s, elements and matrices against substitution of numbers, their block sizes, and what is refused."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import linalg

import lftkit as lk
from lftkit import Port, complex_gain, dynamic, matrix, real, s

K, M, C, F = real("k", 1.0, 0.5, 2.0), real("m", 2.0, percent=(-10, 40)), complex_gain("c", 0.5, 0.4), dynamic("f")
LEAVES = {"k": K, "m": M, "c": C, "f": F, "lag": 1 / (s + 2), "mode": s / (s**2 + 0.4 * s + 3)}


@dataclass(frozen=True)
class Term:
    """An expression, its value from numbers alone, and the largest number on the way."""

    expression: Any
    value: Callable[[dict[str, Any]], tuple[complex, float]]


def leaf(name: str) -> Term:
    def value(v: dict[str, Any]) -> tuple[complex, float]:
        p = v["s"]
        x: Any = {"lag": 1 / (p + 2), "mode": p / (p * p + 0.4 * p + 3)}.get(name, v.get(name))
        return x, abs(x)

    return Term(LEAVES[name], value)


def number(x: float) -> Term:
    return Term(x, lambda _: (x, abs(x)))


def binary(a: Term, b: Term, sign: str) -> Term:
    rule: Any = {"+": lambda x, y: x + y, "-": lambda x, y: x - y, "*": lambda x, y: x * y, "/": lambda x, y: x / y}[
        sign
    ]

    def value(v: dict[str, Any]) -> tuple[complex, float]:
        (x, size_x), (y, size_y) = a.value(v), b.value(v)
        divisor = abs(y) if sign == "/" else 1.0
        result = rule(x, y) if divisor > 0 else complex("nan")
        return result, max(size_x, size_y, abs(result), 1 / max(divisor, 1e-30))

    return Term(rule(a.expression, b.expression), value)


LEAF = st.one_of(st.sampled_from(sorted(LEAVES)).map(leaf), st.floats(-3, 3).filter(lambda x: abs(x) > 0.1).map(number))


def grown(inner: st.SearchStrategy[Term]) -> st.SearchStrategy[Term]:
    plus = st.tuples(inner, inner, st.sampled_from("+-*")).map(lambda t: binary(*t))
    shifted = inner.map(lambda t: binary(number(4.0), t, "+"))  # so that few denominators vanish
    return st.one_of(plus, st.tuples(inner, shifted).map(lambda t: binary(*t, "/")))


@settings(max_examples=20)
@given(st.recursive(LEAF, grown, max_leaves=8), st.integers(0, 2**32 - 1))
def test_random_expressions_are_their_substitutions(term: Term, seed: int) -> None:
    expression = term.expression
    assume(isinstance(expression, lk.Expression))
    v = {"s": 0.3j, "k": 1.0, "m": 2.0, "c": 0.5, "f": 0.0}
    assume(term.value(v)[1] < 50)
    system = expression.system()
    rng = np.random.default_rng(seed)
    for _ in range(100):
        w, angle = 10 ** rng.uniform(-1, 1), rng.uniform(0, 2 * np.pi)
        f = rng.uniform() * np.exp(1j * angle)
        v = {"s": 1j * w, "k": rng.uniform(0.5, 2), "m": rng.uniform(1.8, 2.8), "c": 0.5 + 0.4 * f, "f": f}
        expected, size = term.value(v)
        if not size < 50:
            continue
        values = {e.name: v[e.name] for e in system.elements}
        found = system.response([w], values)[0, 0, 0]
        assert abs(found - expected) <= 1e-12 * max(1.0, size) ** 2


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.integers(1, 3))
def test_second_order_matrices_are_their_substitutions(seed: int, size: int) -> None:
    """``(M s^2 + C s + K)^-1`` with matrices of rank one in each element: one occurrence each, 2 n states."""
    rng = np.random.default_rng(seed)
    elements = [real(f"p{i}", 1.0, percent=30) for i in range(3)]
    shapes = [np.outer(b, b) for b in rng.standard_normal((3, size))]
    fixed = [np.eye(size) * 3 + G @ G.T for G in 0.3 * rng.standard_normal((3, size, size))]
    mass, damping, stiffness = (A + e * b for A, e, b in zip(fixed, elements, shapes))
    system = (mass * s**2 + damping * s + stiffness).inverse().system("force", "motion")
    assert system.order == 2 * size and system.occurrences() == {"p0": 1, "p1": 1, "p2": 1}
    for _ in range(100):
        p, w = rng.uniform(0.7, 1.3, 3), 10 ** rng.uniform(-1, 1)
        m, c, k = (A + x * b for A, x, b in zip(fixed, p, shapes))
        expected = linalg.inv(k + 1j * w * c - w * w * m)
        found = system.at({f"p{i}": x for i, x in enumerate(p)}).response([w])[0]
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * linalg.norm(expected) * 10)


def test_two_masses_on_a_spring_have_one_stiffness() -> None:
    k, m1, m2 = real("k", 1.0, 0.5, 2.0), real("m1", 1.0, percent=20), real("m2", 1.0, percent=20)
    plant = matrix([[m1 * s**2 + k, -k], [-k, m2 * s**2 + k]]).inverse()[1, 0].system("force", "position")
    assert plant.occurrences() == {"k": 1, "m1": 1, "m2": 1} and plant.order == 4
    for values in ({"k": 0.5, "m1": 0.8, "m2": 1.1}, {"k": 2.0, "m1": 1.2, "m2": 0.9}, {}):
        full = {"k": 1.0, "m1": 1.0, "m2": 1.0, **values}
        p, a, b = 0.7j, full["m1"], full["m2"]
        expected = full["k"] / (p**2 * (a * b * p**2 + full["k"] * (a + b)))
        assert plant.at(values)(p) == pytest.approx(expected, rel=1e-13)
        assert plant.at(values).poles().size == 4


@pytest.mark.parametrize(
    ("expression", "occurrences", "order"),
    [
        (1 / (M * s**2 + K), {"m": 1, "k": 1}, 2),
        (K / (s + K), {"k": 1}, 1),
        (K / (s + K) + 1 - K / (s + K), {}, 0),
        ((s + K) / (s + K), {}, 0),
        (K * K, {"k": 2}, 0),
        (K**3 + K**2 + K, {"k": 3}, 0),
        (1 / (1 + 1 / (1 + 1 / K)), {"k": 1}, 0),
        (1 / (s**2 + K * s + K), {"k": 1}, 2),
        (matrix([[K, -K], [-K, K]]), {"k": 1}, 0),
        (matrix([[K, 0], [0, K]]), {"k": 2}, 0),
        (np.array([[1.0, 2.0], [2.0, 4.0]]) * K, {"k": 1}, 0),
        (matrix(np.array([[K, -K], [-K, K]])) @ np.ones((2, 1)), {}, 0),
        ((1 / (s + 1)) * np.array([[1.0, 2.0], [2.0, 4.0]]), {}, 1),
        (s**2 * (1 / (s**2 + K)), {"k": 1}, 2),
        ((1 + 0.3 * F) / (s + 1), {"f": 1}, 1),
        (F * F + C / (C + 4), {"f": 2, "c": 1}, 0),
    ],
)
def test_blocks_are_as_small_as_they_can_be(expression: Any, occurrences: dict[str, int], order: int) -> None:
    system = expression.system()
    assert (system.occurrences(), system.order) == (occurrences, order)
    values = {e.name: {"k": 1.7, "m": 2.2, "c": 0.5 + 0.3j, "f": -0.6}[e.name] for e in expression.elements}
    kept = {e.name: values[e.name] for e in system.elements}
    np.testing.assert_allclose(
        np.squeeze(system.response([0.8], kept)), np.squeeze(expression(0.8j, values)), rtol=1e-11, atol=1e-12
    )


def test_published_structure_of_the_mass_damper_spring() -> None:
    """Zhou and Doyle, Essentials of Robust Control (1998), section 9.1: m, c and k once each, Delta of 3 x 3.

    ``x'' = (F - c x' - k x) / m`` with k within 30 %, c within 20 %, m within 10 %: M(s) of equation (9.1).
    """
    m, c, k = real("m", 2.0, percent=10), real("c", 0.4, percent=20), real("k", 3.0, percent=30)
    system = (1 / (m * s**2 + c * s + k)).system("force", "position").normalised()
    assert system.occurrences() == {"m": 1, "c": 1, "k": 1} and system.order == 2
    for corner in itertools.product((-1.0, 1.0), repeat=3):
        values = dict(zip(("m", "c", "k"), corner))
        p = 1.3j
        expected = 1 / (
            2.0 * (1 + 0.1 * values["m"]) * p**2 + 0.4 * (1 + 0.2 * values["c"]) * p + 3 * (1 + 0.3 * values["k"])
        )
        assert system.at(values)(p) == pytest.approx(expected, rel=1e-13)


def test_operands_and_text_of_an_expression() -> None:
    with pytest.raises(TypeError):
        K + "text"
    assert (K @ np.eye(1)).shape == (1, 1) and (K**0)(0) == 1 and K.T.shape == (1, 1)
    assert repr(1 / (s + K)) == "Expression(1 x 1 in s, k)"


def test_matrices_of_dynamics_keep_their_sizes() -> None:
    delta = dynamic("d", 2, 1, bound=0.3)
    W = np.array([[1.0, -0.5]])
    plant = ((1 + W @ delta) / (s + 1)).system()
    assert plant.occurrences() == {"d": 1} and plant.channels == ("d", "d")
    value = np.array([[0.1j], [0.25]])
    assert plant.response([2.0], {"d": value}).item() == pytest.approx(((1 + W @ value) / (2j + 1)).item(), rel=1e-13)
    twice = (delta @ W @ delta).system()
    assert twice.occurrences() == {"d": 2}
    np.testing.assert_allclose(twice.response([1.0], {"d": value})[0], value @ W @ value, atol=1e-15)


def test_discrete_time_and_systems_beside_expressions() -> None:
    z = lk.z(0.1)
    filtered = (K * z / (z - 0.5)).system()
    assert filtered.dt == 0.1 and filtered.at(k=2.0).response([0.0]).item() == pytest.approx(4.0)
    with pytest.raises(ValueError, match="must have the same sampling period"):
        z + s
    plant = lk.System([[-1.0]], [[1.0]], [[2.0]], [[0.0]], [Port("force", 1, "N")], [Port("speed", 1, "m/s")])
    for made, expected in (
        (K * plant, 1.5 * 2),
        (plant * K, 3.0),
        (plant + K, 3.5),
        (K - plant, -0.5),
        (plant / K, 2 / 1.5),
    ):
        assert isinstance(made, lk.System) and made.at(k=1.5)(0).real == pytest.approx(expected)
    assert (plant @ K).outputs == plant.outputs


def test_ranges_are_given_once() -> None:
    for made, ends in (
        (real("a", 10.0, percent=20), (8.0, 12.0)),
        (real("a", -10.0, percent=(-20, 50)), (-12.0, -5.0)),
        (real("a", 10.0, plus_minus=(-1, 3)), (9.0, 13.0)),
        (real("a", 10.0, plus_minus=1.5), (8.5, 11.5)),
    ):
        (element,) = made.elements
        assert isinstance(element, lk.RealParameter) and (element.lower, element.upper) == ends
    for call in (
        lambda: real("a", 1.0),
        lambda: real("a", 1.0, 0.5),
        lambda: real("a", 1.0, 0.5, 2.0, percent=3),
        lambda: real("a", 1.0, percent=3, plus_minus=2),
    ):
        with pytest.raises(ValueError, match="range of 'a' must be given once"):
            call()
