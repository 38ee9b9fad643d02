"""Passivity indices: closed forms, the response at every frequency, duality, and what has none."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from lftkit import System, passivity_index, s


def channel(expression: Any) -> System:
    made: System = expression.system("force", "velocity")
    return made


@pytest.mark.parametrize(
    ("expression", "nu", "rho"),
    [
        ((s + 2) / (s + 1), 1.0, 0.5),
        (1 / (s + 1), 0.0, 1.0),
        (s / (s**2 + 0.1 * s + 1), 0.0, 0.1),
        (1 / (s + 1) ** 2, -1.0 / 8.0, -math.inf),  # (1 - w^2) / (1 + w^2)^2 at w^2 = 3
        (1 / (s**2 + s + 1), -1.0 / 3.0, -math.inf),
        ((s - 1) / (s + 1), -1.0, -1.0),
        ((s + 4) / (s + 1) ** 2, None, -2.0),  # 1 / G = s - 2 + 9 / (s + 4): at infinity
    ],
)
def test_closed_forms(expression: Any, nu: float | None, rho: float) -> None:
    for side, index in (("input", nu), ("output", rho)):
        if index is None:
            continue
        found = passivity_index(channel(expression), side)
        assert found.lower <= found.value
        assert found.value == pytest.approx(index, abs=2e-6)
        assert found.lower == pytest.approx(index, abs=2e-5)


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("seed", range(2))
def test_no_frequency_is_below_the_lower_side(seed: int, dt: float) -> None:
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 6)), int(rng.integers(1, 4))
    A = rng.standard_normal((n, n))
    poles = linalg.eigvals(A)
    A = 0.9 * A / np.abs(poles).max() if dt else A - (poles.real.max() + 0.3) * np.eye(n)
    D = rng.standard_normal((m, m)) + (seed % 3) * 3.0 * np.eye(m)
    G = System(A, rng.standard_normal((n, m)), rng.standard_normal((m, n)), D, [("f", m)], [("v", m)], "G", dt)
    omega = np.linspace(0.0, math.pi / dt, 500) if dt else np.concatenate([[0.0], np.geomspace(1e-2, 1e3, 500)])
    for side in ("input", "output"):
        found = passivity_index(G, side)
        responses = np.concatenate([G.response([*omega, min(found.omega, 1e9)]), G.D[None]])
        of_side = responses if side == "input" else np.linalg.inv(responses)
        indices = np.linalg.eigvalsh(0.5 * (of_side + of_side.conj().swapaxes(1, 2)))[:, 0]
        least = indices[:-1].min() if dt else indices.min()
        assert -math.inf < found.lower <= least + 1e-6 * max(1.0, abs(least))
        assert found.value <= least + 1e-5 * max(1.0, abs(least))
        at = indices[-2] if math.isfinite(found.omega) else indices[-1]
        assert found.value == pytest.approx(at, rel=1e-9, abs=1e-9)


def test_zero_has_no_shortage() -> None:
    nothing = System([[-1.0]], [[1.0]], [[0.0]], [[0.0]], [("f", 1)], [("v", 1)])
    assert passivity_index(nothing).value == 0.0
    assert passivity_index(nothing, "output").value == math.inf


def test_what_has_no_index_is_refused() -> None:
    with pytest.raises(ValueError, match="must be stable for a passivity index"):
        passivity_index(channel(1 / (s - 1)))
    with pytest.raises(ValueError, match="must have as many inputs as outputs, got 2 and 1"):
        passivity_index(System([[-1.0]], [[1.0, 0.0]], [[1.0]], [[0.0, 0.0]], [("f", 2)], [("v", 1)]))
    with pytest.raises(ValueError, match="side must be input or output, got 'both'"):
        passivity_index(channel(1 / (s + 1)), "both")


@pytest.mark.parametrize("seed", range(6))
def test_the_inverse_of_a_lag_behind_an_index_has_that_index_at_infinity(seed: int) -> None:
    """``G^-1 = s E + X + H`` with E symmetric: the least index is that of ``X + H``, and at infinity that of X."""
    rng = np.random.default_rng(seed)
    m, n = 1 + seed % 2, 2
    X, root = rng.standard_normal((m, m)), rng.standard_normal((m, m)) + 3.0 * np.eye(m)
    A, B, C = -np.diag([1.0, 30.0]), rng.standard_normal((n, m)), rng.standard_normal((m, n))
    E, gain = root @ root.T, 40.0 * np.eye(m)  # the gain makes G stable
    # E y' = u - (X + gain) y - H y
    inner = linalg.inv(E)
    whole = np.block([[-inner @ (X + gain), -inner @ C], [B, A]])
    into, seen = np.vstack([inner, np.zeros((n, m))]), np.hstack([np.eye(m), np.zeros((m, n))])
    G = System(whole, into, seen, np.zeros((m, m)), [("f", m)], [("v", m)])
    rest = System(A, B, C, X + gain, [("v", m)], [("f", m)])
    expected, found = passivity_index(rest), passivity_index(G, "output")
    assert found.value == pytest.approx(expected.value, rel=1e-6)
    assert found.lower <= expected.value
    assert found.lower == pytest.approx(expected.value, rel=1e-4)
