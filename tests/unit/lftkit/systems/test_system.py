"""The uncertain system and models with named ports: values, names, conversion, sampling."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import InputError, Port, RealParameter, System, complex_gain, s
from lftkit.analysis.frequency_response import direct_response
from lftkit.proofs import robust_stability
from lftkit.systems.connection.feedback import cascade
from lftkit.systems.connection.filters import transfer
from lftkit.tuning.structures.structures import pid


def test_ill_posed_values_are_refused() -> None:
    k = RealParameter("k", 0.0, -1.0, 1.0)
    empty = np.zeros((0, 0))
    system = System(
        empty, empty, empty, [[1, 1], [1, 0]], (Port("u", 1),), (Port("y", 1),), channels=("k",), elements=(k,)
    )
    assert system.at({"k": 0.5}).D[0, 0] == pytest.approx(1.0)
    with pytest.raises(ValueError, match="must be well posed"):
        system.at({"k": 1.0})


def test_sub_system_by_names_and_sampling(make) -> None:
    system = make(np.random.default_rng(1))
    part = system["z", "u"]
    assert [p.name for p in part.inputs] == ["u"] and [p.name for p in part.outputs] == ["z"]
    whole, small = system.at({"k": 1.0}), part.at({"k": 1.0})
    np.testing.assert_allclose(small(2.0j), whole(2.0j)[2:3, :2], atol=1e-14)
    values = system.sample_values(np.random.default_rng(3), 50)
    assert all(0.2 <= v["k"] <= 1.4 for v in values) and len({v["k"] for v in values}) == 50
    assert len(system.sample(np.random.default_rng(3), 2)) == 2


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


def test_pid_response() -> None:
    K = pid("e", "u", derivative_filter=0.1)
    n, x = K.order, np.array([2.0, 3.0, 0.5])
    M = K.gain_matrix(x)
    s = 1.5j
    value = M[n:, n:] + M[n:, :n] @ np.linalg.solve(s * np.eye(n) - M[:n, :n], M[:n, n:])
    assert value.item() == pytest.approx(2.0 + 3.0 / s + 0.5 * s / (0.1 * s + 1))
    only_d = pid("e", "u", derivative_filter=0.1, terms="D")
    assert (only_d.order, only_d.size) == (1, 1)


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
