"""Closing over Delta and over a controller, against dense linear algebra on all signals of the loop at once."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.analysis.lft_response import MANY, LftResponse, feedback

Q, P, M = 6, 3, 4
REPEATED = np.array([True, False, True, True, False, False])


def random(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def lft(rng: np.random.Generator, count: int | None = None) -> LftResponse:
    lead = () if count is None else (count,)
    return LftResponse.of(0.3 * random(rng, *lead, Q + P, Q + M), Q)


def all_signals(own: LftResponse, delta: np.ndarray) -> np.ndarray:
    """Outputs by inputs from one equation for (z, w): ``z - M w = T21 d``, ``w - Delta z = 0``; Delta (w, z) dense."""
    w, z = delta.shape
    equations = np.block([[np.eye(z), -own.M], [-delta, np.eye(w)]])
    signals = np.linalg.solve(equations, np.vstack([own.T21, np.zeros((w, own.T21.shape[1]))]))
    return own.T11 + own.T12 @ signals[z:]


def diagonals(rng: np.random.Generator, count: int) -> np.ndarray:
    """Complex entries, those of the repeated channels equal."""
    found = random(rng, count, Q)
    found[:, REPEATED] = found[:, :1]
    return found


@pytest.mark.parametrize("count", [1, 5, MANY + 3])
@pytest.mark.parametrize("repeated", [None, REPEATED])
def test_the_closed_response_solves_all_signals(count: int, repeated: np.ndarray | None) -> None:
    rng = np.random.default_rng(count)
    own, delta = lft(rng), diagonals(rng, count)
    for found, entries in zip(own.closed(delta, repeated), delta):
        np.testing.assert_allclose(found, all_signals(own, np.diag(entries)), rtol=1e-9, atol=1e-11)


def test_each_frequency_can_have_a_delta_of_its_own() -> None:
    rng = np.random.default_rng(0)
    own, delta = lft(rng, 7), diagonals(rng, 7)
    for k, found in enumerate(own.closed(delta)):
        np.testing.assert_allclose(found, own[k].closed(delta[k : k + 1])[0], rtol=1e-12)


def test_parts_of_inputs_and_outputs_are_parts_of_the_response() -> None:
    rng = np.random.default_rng(2)
    own, delta, rows, columns = lft(rng), diagonals(rng, 3), slice(1, 3), slice(0, 2)
    np.testing.assert_allclose(own.part(rows, columns).closed(delta), own.closed(delta)[:, rows, columns], rtol=1e-12)


@pytest.mark.parametrize("shape", [(Q, Q), (2, Q), (Q, 4)])
def test_a_real_matrix_is_closed_at_all_frequencies(shape: tuple[int, int]) -> None:
    """Square and not: (outputs of Delta, inputs of Delta)."""
    rng, (w, z) = np.random.default_rng(3), shape
    own = LftResponse(random(rng, 5, z, w), random(rng, 5, P, w), random(rng, 5, z, M), random(rng, 5, P, M))
    delta = 0.2 * rng.standard_normal(shape)
    for k, found in enumerate(own.closed_with_matrix(delta)):
        np.testing.assert_allclose(found, all_signals(own[k], delta), rtol=1e-9, atol=1e-11)


def test_a_loop_closed_twice_is_closed_with_the_sum() -> None:
    """F_u(F_u(N, a), b) where the second Delta is added to the first: N with ``M' = M (I - a M)^-1``, and so on."""
    rng = np.random.default_rng(4)
    own = lft(rng)
    a, b = 0.3 * random(rng, Q), 0.3 * random(rng, Q)
    seen = np.linalg.inv(np.eye(Q) - own.M * a)
    first = LftResponse(
        seen @ own.M, own.T12 @ np.linalg.inv(np.eye(Q) - a[:, None] * own.M), seen @ own.T21, own.closed(a[None])[0]
    )
    np.testing.assert_allclose(first.closed(b[None])[0], own.closed((a + b)[None])[0], rtol=1e-9)


def test_slopes_are_difference_quotients() -> None:
    rng, step = np.random.default_rng(5), 1e-6
    own, delta = lft(rng, 4), diagonals(rng, 4)
    found = own.gain_slopes(delta)
    np.testing.assert_allclose(found.values, np.linalg.svd(own.closed(delta), compute_uv=False), rtol=1e-12)
    closed = own.closed(delta)
    for k in range(4):
        assert found.left[k] @ closed[k] @ found.right[k] == pytest.approx(found.values[k, 0])
    for channel in range(Q):
        for turn in (1.0, 1j):
            change = np.zeros(Q, complex)
            change[channel] = step * turn
            gains = [np.linalg.norm(own.closed(delta + sign * change), 2, axis=(1, 2)) for sign in (1.0, -1.0)]
            expected = (gains[0] - gains[1]) / (2.0 * step)
            np.testing.assert_allclose((found.slopes[:, channel] * turn).real, expected, rtol=1e-5, atol=1e-8)


@pytest.mark.parametrize("balanced", [False, True])
def test_feedback_satisfies_its_equation(balanced: bool) -> None:
    rng = np.random.default_rng(6)
    gain, entering = random(rng, 5, 3, 3), random(rng, 5, 3, 2)
    found = feedback(gain, entering, balanced=balanced)
    np.testing.assert_allclose(found, gain @ found + entering, rtol=1e-10)


def test_balanced_rows_keep_the_digits_of_small_commands() -> None:
    """Angles of 1e-9 beside forces of 1e3, each from the other: in equal units the solution is known."""
    rng = np.random.default_rng(7)
    gain, entering, units = random(rng, 1, 2, 2), random(rng, 1, 2, 1), np.array([1e-9, 1e3])
    expected = units[:, None] * np.linalg.solve(np.eye(2) - gain[0], entering[0])
    scaled = gain * units[:, None] / units
    found = feedback(scaled, units[:, None] * entering, balanced=True)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
