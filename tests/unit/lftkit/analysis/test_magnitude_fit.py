"""Fits of a gain and covers: what is of the order is found, envelopes stay above, covers contain their members."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lftkit import System, discretise, s, ucover
from lftkit.analysis.magnitude_fit import fit_magnitude

OMEGA = np.geomspace(0.01, 100.0, 60)
JW = 1j * OMEGA


def gain_of(system: System) -> Any:
    return np.abs(system.response(OMEGA)[:, 0, 0])


@pytest.mark.parametrize(
    ("response", "order"),
    [
        (3.0 + 0.0 * JW, 0),
        ((JW - 2.0) / (JW - 0.5), 1),
        ((JW**2 - 0.2 * JW + 4.0) / (JW**2 + 0.1 * JW + 1.0), 2),
        ((JW**2 + 0.2 * JW + 4.0) / (JW**2 + 0.1 * JW + 1.0) * (3.0 * JW + 1.0) / (0.1 * JW + 1.0), 3),
    ],
)
def test_a_gain_of_that_order_is_found(response: Any, order: int) -> None:
    found = fit_magnitude(OMEGA, np.abs(response), order)
    assert found.order == order
    assert gain_of(found) == pytest.approx(np.abs(response), rel=1e-6)


@pytest.mark.further
@pytest.mark.parametrize(
    ("order", "seed", "dt"), [(0, 0, 0.02), (1, 1, 0.0), (2, 0, 0.02), pytest.param(3, 1, 0.0, marks=pytest.mark.slow)]
)
def test_an_envelope_is_above_and_minimum_phase(order: int, seed: int, dt: float) -> None:
    rng = np.random.default_rng(seed)
    wanted = np.exp(0.7 * rng.standard_normal(len(OMEGA))) / np.abs(1.0 + JW)
    found = fit_magnitude(OMEGA, wanted, order, above=True, dt=dt)
    assert np.all(gain_of(found) >= wanted)
    assert (gain_of(found) / wanted).min() == pytest.approx(1.0, abs=1e-6), "no more than is needed"
    for system in (found, found.inverse()):
        poles = system.poles()
        assert np.all(np.abs(poles) < 1.0) if dt else np.all(poles.real < 0.0)
    lower = fit_magnitude(OMEGA, wanted, order, dt=dt)
    raised = gain_of(lower) * (wanted / gain_of(lower)).max()
    assert (gain_of(found) / wanted).max() <= (raised / wanted).max() * (1.0 + 1e-6), (
        "no worse than least squares, raised"
    )


def test_a_weight_says_where_the_fit_counts() -> None:
    wanted = np.where(OMEGA < 1.0, 1.0, 10.0)
    low = fit_magnitude(OMEGA, wanted, 0, weight=np.where(OMEGA < 1.0, 1.0, 1e-3))
    assert abs(low.D.item()) == pytest.approx(1.0, rel=1e-3)


def test_units_of_frequency_do_not_matter() -> None:
    wanted = np.abs((JW + 1.0) / (JW + 10.0))
    fast = fit_magnitude(1e6 * OMEGA, wanted, 1)
    assert fast.poles().real == pytest.approx([-1e7], rel=1e-5)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"magnitude": [1.0]}, "omega and magnitude must be as many numbers"),
        ({"omega": [0.0, 2.0]}, "omega must be positive, finite and rising"),
        ({"omega": [2.0, 1.0]}, "omega must be positive, finite and rising"),
        ({"omega": "low"}, "omega must be a vector of finite numbers, got str"),
        ({"magnitude": [1.0, 0.0]}, "magnitude must be positive and finite, got 0.0 to 1.0"),
        ({"magnitude": 1j}, "magnitude must be a rectangular array of real numbers, got complex"),
        ({"order": -1}, "order must be at least 0, got -1"),
        ({"order": 1.5}, "order must be an integer, got 1.5"),
        ({"dt": 2.0}, "omega must be below pi / dt"),
        ({"dt": -1.0}, "dt must be positive, got -1.0"),
        ({"weight": [1.0, np.nan]}, "weight must be 2 finite numbers, zero or positive, not all zero"),
        ({"weight": "some"}, "weight must be a rectangular array of real numbers, got str"),
    ],
)
def test_what_cannot_be_fitted_is_refused(changed: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fit_magnitude(**{"omega": [1.0, 2.0], "magnitude": [1.0, 1.0], "order": 1, **changed})


NOMINAL = (1 / (s**2 + 0.4 * s + 1)).system("u", "y")


def members(count: int = 12) -> list[System]:
    rng = np.random.default_rng(0)
    return [
        ((1 + 0.2 * rng.uniform(-1, 1)) / (s**2 + 0.4 * s + 1) * (1 / (rng.uniform(0, 0.1) * s + 1))).system("u", "y")
        for _ in range(count)
    ]


@pytest.mark.parametrize(("order", "dt"), [(0, 0.0), (1, 0.02), (2, 0.0), (3, 0.02)])
def test_every_member_is_in_the_uncertain_system(order: int, dt: float) -> None:
    nominal = discretise(NOMINAL, dt) if dt else NOMINAL
    given = [discretise(one, dt) if dt else one for one in members()]
    found = ucover(given, nominal, order, OMEGA)
    assert found.weight.order == order and found.system.dt == dt
    W, G0 = found.weight.response(OMEGA)[:, 0, 0], nominal.response(OMEGA)[:, 0, 0]
    assert np.all(np.abs(W) >= found.envelope)
    for one in given:
        response = one.response(OMEGA)[:, 0, 0]
        delta = (response / G0 - 1.0) / W
        assert np.abs(delta).max() <= 1.0
        for k in (0, 17, 42):
            value = found.system.response([OMEGA[k]], {"delta": delta[k]})[0, 0, 0]
            assert value == pytest.approx(response[k], rel=1e-9)


def test_a_higher_order_is_nearer_to_the_envelope() -> None:
    given = members()
    excess = [
        float((np.abs(f.weight.response(OMEGA)[:, 0, 0]) / f.envelope).max())
        for f in (ucover(given, NOMINAL, order, OMEGA) for order in (0, 1, 3))
    ]
    assert excess[2] <= excess[1] * 1.001 < excess[0]
    assert excess[2] < 1.2


def test_measured_responses_are_taken_and_the_weight_is_minimum_phase() -> None:
    responses = np.array([one.response(OMEGA)[:, 0, 0] for one in members()])
    found = ucover(responses, NOMINAL, 2, OMEGA, name="modes")
    assert list(found.system.occurrences()) == ["modes"]
    assert np.allclose(found.envelope, ucover(members(), NOMINAL, 2, OMEGA).envelope)
    for system in (found.weight, found.weight.inverse()):
        assert np.all(system.poles().real < 0.0)


def test_the_nominal_system_is_kept_to_the_last_bit() -> None:
    found = ucover(members(), NOMINAL, 1, OMEGA).system.nominal()
    assert found(0.3j) == pytest.approx(NOMINAL(0.3j), rel=1e-14)


ZERO, TWO = (System.static([row], [("u", len(row))], [("y", 1)]) for row in ([0.0], [1.0, 0.0]))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"members": [NOMINAL]}, "members must differ from the nominal system"),
        ({"members": np.ones((2, 3))}, r"members must be responses of shape \(K, 60\), got \(2, 3\)"),
        ({"members": np.full((1, 60), np.nan)}, "members must have finite responses"),
        ({"nominal": ZERO}, "the response must not be zero"),
        ({"nominal": TWO}, "must have one input and one output"),
        ({"members": "some"}, "members must be systems or their responses, got str"),
        ({"order": 1.5}, "order must be an integer, got 1.5"),
        ({"omega": "low"}, "omega must be a vector of finite numbers, got str"),
        ({"omega": []}, r"members must be responses of shape \(K, 0\)"),
        ({"name": 3}, "name of an element must be text, got 3"),
    ],
)
def test_what_cannot_be_covered_is_refused(changed: Any, message: str) -> None:
    given: dict[str, Any] = {"members": members(), "nominal": NOMINAL, "order": 1, "omega": OMEGA} | changed
    with pytest.raises(ValueError, match=message):
        ucover(**given)
