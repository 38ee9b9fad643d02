"""Covers contain their members on the grid, with a weight that is no larger than the fit needs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lftkit import InputError, System, discretise, s, ucover

OMEGA = np.geomspace(0.01, 100.0, 60)
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


@pytest.mark.parametrize(
    ("given", "nominal", "message"),
    [
        ([NOMINAL], NOMINAL, "members must differ from the nominal system"),
        (np.ones((2, 3)), NOMINAL, r"members must be responses of shape \(K, 60\), got \(2, 3\)"),
        (np.full((1, 60), np.nan), NOMINAL, "members must have finite responses"),
        (np.ones((1, 60)), System.static([[0.0]], [("u", 1)], [("y", 1)]), "the response must not be zero"),
        (np.ones((1, 60)), System.static([[1.0, 0.0]], [("u", 2)], [("y", 1)]), "must have one input and one output"),
    ],
)
def test_what_cannot_be_covered_is_refused(given: Any, nominal: System, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ucover(given, nominal, 1, OMEGA)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"members": "some"}, "members must be systems or their responses, got str"),
        ({"order": 1.5}, "order must be an integer, got 1.5"),
        ({"omega": "low"}, "omega must be a vector of finite numbers, got str"),
        ({"omega": []}, r"members must be responses of shape \(K, 0\)"),
        ({"name": 3}, "name of an element must be text, got 3"),
    ],
)
def test_arguments_of_another_type_are_refused(changed: Any, message: str) -> None:
    given: dict[str, Any] = {"members": members(), "nominal": NOMINAL, "order": 1, "omega": OMEGA} | changed
    with pytest.raises(InputError, match=message):
        ucover(**given)
