"""Systems and their arithmetic against responses: operators, members, values, names, conversion, sampling."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import linalg
from support.normalised import normalised_value

import lftkit as lk
from lftkit import ComplexParameter, DynamicElement, InputError, Port, RealParameter, System, complex_gain, s
from lftkit.analysis.frequency_response import direct_response, frequency_response
from lftkit.proofs import robust_stability
from lftkit.systems.connection.feedback import cascade
from lftkit.systems.connection.filters import transfer
from lftkit.tuning.structures.structures import pid

K = RealParameter("k", 0.5, 0.2, 1.4)
C = ComplexParameter("c", 0.3, 0.4)
F = DynamicElement("f", 2, 1, 0.7)
VALUES = {"k": 1.1, "c": 0.3 + 0.2j, "f": np.array([[0.2 + 0.3j], [-0.4]])}
OMEGA = np.array([0.1, 0.9, 3.0])


def random_system(seed: int, outputs: int = 2, inputs: int = 2, elements: tuple = (K, C, F), dt: float = 0.0) -> System:
    rng = np.random.default_rng(seed)
    channels = tuple(e.name for e in elements for _ in range(2 if e is F else 1))
    q, n = len(channels), 3
    A = rng.standard_normal((n, n)) - 4 * np.eye(n)
    A = linalg.expm(A * dt) if dt else A
    D = 0.2 * rng.standard_normal((q + outputs, q + inputs)) + np.pad(np.eye(outputs, inputs), ((q, 0), (q, 0)))
    B, C_ = rng.standard_normal((n, q + inputs)), rng.standard_normal((q + outputs, n))
    ports = [Port(f"u{seed}", inputs, "N")], [Port(f"y{seed}", outputs, "m")]
    return System(A, B, C_, D, *ports, f"s{seed}", dt, channels, elements)


def values_of(made: System) -> dict[str, Any]:
    return {e.name: VALUES[e.name] for e in made.elements}


def agree(made: System, expected: np.ndarray) -> None:
    np.testing.assert_allclose(made.response(OMEGA, values_of(made)), expected, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("dt", [0.0, 0.2])
@pytest.mark.parametrize("elements", [(), (K,), (K, C, F)], ids=["certain", "real", "mixed"])
def test_operators_are_those_of_the_responses(elements: tuple, dt: float) -> None:
    G, H = random_system(1, elements=elements, dt=dt), random_system(2, elements=elements, dt=dt)
    g, h, eye = (x.response(OMEGA, values_of(x)) if isinstance(x, System) else x for x in (G, H, np.eye(2)))
    M = np.array([[1.0, 2.0], [0.5, -1.0]])
    agree(G + H, g + h)
    agree(G - H, g - h)
    agree(-G, -g)
    agree(G @ H, g @ h)
    agree(G * H, g @ h)
    agree(2 * G, 2 * g)
    agree(G * 2, 2 * g)
    agree(G / 4.0, g / 4)
    agree(G + 1, g + 1)
    agree(1 - G, 1 - g)
    agree(M @ G, M @ g)
    agree(G @ M, g @ M)
    agree(M + G, M + g)
    agree(G.inverse(), np.linalg.inv(g))
    agree(1 / G, np.linalg.inv(g))
    agree(G / H, g @ np.linalg.inv(h))
    agree(G**2, g @ g)
    agree(G**-1, np.linalg.inv(g))
    agree(lk.feedback(G, H), np.linalg.solve(eye + g @ h, g))
    agree(lk.feedback(G, sign=1.0), np.linalg.solve(eye - g, g))
    both = lk.append(G, H)
    assert [p.name for p in both.inputs] == ["u1", "u2"] and [p.name for p in both.outputs] == ["y1", "y2"]
    agree(both, np.array([linalg.block_diag(a, b) for a, b in zip(g, h)]))
    assert (G @ H).inputs == H.inputs and (G @ H).outputs == G.outputs and (G @ H).dt == dt


def test_a_scalar_system_multiplies_every_entry() -> None:
    g, G = lk.transfer([1.0], [1.0, 2.0]), random_system(3, 2, 3)
    one, many = g.response(OMEGA), G.response(OMEGA, values_of(G))
    agree(g * G, one * many)
    agree(G * g, one * many)
    assert (g * G).order == G.order + 2 and (G * g).order == G.order + 3


def test_members_are_those_of_the_response() -> None:
    G = random_system(4)
    dynamics = System([[-2.0]], [[0.3]], [[0.5], [-1.0]], [[0.1], [0.2]], [("in", 1)], [("out", 2)])
    member = G.at(k=0.9, c=0.45, f=dynamics)
    f = {"k": 0.9, "c": 0.45, "f": dynamics}
    np.testing.assert_allclose(member.response(OMEGA), G.response(OMEGA, f), rtol=1e-11)
    assert member.certain and member.order == G.order + 1
    static = {"k": 0.9, "c": 0.45, "f": [[0.3], [0.1]]}
    np.testing.assert_allclose(G.at(static).response(OMEGA), G.response(OMEGA, static), rtol=1e-11)
    with pytest.raises(ValueError, match=r"value of 'c' must be real \(response takes complex ones\)"):
        G.at(c=0.3 + 0.1j)
    for values, message in (
        ({"c": 1.0}, r"element 'c' must be within 0\.4 of 0\.3, got 1"),
        ({"f": [[1.0], [0.0]]}, r"element 'f' must have a gain of at most 0\.7, got 1"),
        ({"f": 0.1}, "element 'f' must be 2 x 1, got 1 x 1"),
        ({"q": 1.0}, "parameter must be one of k, c, f, got 'q'"),
    ):
        with pytest.raises(ValueError, match=message):
            G.at(values)


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_draws_are_inside_their_sets(dt: float) -> None:
    G = random_system(5, dt=dt)
    for draw in G.sample_values(np.random.default_rng(0), 20):
        assert 0.2 <= draw["k"] <= 1.4 and abs(draw["c"] - 0.3) <= 0.4
        gains = [linalg.svdvals(x)[0] for x in draw["f"].response(np.geomspace(1e-3, 1e3, 40))]
        assert max(gains) <= 0.7 * (1 + 1e-12) and max(abs(draw["f"].poles()) if dt else [0]) < 1
        G.response(OMEGA, draw)


@pytest.mark.parametrize("elements", [(K, RealParameter("d", 1.0, 0.9, 1.2)), (C, K, F)], ids=["real", "mixed"])
def test_a_substituted_element_has_its_value_and_the_others_stay(elements: tuple) -> None:
    G = random_system(4, elements=elements)
    some = G.substituted({"k": 1.1})
    assert [e.name for e in some.elements] == [e.name for e in elements if e is not K] and "k" not in some.channels
    values = {"k": 1.1, "d": 1.15, **VALUES}
    others = {e.name: values[e.name] for e in some.elements}
    np.testing.assert_allclose(some.response(OMEGA, others), G.response(OMEGA, {"k": 1.1, **others}), rtol=1e-12)
    assert G.substituted({}).elements == G.elements
    for wrong, message in (({"k": 3.0}, "must be in"), ({"other": 1.0}, "must be one of")):
        with pytest.raises(InputError, match=message):
            G.substituted(wrong)


@pytest.mark.parametrize("elements", [(K,), (K, C)])
def test_normalised_members_are_the_members(elements: tuple) -> None:
    G = random_system(6, elements=elements)
    unit = G.normalised()
    values = {"k": normalised_value(K, 1.1), "c": 0.5j}
    physical = {"k": 1.1, "c": 0.3 + 0.2j}
    names = [e.name for e in elements]
    found = unit.response(OMEGA, {n: values[n] for n in names})
    np.testing.assert_allclose(found, G.response(OMEGA, {n: physical[n] for n in names}), rtol=1e-11)


def test_tustin_keeps_the_elements_and_warps_the_frequency() -> None:
    G, dt = random_system(7), 0.1
    sampled = lk.discretise(G, dt)
    warped = 2.0 / dt * np.tan(OMEGA * dt / 2)
    values = values_of(G)
    np.testing.assert_allclose(sampled.response(OMEGA, values), G.response(warped, values), rtol=1e-10)
    with pytest.raises(ValueError, match="system must be certain"):
        lk.discretise(G, dt, method="hold")
    with pytest.raises(ValueError, match=r"must be in continuous time, got sampling period 0\.1 s"):
        lk.discretise(sampled, dt)


def test_mistakes_name_ports_and_sizes() -> None:
    G, H, Z = random_system(1), random_system(2, 3, 2), random_system(8, dt=0.1)
    for call, message in (
        (lambda: G + H, r"sum: outputs must have the same number of signals, got y1\[2\] and y2\[3\]"),
        (lambda: G @ H, r"series: outputs of the first .* got y2\[3\] and u1\[2\]"),
        (lambda: H.inverse(), r"inverse: inputs and outputs must have the same number of signals, got u2\[2\] and y2"),
        (lambda: lk.feedback(G, H), r"feedback: outputs backward and inputs forward .* got y2\[3\] and u1\[2\]"),
        (lambda: G + Z, r"must have the same sampling period, got continuous time, 0\.1 s"),
        (lambda: lk.append(G, G), "port names must be unique, got 'u1' twice"),
        (lambda: lk.transfer([1.0], [1.0, 0.0])(0), "point must not be a pole, got 0"),
        (lambda: G**0, "exponent must be an integer other than 0, got 0"),
        (lambda: G.matrices, "s1: system must be certain"),
        (lambda: System([], [], [], [[1]], [("u", 1)], [("y", 1)], ("k",)), "name must be text"),
        (lambda: System([], [], [], [[1]], [("u", 1)], [("y", 1)], dt=-1.0), "dt must be 0"),
        (lambda: System([], [], [], np.eye(2), [("u", 1)], [("y", 1)], "s", 0.0, ("f",), (F,)), "multiple of 2"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            call()
        assert "\n" not in str(caught.value)
    with pytest.raises(TypeError):
        G + "text"


def test_uncertainty_is_never_lost_in_silence() -> None:
    """Functions that work on certain continuous systems refuse the others."""
    G, Z = random_system(1), random_system(8, elements=(), dt=0.1)
    for call in (lambda s: lk.cascade(s, s), lambda s: frequency_response(s, [1.0]), lambda s: s.to_control()):
        with pytest.raises(ValueError, match="must be certain"):
            call(G)

    with pytest.raises(ValueError, match="must be in continuous time"):
        frequency_response(Z, [1.0])


def test_a_large_feedthrough_makes_no_loop_singular() -> None:
    """A controller with three zeros and fast poles has a direct gain of 1e11, which costs seven digits."""
    lead = (100 * ((lk.s + 1) / (0.001 * lk.s + 1)) ** 3).system()
    plant = (1 / lk.s**2).system()
    for made in (plant @ lead, lk.series(lead, plant, {"y": "u"})):
        assert made(1j) == pytest.approx(-100 * ((1 + 1j) / (1 + 0.001j)) ** 3, rel=1e-6)


def test_ill_posed_values_are_refused() -> None:
    k = RealParameter("k", 0.0, -1.0, 1.0)
    empty = np.zeros((0, 0))
    system = System(
        empty, empty, empty, [[1, 1], [1, 0]], (Port("u", 1),), (Port("y", 1),), channels=("k",), elements=(k,)
    )
    assert system.at({"k": 0.5}).D[0, 0] == pytest.approx(1.0)
    with pytest.raises(ValueError, match="must be well posed"):
        system.at({"k": 1.0})


def plant() -> System:
    rng = np.random.default_rng(0)
    ports_in, ports_out = [Port("w", 2, "N"), Port("u", 1, "N")], [Port("z", 1, "rad"), Port("y", 2, "m")]
    A = rng.normal(size=(4, 4)) - 3 * np.eye(4)
    return System(
        A, rng.normal(size=(4, 3)), rng.normal(size=(3, 4)), rng.normal(size=(3, 3)), ports_in, ports_out, "p"
    )


def test_channel_picks_by_name_in_the_order_asked_for() -> None:
    part = plant()["y", ("u", "w")]
    assert [p.name for p in part.inputs] == ["u", "w"]
    whole, w = plant(), 0.7
    expected = direct_response(*whole.matrices, w)[1:][:, [2, 0, 1]]
    assert direct_response(*part.matrices, w) == pytest.approx(expected)


@pytest.mark.parametrize("s", [0.0, 0.3j, 2.0j])
def test_transfer_and_series_are_products(s: complex) -> None:
    first, second = transfer([1, 2, 3], [2, 4, 8]), transfer([1, 0], [1, 5])
    value = (s**2 + 2 * s + 3) / (2 * s**2 + 4 * s + 8) * s / (s + 5)
    assert direct_response(*cascade(first, second).matrices, s.imag).item() == pytest.approx(value)


def test_pi_has_no_derivative_filter() -> None:
    for terms in ("P", "I", "PI"):
        assert np.array_equal(
            pid("e", "u", terms=terms).gain_matrix(np.ones(len(terms))),
            pid("e", "u", terms=terms, derivative_filter=0.1).gain_matrix(np.ones(len(terms))),
        )
    with pytest.raises(InputError, match="derivative_filter must be a positive time constant"):
        pid("e", "u")


def test_the_unstable_member_of_a_margin_can_be_looked_at() -> None:
    """c within 0.2 of 1 in ``1 / (s + c)``: five radii away there is a pole at zero."""
    lag = (1 / (s + complex_gain("c", 1.0, 0.2))).system("u", "y")
    margin = robust_stability(lag)
    assert margin.upper == pytest.approx(5.0)
    assert abs(lag.at(margin.point, beyond_range=True).poles()).max() < 1e-6
    assert lag.at({"c": 2.0}, beyond_range=True).poles() == [-2.0]
    beyond = lag.response([1.0], {"c": 1.0 + 1j}, beyond_range=True)
    assert beyond.ravel() == pytest.approx([1 / (1.0 + 2j)])
    with pytest.raises(ValueError, match=r"element 'c' must be within 0\.2 of 1, got 2"):
        lag.at({"c": 2.0})
    with pytest.raises(ValueError, match=r"element 'c' must be within 0\.2 of 1, got nan"):
        lag.at({"c": np.nan}, beyond_range=True)
    with pytest.raises(ValueError, match="value of 'c' must be real"):
        lag.at({"c": 1.0 + 2.0j}, beyond_range=True)
