"""Laws of the H-infinity norm, on every way by which it is computed."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import scipy.linalg

from lftkit.analysis.norms import HInfNorm, band_gain, hinf_norm
from lftkit.systems.sampled.bilinear import to_discrete

RTOL = 1e-7
DT = 0.2
Matrices = tuple[np.ndarray, ...]
Norm = Callable[[Matrices], HInfNorm]

CONTINUOUS: dict[str, Callable[..., HInfNorm]] = {
    "auto": hinf_norm,
    "interval": lambda *system: hinf_norm(*system, certificate="interval"),
    "hamiltonian": lambda *system: hinf_norm(*system, certificate="hamiltonian"),
    "band": lambda *system: band_gain(*system, (0.0, np.inf), rtol=RTOL),
}
DISCRETE: dict[str, Callable[..., HInfNorm]] = {
    "discrete": lambda *system: hinf_norm(*system, dt=DT),
    "circle": lambda *system: hinf_norm(*system, dt=DT, certificate="interval"),
}
SYSTEMS = [(1, 1, 1), (3, 2, 3), (17, 2, 2)]  # states, inputs, outputs


@pytest.fixture(params=[*CONTINUOUS, *DISCRETE])
def way(request: pytest.FixtureRequest) -> tuple[Norm, bool]:
    """A way to the norm, and whether its systems are in discrete time."""
    discrete = request.param in DISCRETE
    function = (DISCRETE if discrete else CONTINUOUS)[request.param]
    return lambda system: function(*system), discrete


def random_system(shape: tuple[int, int, int], discrete: bool, feedthrough: float = 0.5) -> Matrices:
    """Slowest decay 0.01 to 1 times the largest pole, made discrete by the bilinear map."""
    n, m, p = shape
    rng = np.random.default_rng(shape)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 10.0 ** rng.uniform(-2.0, 0.0)) * np.eye(n)
    system = A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), feedthrough * rng.normal(size=(p, m))
    return to_discrete(*system, DT) if discrete else system


def gains(system: Matrices, discrete: bool, omega: np.ndarray) -> np.ndarray:
    A, B, C, D = system
    points = np.exp(1j * omega * DT) if discrete else 1j * omega
    responses = C @ np.linalg.solve(points[:, None, None] * np.eye(len(A)) - A, B.astype(complex)) + D
    return np.linalg.norm(responses, 2, axis=(1, 2))


def grid(discrete: bool) -> np.ndarray:
    return np.linspace(0.0, np.pi / DT, 3000) if discrete else np.tan(np.linspace(0.0, 0.5 * np.pi, 3000)[:-1])


def same(one: HInfNorm, other: HInfNorm, factor: float = 1.0) -> bool:
    """Whether both brackets have a norm in common, the second one times `factor`."""
    return one.value <= other.upper * factor * (1 + 1e-9) and other.value * factor <= one.upper * (1 + 1e-9)


@pytest.mark.parametrize("shape", SYSTEMS)
@pytest.mark.parametrize("feedthrough", [0.0, 20.0])
def test_value_is_reached_and_no_gain_exceeds_the_upper_side(
    way: tuple[Norm, bool], shape: tuple[int, int, int], feedthrough: float
) -> None:
    norm, discrete = way
    system = random_system(shape, discrete, feedthrough)
    found = norm(system)
    assert found.value <= found.upper <= found.value * (1.0 + RTOL * (1 + 1e-6))
    highest = max(gains(system, discrete, grid(discrete)).max(), 0.0 if discrete else np.linalg.norm(system[3], 2))
    assert highest <= found.upper
    reached = gains(system, discrete, np.array([found.omega]))[0] if found.omega < np.inf else highest
    assert found.value == pytest.approx(reached, rel=1e-9)


@pytest.mark.parametrize("shape", SYSTEMS)
def test_scaling_coordinates_and_transposition(way: tuple[Norm, bool], shape: tuple[int, int, int]) -> None:
    norm, discrete = way
    A, B, C, D = random_system(shape, discrete)
    found = norm((A, B, C, D))
    assert same(norm((A, -3e5 * B, C, -3e5 * D)), found, 3e5)
    T = np.eye(len(A)) + 0.3 * np.random.default_rng(1).normal(size=A.shape) / np.sqrt(len(A))
    assert same(norm((T @ A @ np.linalg.inv(T), T @ B, C @ np.linalg.inv(T), D)), found)
    assert same(norm((A.T, C.T, B.T, D.T)), found)


@pytest.mark.parametrize("shape", SYSTEMS)
def test_parts_sums_and_products(way: tuple[Norm, bool], shape: tuple[int, int, int]) -> None:
    """A block is at most the whole, both side by side are the larger one, a product is at most the product."""
    norm, discrete = way
    A, B, C, D = one = random_system(shape, discrete)
    other = random_system((shape[0] + 1, shape[2], 2), discrete)
    first, second = norm(one), norm(other)
    assert norm((A, B[:, :1], C[:1], D[:1, :1])).value <= first.upper
    beside = norm(tuple(scipy.linalg.block_diag(X, Y) for X, Y in zip(one, other)))
    assert same(beside, max(first, second, key=lambda x: x.value))
    a, b, c, d = other
    cascade = np.block([[A, np.zeros((len(A), len(a)))], [b @ C, a]])
    product = cascade, np.vstack([B, b @ D]), np.hstack([d @ C, c]), d @ D
    assert norm(product).value <= first.upper * second.upper


@pytest.mark.parametrize("states", [1, 8])
def test_inverse_has_the_reciprocal_of_the_smallest_gain(way: tuple[Norm, bool], states: int) -> None:
    norm, discrete = way
    A, B, C, _ = random_system((states, 2, 2), discrete, 0.0)
    D = 3.0 * norm((A, B, C, np.zeros((2, 2)))).upper * np.eye(2)  # so that the inverse is stable
    inverse = A - B @ np.linalg.solve(D, C), B @ np.linalg.inv(D), -np.linalg.solve(D, C), np.linalg.inv(D)
    found = norm(inverse)
    points = np.exp(1j * grid(discrete) * DT) if discrete else 1j * grid(discrete)
    responses = C @ np.linalg.solve(points[:, None, None] * np.eye(states) - A, B.astype(complex)) + D
    smallest = np.linalg.svd(responses, compute_uv=False).min()
    assert 1.0 / found.upper <= smallest * (1 + 1e-9) and 1.0 / found.value == pytest.approx(smallest, rel=1e-3)


@pytest.mark.parametrize("shape", SYSTEMS)
def test_all_ways_agree_in_continuous_and_in_discrete_time(shape: tuple[int, int, int]) -> None:
    """The bilinear map keeps the norm."""
    system = random_system(shape, False)
    sampled = to_discrete(*system, DT)
    found = [CONTINUOUS[name](*system) for name in CONTINUOUS] + [DISCRETE[name](*sampled) for name in DISCRETE]
    assert all(same(one, found[0]) for one in found)


@pytest.mark.parametrize("shape", SYSTEMS)
@pytest.mark.parametrize("unstable", [False, True])
def test_bands_add_up_to_the_whole_axis(shape: tuple[int, int, int], unstable: bool) -> None:
    A, B, C, D = random_system(shape, False)
    A = A + 0.3 * unstable * np.eye(len(A))
    edges = [0.0, 0.4, 0.7, 2.0, 9.0, np.inf]
    whole = band_gain(A, B, C, D, (0.0, np.inf), rtol=RTOL, stable=False)
    parts = [band_gain(A, B, C, D, band, rtol=RTOL, stable=False) for band in pairwise(edges)]
    assert same(max(parts, key=lambda part: part.value), whole)
    for (low, high), part in zip(pairwise(edges), parts):
        inside = np.clip(np.linspace(low, min(high, 1e3), 2000), low, high)
        assert gains((A, B, C, D), False, inside).max() <= part.upper and low <= part.omega <= high
        assert part.upper <= part.value * (1.0 + RTOL * (1 + 1e-6))


@pytest.mark.parametrize("seed", range(3))
def test_the_gain_in_a_band_of_the_circle_is_above_every_gain_there_and_reached(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(5, 5))
    A *= 0.97 / np.abs(np.linalg.eigvals(A)).max()
    B, C, D, dt = rng.normal(size=(5, 2)), rng.normal(size=(2, 5)), rng.normal(size=(2, 2)), 0.05

    def gain(omega: Any) -> Any:
        points = np.exp(1j * dt * np.atleast_1d(omega))[:, None, None]
        return np.linalg.norm(C @ np.linalg.solve(points * np.eye(5) - A, B.astype(complex)) + D, 2, axis=(1, 2))

    low, high = np.sort(rng.uniform(0.0, np.pi / dt, 2))
    for band in ((low, high), (0.0, high), (low, np.inf)):
        found = band_gain(A, B, C, D, band, dt=dt, rtol=1e-7)
        grid = gain(np.linspace(band[0], min(band[1], np.pi / dt), 2000))
        assert found.value <= found.upper <= found.value * (1.0 + 1e-6)
        assert found.value * 0.999 <= grid.max() <= found.upper * (1.0 + 1e-12)
        assert gain(found.omega).item() == pytest.approx(found.value, rel=1e-9)
    whole = band_gain(A, B, C, D, (0.0, np.inf), dt=dt, rtol=RTOL)
    assert whole.value == pytest.approx(hinf_norm(A, B, C, D, dt=dt).value, rel=1e-5)


@pytest.mark.parametrize(
    ("band", "dt"), [((2.0, 1.0), None), ((-1.0, 1.0), None), ((1.0, 1.0), 0.1), ((40.0, 50.0), 0.1)]
)
def test_bands_without_a_frequency_are_refused(band: tuple[float, float], dt: float | None) -> None:
    with pytest.raises(ValueError, match="band must be a lower and a higher frequency"):
        band_gain([[-0.5]], [[1.0]], [[1.0]], [[0.0]], band, dt=dt)
