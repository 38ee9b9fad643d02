"""Norms of few states by compiled code: those of the numpy code to 1e-10, in continuous and in discrete time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import lftkit.analysis.norms
from lftkit.analysis.hinf.half_plane import HalfPlane
from lftkit.analysis.hinf.small_norm import COMPILED_STATES
from lftkit.analysis.norms import HInfNorm, compiled, hinf_norm
from lftkit.systems.sampled.bilinear import to_continuous

pytest.importorskip("numba")
SHAPES = [(1, 1), (2, 2), (3, 1), (2, 4), (3, 3)]
System = tuple[np.ndarray, ...]


def random_system(seed: int, shape: tuple[int, int], dt: float | None) -> System:
    rng = np.random.default_rng(seed)
    n, (p, m) = int(rng.integers(1, COMPILED_STATES + 1)), shape
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A)
    if dt is None:
        A -= (poles.real.max() + 10.0 ** rng.uniform(-3.0, 0.0)) * np.eye(n)
    else:
        A *= (1.0 - 10.0 ** rng.uniform(-3.0, -0.3)) / np.abs(poles).max()
    return A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), seed % 2 * rng.normal(size=(p, m))


@pytest.fixture
def by_numpy(monkeypatch: pytest.MonkeyPatch) -> Callable[[System, float | None, str], HInfNorm]:
    """`hinf_norm` where numba is not installed."""

    def norm(system: System, dt: float | None, certificate: str = "auto") -> HInfNorm:
        with monkeypatch.context() as patch:
            patch.setattr(lftkit.analysis.norms, "compiled", lambda: None)
            return hinf_norm(*system, dt=dt, certificate=certificate)

    return norm


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dt", [None, 0.1])
def test_values_are_those_without_compiled_code(shape: tuple[int, int], dt: float | None, by_numpy) -> None:
    kernel, used = compiled(), 0
    for seed in range(12):
        system = random_system(seed, shape, dt)
        one, other = hinf_norm(*system, dt=dt), by_numpy(system, dt)
        assert one.value == pytest.approx(other.value, rel=1e-10)
        assert one.upper == pytest.approx(other.upper, rel=1.1e-7)
        third = by_numpy(system, dt, "interval")  # shares no step with the other two
        assert one.value <= third.upper and third.value <= one.upper
        balanced = tuple(map(np.ascontiguousarray, system))
        found = kernel.norm(balanced, 1e-7, balanced, 0.0, 0.0) if dt is None else kernel.circle_norm(balanced, 1e-7)
        used += found[0] >= 0.0
    assert used >= 7


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_compiled_map_is_the_bilinear_one(sign: float) -> None:
    kernel = compiled()
    for seed in range(12):
        A, B, C, D = random_system(seed, (2, 3), 0.1)
        found, condition = kernel.mapped((A, B, C, D), sign)
        same = [plane.condition for plane in HalfPlane.of((A, B, C, D)) if plane.sign == sign]
        assert not same or condition == pytest.approx(same[0], rel=1e-9)
        for one, other in zip(found, to_continuous(sign * A, sign * B, C, D)):
            assert one == pytest.approx(other, rel=1e-9, abs=1e-11 * condition)


@pytest.mark.parametrize("dt", [None, 0.1])
def test_what_is_not_sound_is_left_to_the_other_ways(dt: float | None) -> None:
    """Unstable, poles at the circle to rounding, no basis of eigenvectors, hidden gain."""
    one, gap = np.eye(2), 0.0 if dt is None else 1.0
    for a in (0.1, 0.0, *([] if dt is None else [-1e-15])):
        norm = hinf_norm((a + gap) * one, one, one, 0.0 * one, dt=dt)
        assert (norm.value, norm.certificate) == (np.inf, "unstable")
    chain = np.array([[gap - 0.5, 1.0], [0.0, gap - 0.5]])
    assert hinf_norm(chain, one[:, 1:], one[:1], np.zeros((1, 1)), dt=dt).value == pytest.approx(4.0, rel=1e-7)
    hidden = hinf_norm((gap - 0.5) * one, one[:, :1], one[1:], np.zeros((1, 1)), dt=dt)
    assert hidden.value == 0.0 and hidden.upper < 1e-12


def test_a_peak_at_the_end_of_the_circle_is_found_by_the_other_map() -> None:
    """One map has z = -1 at infinity, the other one z = 1."""
    for a in (0.9, -0.9):
        for b in (0.95, -0.95):
            norm = hinf_norm(np.diag([a, b]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), dt=1.0)
            ends = [abs(1.0 / (z - a) + 1.0 / (z - b)) for z in (1.0, -1.0)]
            assert norm.certificate == "hamiltonian" and norm.value == pytest.approx(max(ends), rel=1e-12)
            assert norm.omega == pytest.approx(0.0 if ends[0] >= ends[1] else np.pi, abs=1e-6)


def test_one_compilation_serves_every_layout():
    """Each further one takes 20 to 30 s: systems have read-only matrices, and slices are of any layout."""
    kernel = compiled()
    assert kernel is not None
    A, B, C, D = np.array([[-1.0, 2.0], [0.0, -3.0]]), np.eye(2), np.eye(2), np.zeros((2, 2))
    hinf_norm(A, B, C, D)
    hinf_norm(A / 8, B, C, D, dt=1.0)
    before = len(kernel.norm.signatures), len(kernel.circle_norm.signatures)
    for given in (A, np.asfortranarray(A), np.eye(5)[::2, ::2][:2, :2] - 2 * np.eye(2)):
        for writeable in (True, False):
            matrices = [np.asfortranarray(given), B.T, C[::-1], D.copy()]
            for M in matrices:
                M.flags.writeable = writeable
            hinf_norm(*matrices)
            hinf_norm(*matrices, rtol=np.float64(1e-6))
            hinf_norm(*(np.asarray(M / 8) for M in matrices), dt=np.float64(0.1))
    assert (len(kernel.norm.signatures), len(kernel.circle_norm.signatures)) == before
