"""H-infinity norms in discrete time against 100 digits: the certificate is about the matrices that were given."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
import scipy.linalg
from support.circle_reference import butterworth, chebyshev, delayed, exact_h2, exact_norm, filtered, near_the_circle
from support.resonant_systems import resonator, sum_of

from lftkit.analysis.circle.exact_circle_norm import Quotient
from lftkit.analysis.norms import h2_norm, hinf_norm

EPS = np.finfo(float).eps
RTOL = 1e-7
TINY = 1e-12
KINDS = {"near": near_the_circle, "filter": filtered, "delay": delayed}


def check(system: tuple[np.ndarray, ...], rtol: float = RTOL) -> str:
    """The norm lies between both sides, which are at most `rtol` apart; returns the certificate."""
    exact, radius = exact_norm(system)
    norm = hinf_norm(*system, dt=1.0, rtol=rtol)
    if radius >= 1.0 - 4 * len(system[0]) * EPS:
        assert (norm.value, norm.upper, norm.certificate) == (np.inf, np.inf, "unstable")
        return norm.certificate
    assert norm.value <= exact * (1 + TINY)
    assert norm.upper >= exact
    assert norm.upper <= norm.value * (1 + rtol * (1 + 1e-6))
    return norm.certificate


@pytest.mark.parametrize("edge", [0.01, 0.96, 0.97, 0.99])
def test_chebyshev_filters_of_order_8(edge: float) -> None:
    """Their norm by the bilinear map was 3 % too low (0.97), infinite (0.01, 0.99) or 2.5e-3 too high."""
    assert check(chebyshev(8, edge)) in ("interval", "polynomial")


def test_value_is_the_gain_at_the_frequency_that_is_named() -> None:
    A, B, C, D = chebyshev(8, 0.97)
    norm = hinf_norm(A, B, C, D, dt=0.5)
    with mp.workdps(60):
        z = mp.expj(mp.mpf(norm.omega) / 2)
        resolvent = mp.lu_solve(z * mp.eye(8) - mp.matrix(A.tolist()), mp.matrix(B.tolist()))
        gain = abs((mp.matrix(C.tolist()) * resolvent)[0] + D.item())
    assert norm.value == pytest.approx(float(gain), rel=1e-12)


def test_filters_and_random_systems() -> None:
    """Random filters are left to the slow test; a delay has no basis of eigenvectors."""
    rng = np.random.default_rng(20)
    for system in (*(butterworth(n, edge) for n in (4, 12) for edge in (0.02, 0.5, 0.98)), *drawn(rng, 4)):
        check(system)


def drawn(rng: np.random.Generator, count: int) -> list[tuple[np.ndarray, ...]]:
    return [KINDS[kind](rng) for kind in ("near", "delay") for _ in range(count)]


@pytest.mark.slow
@pytest.mark.parametrize("block", range(10))
@pytest.mark.parametrize("kind", KINDS)
def test_five_hundred_random_systems(kind: str, block: int) -> None:
    rng = np.random.default_rng([block, *kind.encode()])
    for _ in range(17):
        check(KINDS[kind](rng))


@pytest.mark.parametrize("rtol", [1e-2, 1e-5, 1e-9])
def test_both_sides_for_other_tolerances(rtol: float) -> None:
    check(chebyshev(6, 0.9), rtol)
    check(near_the_circle(np.random.default_rng(3)), rtol)


@pytest.mark.parametrize("dt", [1.0, 0.01])
@pytest.mark.parametrize("inside", [0.1, 1e-9])
@pytest.mark.parametrize(("side", "omega"), [(1.0, 0.0), (-1.0, np.pi)])
def test_pole_at_one_or_minus_one_to_nine_digits(side: float, omega: float, inside: float, dt: float) -> None:
    """1 / (z - a) has the norm 1 / (1 - |a|) at z = 1 or z = -1, which the double holds to its last digit."""
    a = side * (1.0 - inside)
    norm = hinf_norm([[a]], [[1.0]], [[1.0]], [[0.0]], dt=dt)
    exact = 1.0 / (1.0 - abs(a))
    assert norm.omega == pytest.approx(omega / dt)
    assert norm.value == pytest.approx(exact, rel=1e-12) and exact <= norm.upper <= exact * (1 + 1.01e-7)


def test_all_pass_has_the_norm_1_everywhere() -> None:
    """No peak tells where to look: the expansion must follow the response, not its terms."""
    poles = np.array([0.5, -0.3, 0.9 * np.exp(0.7j), 0.9 * np.exp(-0.7j), 0.99 * np.exp(2j), 0.99 * np.exp(-2j)])
    a = np.poly(poles).real
    for certificate, found in (("auto", "hamiltonian"), ("interval", "interval")):
        norm = hinf_norm(*scipy_system(a[::-1], a), dt=1.0, certificate=certificate)
        assert norm.certificate == found
        assert norm.value == pytest.approx(1.0, rel=1e-10) and 1.0 <= norm.upper <= 1.0 + 1.01e-7


def scipy_system(b: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, ...]:
    """tf2ss."""
    from scipy import signal

    return signal.tf2ss(b, a)


def test_shift_register_and_larger_system_without_eigenvectors() -> None:
    """A delay keeps the norm; 40 states are too many for integers, so resolvents must do."""
    lag = np.array([[0.9]]), np.array([[1.0]]), np.array([[1.0]]), np.array([[0.25]])
    alone = 10.25
    for k in (1, 3, 39):
        A = np.zeros((k + 1, k + 1))
        A[0, 0], A[0, k] = 0.9, 1.0
        A[np.arange(2, k + 1), np.arange(1, k)] = 1.0
        B, C = np.eye(k + 1)[:, 1:2], np.eye(k + 1)[:1] + 0.25 * np.eye(k + 1)[k:]
        norm = hinf_norm(A, B, C, np.zeros((1, 1)), dt=1.0)
        assert norm.value == pytest.approx(alone, rel=1e-10) and alone <= norm.upper <= alone * (1 + 1.01e-7)
    assert hinf_norm(*lag, dt=1.0).value == pytest.approx(alone, rel=1e-12)


def test_what_cannot_be_decided_is_said() -> None:
    """Fifty equal poles in one chain 0.05 from the circle: rounding hides whether they are inside."""
    A = 0.95 * np.eye(50) + np.eye(50, k=1)
    A[-1, 0] = 1e-60
    T = scipy.linalg.hilbert(50) + np.eye(50)
    norm = hinf_norm(T @ A @ scipy.linalg.inv(T), np.ones((50, 1)), np.ones((1, 50)), [[0.5]], dt=1.0)
    assert (norm.value, norm.upper, norm.certificate) == (0.5, np.inf, "none")


def test_schur_cohn_counts_the_circle_as_outside() -> None:
    for radius, inside in ((0.5, True), (1.0 - 1e-12, True), (1.0, False), (1.5, False)):
        for angle in (0.7, 2.0):
            quotient = Quotient.of(tuple(np.asarray(x, float) for x in resonator(radius, angle)))
            assert quotient is not None and quotient.stable(1.0) == inside
    both = sum_of(([[0.5]], [[1.0]], [[1.0]], [[0.0]]), ([[-2.0]], [[1.0]], [[1.0]], [[0.0]]))
    assert not Quotient.of(both).stable(1.0)


def test_smallest_and_largest_gains() -> None:
    """Squares of the gains have no place in a double."""
    assert Quotient.of((np.array([[0.5]]), np.array([[1e-200]]), np.ones((1, 1)), np.zeros((1, 1)))) is None
    large = hinf_norm([[0.5]], [[1e200]], [[1.0]], [[1e200]], dt=1.0)
    assert large.value == pytest.approx(3e200, rel=1e-9)
    norm = hinf_norm([[0.5]], [[1e-200]], [[1.0]], [[0.0]], dt=1.0)
    assert norm.value == pytest.approx(2e-200, rel=1e-9, abs=0.0) and norm.upper >= 2e-200


def test_h2_norm_of_filters_and_random_systems() -> None:
    """A Lyapunov equation solved in double precision answered 0.67 instead of 0.94 (8, 0.97) and 0 (8, 0.01)."""
    filters = [chebyshev(order, edge) for order, edge in ((8, 0.01), (8, 0.97), (12, 0.9), (4, 0.001))]
    for system in (*filters, *drawn(np.random.default_rng(21), 8)):
        assert h2_norm(*system, dt=1.0) == pytest.approx(float(exact_h2(system)), rel=1e-9)


def test_h2_norm_of_a_long_delay_and_of_what_rounding_hides() -> None:
    A, B, C = np.eye(40, k=-1), np.eye(40)[:, :1], np.eye(40)[-1:]
    assert h2_norm(A, 3.0 * B, C, [[4.0]], dt=1.0) == pytest.approx(5.0, rel=1e-14)
    T = scipy.linalg.hilbert(50) + np.eye(50)
    chain = T @ (0.3 * np.eye(50) + 3.0 * np.eye(50, k=1)) @ scipy.linalg.inv(T)
    with pytest.raises(ArithmeticError, match="rounding hides the H2 norm of a discrete-time system of order 50"):
        h2_norm(chain, np.ones((50, 1)), np.ones((1, 50)), [[0.5]], dt=1.0)
