"""Channels of the arrays' angle: half of them, in another form, closed at once, against the plant at given angles."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit import RealParameter
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.lft_response import MANY, LftResponse, RepeatedClosed
from los_loop.angle_channels import half_turn, half_turn_slope, kept_channels
from los_loop.open_loop import OpenLoop
from titop_plant.blocks.rotation import rotation
from titop_plant.disturbances.wheel_and_drive_tones import REFERENCE_CHANNELS
from titop_plant.interface import COMMANDS
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.layout import ANGLE
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.weights import weight_amplitudes


@pytest.fixture(scope="module")
def open_loop() -> OpenLoop:
    telescope = load_telescope()
    return OpenLoop(control_loop_plant(telescope), telescope)


def points(count: int) -> np.ndarray:
    """Random points, the first four at theta of -pi or pi."""
    found = np.random.default_rng(7).uniform(size=(count, 7))
    found[:4, -1] = [0.0, 1.0, 0.0, 1.0]
    return found


def test_the_entry_is_that_of_the_tangent_of_half_the_angle() -> None:
    tau = np.array([-0.9, -0.2, 0.0, 0.3, 0.7])
    t = np.tan(2.0 * np.arctan(tau))
    np.testing.assert_allclose(half_turn(tau), t / (1.0 - 1j * t), atol=1e-15)
    h = 1e-6
    slope = (half_turn(tau + h) - half_turn(tau - h)) / (2.0 * h)
    np.testing.assert_allclose(half_turn_slope(tau), slope, atol=1e-9)


@pytest.mark.parametrize("count", [6, MANY + 6])
def test_responses_to_disturbances_are_those_of_the_plant_at_the_parameters(count: int, open_loop: OpenLoop) -> None:
    """The plant that the expression of the telescope gives at numbers, without any channel: few points, and many."""
    at, system, omega = points(count), open_loop.system, np.array([0.05, 0.74, 7.4, 85.0, 399.2, 2500.0])
    found = [open_loop.closed_over(lft, at)[:, :, :REFERENCE_CHANNELS] for lft in open_loop.at(omega)]
    sizes = weight_amplitudes(open_loop.telescope, omega)
    for k in (0, 1, 2, 3, count - 1):
        plant = system.at(open_loop.values(at[k]))
        exact = FrequencyResponse.of(plant.A, plant.B[:, COMMANDS:], plant.C, plant.D[:, COMMANDS:]).at(omega)
        for ours, theirs, size, frequency in zip(found, exact, sizes, omega):
            for row, reference in zip(ours[k], theirs * size):
                assert np.linalg.norm(row - reference) < 1e-5 * np.linalg.norm(reference), frequency


@pytest.mark.parametrize("omega", [0.05, 0.74, 7.4, 399.2, 2500.0])
def test_responses_are_those_of_all_channels_of_the_telescope(omega: float, open_loop: OpenLoop) -> None:
    """48 channels with the differences of the parameters from their nominal values, theta as tan(theta / 4)."""
    at, system = points(MANY), open_loop.system
    q, names = len(system.channels), list(open_loop.names)
    G = FrequencyResponse.of(system.A, system.B, system.C, system.D).at([omega])[0]
    delta = (open_loop.low + at * open_loop.width - open_loop.nominal)[:, [names.index(c) for c in system.channels]]
    into = slice(q + COMMANDS, None)
    whole = LftResponse(G[:q, :q], G[q:, :q], G[:q, into], G[q:, into]).closed(delta.astype(complex))
    expected = whole * weight_amplitudes(open_loop.telescope, np.array([omega]))[0]
    found = open_loop.closed_over(open_loop.at(np.array([omega]))[0], at)[:, :, :REFERENCE_CHANNELS]
    for rows in (slice(0, 18), slice(18, 20), slice(20, 22), slice(22, 24)):
        size = np.linalg.norm(expected[:, rows], axis=(1, 2))
        assert np.all(np.linalg.norm((found - expected)[:, rows], axis=(1, 2)) <= 1e-9 * size)


def test_many_points_have_the_responses_of_each(open_loop: OpenLoop) -> None:
    at = points(2 * MANY)
    for omega in (0.05, 2.6, 580.0):
        lft = open_loop.at(np.array([omega]))[0]
        each = np.concatenate([open_loop.closed_over(lft, point[None]) for point in at])
        together = open_loop.closed_over(lft, at)
        for rows in (slice(0, 22), slice(22, 24)):
            size = np.linalg.norm(each[:, rows], axis=1)
            assert np.all(np.linalg.norm((together - each)[:, rows], axis=1) <= 1e-11 * size + 1e-300)


def test_channels_without_a_basis_of_eigenvectors_are_solved_point_by_point(open_loop: OpenLoop) -> None:
    rng, q = np.random.default_rng(0), open_loop.channels
    shapes = ((q, q), (2, q), (q, 3), (2, 3))
    lft = LftResponse(*(rng.normal(size=shape) + 1j * rng.normal(size=shape) for shape in shapes))
    lft.M[np.ix_(open_loop.angle, open_loop.angle)] = np.eye(16, k=1)
    assert RepeatedClosed.of(lft, open_loop.angle) is None
    delta = open_loop.delta(points(MANY))
    np.testing.assert_array_equal(lft.closed(delta, open_loop.angle), lft.closed(delta))


def test_all_channels_are_kept_where_the_nominal_angle_is_not_zero() -> None:
    for nominal, kept in ((0.0, [0, 1]), (0.2, [0, 1, 2, 3])):
        turn = rotation([0.0, 1.0, 0.0], RealParameter(ANGLE, nominal, -1.0, 1.0))
        assert kept_channels(turn).tolist() == kept
