"""Laws of the H-infinity norm on every way by which it is computed; the largest gain on the axis; doors to norms."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import control
import numpy as np
import pytest
import scipy.linalg
from scipy import linalg, signal
from support.slow_cases import slow

from lftkit import InputError, System, balred, h2_norm, hinf_norm, hinf_norms, linf_norm, pole_map, real, s, z
from lftkit import sigma_plot as plot
from lftkit.analysis.norms import HInfNorm, band_gain
from lftkit.synthesis import augw, mixsyn, ncfsyn
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
SYSTEMS = [(1, 1, 1), (3, 2, 3), (8, 1, 4), (17, 2, 2)]  # states, inputs, outputs


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
@pytest.mark.parametrize("dt", [None, DT])
def test_bands_add_up_to_the_whole_axis(shape: tuple[int, int, int], unstable: bool, dt: float | None) -> None:
    A, B, C, D = random_system(shape, bool(dt))
    A = (1.4 * A if dt else A + 0.3 * np.eye(len(A))) if unstable else A
    edges, last = [0.0, 0.4, 0.7, 2.0, 9.0, np.inf], np.pi / dt if dt else 1e3
    whole = band_gain(A, B, C, D, (0.0, np.inf), dt=dt, rtol=RTOL, stable=False)
    parts = [band_gain(A, B, C, D, band, dt=dt, rtol=RTOL, stable=False) for band in pairwise(edges)]
    assert same(max(parts, key=lambda part: part.value), whole)
    for (low, high), part in zip(pairwise(edges), parts):
        inside = gains((A, B, C, D), bool(dt), np.linspace(low, min(high, last), 2000))
        assert inside.max() <= part.upper and low <= part.omega <= high
        assert part.upper <= part.value * (1.0 + RTOL * (1 + (1e-5 if dt else 1e-6)))
        if np.isfinite(part.omega):
            reached = gains((A, B, C, D), bool(dt), np.array([part.omega])).item()
            assert reached == pytest.approx(part.value, rel=1e-8)


@pytest.mark.parametrize(
    ("band", "dt"), [((2.0, 1.0), None), ((-1.0, 1.0), None), ((1.0, 1.0), 0.1), ((40.0, 50.0), 0.1)]
)
def test_bands_without_a_frequency_are_refused(band: tuple[float, float], dt: float | None) -> None:
    with pytest.raises(ValueError, match="band must be a lower and a higher frequency"):
        band_gain([[-0.5]], [[1.0]], [[1.0]], [[0.0]], band, dt=dt)


def slow_plant(seed: int) -> System:
    """A stable system with a slow pole, whose gain is some thousand times the error of its reduction."""
    rng = np.random.default_rng(seed)
    n, m, p = int(rng.integers(4, 11)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    A = rng.standard_normal((n, n))
    A -= (float(np.linalg.eigvals(A).real.max()) + 10 ** rng.uniform(-3.0, 0.5)) * np.eye(n)
    B, C = rng.standard_normal((n, m)), rng.standard_normal((p, n))
    return System(A, B, C, np.zeros((p, m)), [("u", m)], [("y", p)])


@pytest.mark.parametrize(
    ("seed", "order"), [(66, 8), (66, 7), (83, 7), (104, 6), (111, 4), (194, 7), (260, 7), (0, 2), (1, 2), (2, 2)]
)
def test_the_error_of_a_reduction_exceeds_its_bound_nowhere(seed: int, order: int) -> None:
    """The two ways to a norm agree, and so does the response on a grid, to its own rounding.

    The first seven were up to 0.4 % above the level that the Hamiltonian matrix said is exceeded nowhere.
    """
    given = slow_plant(seed)
    found = balred(given, order)
    error = given - found.system
    norm = hinf_norm(*error.matrices)
    covered = hinf_norm(*error.matrices, certificate="interval")
    assert covered.value <= norm.upper * (1.0 + 1e-9) and norm.value <= covered.upper * (1.0 + 1e-9)
    size = hinf_norm(*given.matrices).value
    for omega in np.geomspace(1e-3, 1e3, 300):
        gain = float(np.linalg.norm(np.atleast_2d(error(1j * omega)).reshape(error.D.shape), 2))
        assert gain <= found.error_bound * (1.0 + 1e-9) + 1e-12 * size


@pytest.mark.parametrize("dt", [None, 0.1])
@pytest.mark.parametrize("seed", [0, slow(1), slow(2)])
def test_it_is_the_largest_gain_on_the_axis(seed: int, dt: float | None) -> None:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((5, 5))
    if dt:
        A = 1.4 * A / np.abs(linalg.eigvals(A)).max()
    system = A, rng.standard_normal((5, 2)), rng.standard_normal((3, 5)), rng.standard_normal((3, 2))
    found = linf_norm(*system, dt=dt)
    grid = np.linspace(0.0, math.pi / dt, 4000) if dt else np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 4000)])
    G = System(*system, [("u", 2)], [("y", 3)], dt=dt or 0.0)
    gains = [linalg.norm(response, 2) for response in G.response(grid)]
    assert max(gains) <= found.upper
    assert found.value <= found.upper <= found.value * (1.0 + 1e-6)
    assert found.value == pytest.approx(linalg.norm(G.response([found.omega])[0], 2), rel=1e-9)
    assert hinf_norm(*system, dt=dt).value == math.inf


def test_a_pole_on_the_axis_has_no_finite_gain() -> None:
    assert linf_norm([[0.0]], [[1.0]], [[1.0]], [[0.0]]).value == math.inf
    assert linf_norm([[0.0, 2.0], [-2.0, 0.0]], np.eye(2), np.eye(2), np.zeros((2, 2))).value == math.inf
    for a in (-3.0, 3.0):  # a mirrored pole keeps the gain
        assert linf_norm([[a]], [[1.0]], [[1.0]], [[0.0]]).value == pytest.approx(1.0 / 3.0)
    for pole in (1.0, -1.0):
        assert linf_norm([[pole]], [[1.0]], [[1.0]], [[0.0]], dt=0.1).value == math.inf


def test_a_gain_without_states() -> None:
    assert linf_norm([], [], [], [[3.0, 4.0]]).value == pytest.approx(5.0)


LAG = 6 / (s**2 + 0.3 * s + 2)


@pytest.mark.parametrize("norm", [hinf_norm, h2_norm, linf_norm])
def test_a_system_is_its_matrices(norm: object) -> None:
    assert callable(norm)
    system = LAG.system("u", "y")
    expected = norm(*system.matrices)
    assert norm(system) == expected and norm(LAG) == expected
    value = getattr(expected, "value", expected)
    other = norm(signal.TransferFunction([6.0], [1.0, 0.3, 2.0]))
    assert getattr(other, "value", other) == pytest.approx(value, rel=1e-7)
    other = norm(control.tf([6.0], [1.0, 0.3, 2.0]))
    assert getattr(other, "value", other) == pytest.approx(value, rel=1e-7)


@pytest.mark.parametrize("norm", [hinf_norm, h2_norm, linf_norm])
def test_a_sampled_system_has_its_period(norm: object) -> None:
    assert callable(norm)
    system = (1 / (z(0.1) - 0.5)).system("u", "y")
    expected = norm(*system.matrices, dt=0.1)
    assert norm(system) == expected and norm(system, dt=0.1) == expected
    with pytest.raises(InputError, match=r"dt must be that of the system, 0\.1 s, got 0\.2 s"):
        norm(system, dt=0.2)


def test_a_matrix_alone_is_a_gain() -> None:
    assert hinf_norm([[3.0, 4.0]]).value == pytest.approx(5.0)


def test_many_systems_or_their_matrices() -> None:
    system = LAG.system("u", "y")
    assert len({norm.value for norm in hinf_norms([system, system.matrices, LAG])}) == 1


def test_what_is_no_system() -> None:
    with pytest.raises(InputError, match="A, B, C and D, or one system, got no C and no D"):
        hinf_norm([[-1.0]], [[1.0]])
    with pytest.raises(InputError, match="system must be a System"):
        hinf_norm("G")
    with pytest.raises(InputError, match="certain"):
        hinf_norm(1 / (s + real("a", 1.0, percent=10)))


def test_weights_and_plants_as_they_are_written() -> None:
    plant, weight = 200 / ((10 * s + 1) * (0.05 * s + 1) ** 2), (s / 1.5 + 10) / (s + 1e-3)
    named = plant.system("u", "y"), weight.system("e", "z")
    assert mixsyn(plant, weight, 1.0).value == mixsyn(*named, 1.0).value
    by_control = control.tf([1 / 1.5, 10.0], [1.0, 1e-3])
    assert mixsyn(plant, by_control, 1.0).value == pytest.approx(mixsyn(*named, 1.0).value, rel=1e-6)
    assert ncfsyn(plant, (s + 2) / s).value == ncfsyn(named[0], ((s + 2) / s).system("v", "u")).value


def test_a_gain_weights_each_channel_of_a_sampled_plant() -> None:
    two = System(0.5 * np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), [("u", 2)], [("y", 2)], dt=0.1)
    for weight in (3.0, 3.0 * np.eye(2), 3.0 + 0.0 * s):
        made = augw(two, error=weight)
        assert made.dt == 0.1 and np.array_equal(made["z1", "w"].D, 3.0 * np.eye(2))
    with pytest.raises(InputError, match="z1 must have 2 inputs or one, got 3"):
        augw(two, error=np.ones((1, 3)))


def test_pictures_of_an_expression() -> None:
    line = plot(LAG, omega=[1e-6, 1.0]).axes[0].lines[0]
    assert line.get_ydata()[0] == pytest.approx(3.0)  # type: ignore[index]
    assert len(pole_map(LAG).axes[0].collections[0].get_offsets()) == 2  # type: ignore[arg-type]
