"""The bilinear map against its definition."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.systems.sampled.bilinear import to_continuous, to_discrete

DT = 0.3


def system() -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(4)
    return rng.normal(size=(4, 4)) - 2 * np.eye(4), rng.normal(size=(4, 2)), rng.normal(size=(3, 4)), np.ones((3, 2))


def response(matrices: tuple[np.ndarray, ...], x: complex) -> np.ndarray:
    A, B, C, D = matrices
    return np.asarray(C @ np.linalg.solve(x * np.eye(len(A)) - A, B) + D)


@pytest.mark.parametrize("theta", [0.0, 0.4, 2.0, 3.1])
def test_discrete_response_is_the_continuous_one_at_the_warped_frequency(theta: float) -> None:
    z = np.exp(1j * theta)
    expected = response(system(), 2.0 / DT * (z - 1.0) / (z + 1.0))
    np.testing.assert_allclose(response(to_discrete(*system(), DT), z), expected, rtol=1e-12)
    assert 2.0 / DT * (z - 1.0) / (z + 1.0) == pytest.approx(2j / DT * np.tan(theta / 2.0), abs=1e-12)


@pytest.mark.parametrize("dt", [0.01, 0.3, 2.0])
def test_maps_are_inverse_to_each_other(dt: float) -> None:
    for there, back in ((to_discrete, to_continuous), (to_continuous, to_discrete)):
        for given, found in zip(system(), back(*there(*system(), dt), dt)):
            np.testing.assert_allclose(found, given, rtol=1e-11, atol=1e-11)


def test_period_of_the_way_back_is_two_unless_given() -> None:
    for a, b in zip(to_continuous(*system()), to_continuous(*system(), 2.0)):
        assert np.array_equal(a, b)


def test_static_gain_stays() -> None:
    D = np.array([[2.0, -1.0]])
    empty = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), D
    for found in (to_discrete(*empty, 0.1), to_continuous(*empty, 0.1)):
        assert [m.shape for m in found] == [(0, 0), (0, 2), (1, 0), (1, 2)] and np.array_equal(found[3], D)


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf])
def test_period_must_be_positive(dt: float) -> None:
    with pytest.raises(ValueError, match=rf"dt must be positive, got {dt}"):
        to_discrete(*system(), dt)


def test_poles_without_an_image_are_refused() -> None:
    one = np.ones((1, 1))
    with pytest.raises(ValueError, match=r"poles must not be at 2 / dt = 4\.0 rad/s, got one there"):
        to_discrete(4.0 * one, one, one, one, 0.5)
    with pytest.raises(ValueError, match="poles must not be at -1, got one there"):
        to_continuous(-one, one, one, one)
