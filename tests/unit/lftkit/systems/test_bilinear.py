"""The bilinear map against its definition, and what it keeps: norms, poles, Gramians."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from lftkit.systems.sampled.bilinear import (
    continuous_point,
    to_continuous,
    to_discrete,
    unwarped_frequency,
    warped_frequency,
)

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


@pytest.mark.parametrize("seed", range(3))
def test_poles_without_an_image_are_refused(seed: int) -> None:
    """Exactly, and to rounding in coordinates that mix them."""
    T = np.random.default_rng(seed).normal(size=(5, 5)) if seed else np.eye(5)
    B, C, D = np.ones((5, 1)), np.ones((1, 5)), np.zeros((1, 1))
    A = T @ np.diag([-1.0, 0.3, 0.5, -0.2, 0.9]) @ np.linalg.inv(T)
    for rcond in (0.0, 1e-13)[bool(seed) :]:
        with pytest.raises(ValueError, match=r"^system must have no pole at z = -1, got one$"):
            to_continuous(A, B, C, D, rcond=rcond)
    with pytest.raises(ValueError, match=r"^system must have no pole at s = 2 / dt = 4\.0 rad/s, got one$"):
        to_discrete(-4.0 * A, B, C, D, 0.5)


def test_units_of_the_states_are_no_poles_without_an_image() -> None:
    units = np.diag([1e9, 1e-9, 1.0, 1e-6])
    A, B, C, D = system()
    scaled = units @ A @ np.linalg.inv(units), units @ B, C @ np.linalg.inv(units), D
    given = to_discrete(A, B, C, D, DT)
    found = to_discrete(*scaled, DT)
    for a, b in zip(
        given, (np.linalg.inv(units) @ found[0] @ units, np.linalg.inv(units) @ found[1], found[2] @ units)
    ):
        np.testing.assert_allclose(b, a, rtol=1e-10, atol=1e-13)
    back = to_continuous(*found, DT)
    np.testing.assert_allclose(np.linalg.inv(units) @ back[0] @ units, A, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("dt", [0.01, 0.3, 2.0])
@pytest.mark.parametrize("share", [1e-6, 0.1, 0.5, 0.99])
def test_frequencies_are_warped_as_points_of_the_circle(dt: float, share: float) -> None:
    omega = share * np.pi / dt
    s = continuous_point(complex(np.exp(1j * omega * dt)), dt)
    assert s == pytest.approx(1j * warped_frequency(omega, dt), rel=1e-9)
    assert unwarped_frequency(warped_frequency(omega, dt), dt) == pytest.approx(omega, rel=1e-12)
    assert warped_frequency(np.pi / dt, dt) == warped_frequency(np.inf, dt) == np.inf
    assert unwarped_frequency(np.inf, dt) == pytest.approx(np.pi / dt)


@pytest.mark.parametrize("dt", [0.01, 2.0])
def test_gramians_stay_where_the_root_of_the_period_is_shared(dt: float) -> None:
    A, B, C, _ = system()
    a, b, c, _ = to_discrete(*system(), dt)
    root = dt**0.5
    P = linalg.solve_continuous_lyapunov(A, -(root * B) @ (root * B).T)
    Q = linalg.solve_continuous_lyapunov(A.T, -(C / root).T @ (C / root))
    np.testing.assert_allclose(linalg.solve_discrete_lyapunov(a, b @ b.T), P, rtol=1e-9)
    np.testing.assert_allclose(linalg.solve_discrete_lyapunov(a.T, c.T @ c), Q, rtol=1e-9)
