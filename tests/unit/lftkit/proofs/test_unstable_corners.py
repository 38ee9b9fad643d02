"""The search of unstable corners against all corners, and against the published aircraft."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import linalg
from support.uncertain_examples import transport_aircraft

from lftkit import RealParameter, System
from lftkit.arrays import FloatArray
from lftkit.proofs.state_space.corners import CornerSearch, earliest_unstable_corner
from lftkit.proofs.state_space.search import ray_factor, smallest_unstable_factor

PARAMETERS = 7


def random_system(seed: int) -> System:
    """Six states, seven parameters of which two occur twice, and a feedthrough; intervals of unequal sides."""
    rng = np.random.default_rng(seed)
    names = tuple(f"p{i}" for i in range(PARAMETERS))
    channels = (*names, "p1", "p4")
    A = rng.normal(size=(6, 6))
    A -= (linalg.eigvals(A).real.max() + 0.3) * np.eye(6)
    B, C = 0.3 * rng.normal(size=(6, 9)), 0.3 * rng.normal(size=(9, 6))
    parameters = tuple(RealParameter(n, 0.0, -rng.uniform(0.3, 1.0), rng.uniform(0.3, 1.0)) for n in names)
    return System(
        A, B, C, 0.1 * rng.normal(size=(9, 9)), (), (), channels=channels, elements=parameters
    ).sorted_channels()


def ends_of(system: System) -> FloatArray:
    return np.array([(p.lower - p.nominal, p.upper - p.nominal) for p in system.parameters])


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(n, marks=pytest.mark.slow) for n in range(4, 8))])
def test_no_corner_is_unstable_much_earlier_than_the_one_found(seed: int) -> None:
    system, largest = random_system(seed), 20.0
    search = CornerSearch(system, ends_of(system))

    def ray(corner: FloatArray) -> float:
        return ray_factor(system, search.offset(corner), largest)

    found, corner = earliest_unstable_corner(search, largest, ray, samples=8, seed=0)
    every = min(ray(np.array(c)) for c in itertools.product((-1.0, 1.0), repeat=PARAMETERS))
    assert corner is not None and found == pytest.approx(ray(corner), rel=1e-6)
    assert every <= found * (1.0 + 1e-6) and found <= 1.001 * every


def test_poles_move_as_their_derivatives_say() -> None:
    system = random_system(3)
    search = CornerSearch(system, ends_of(system))
    at = 0.4 * search.offset(np.array([1.0, -1, 1, 1, -1, -1, 1]))
    poles, slopes = search._slopes(at)
    for axis in range(PARAMETERS):
        step = 1e-6 * np.eye(PARAMETERS)[axis]
        ahead, back = (search._slopes(at + sign * step)[0] for sign in (1.0, -1.0))
        for number, pole in enumerate(poles):
            moved = ahead[np.argmin(np.abs(ahead - pole))] - back[np.argmin(np.abs(back - pole))]
            assert moved.real / 2e-6 == pytest.approx(slopes[number, axis], rel=1e-5, abs=1e-6)


def test_the_unstable_corner_of_the_aircraft() -> None:
    """One of 16 384 corners is unstable from 5.4281 times the box."""
    system = transport_aircraft().sorted_channels()
    box = [(p.lower, p.upper) for p in system.parameters]
    factor, point, frequency = smallest_unstable_factor(system, box, 10.0)
    assert factor == pytest.approx(5.4281, abs=2e-4) and frequency == pytest.approx(0.623, abs=1e-3)
    nominal = np.array([p.nominal for p in system.parameters])
    signs = [-1, 1, -1, 1, 1, 1, 1, -1, 1, -1, -1, -1, 1, 1]
    np.testing.assert_array_equal(np.sign(point - nominal), signs)
    np.testing.assert_allclose(np.abs(point - nominal), factor * 0.1 * np.abs(nominal), rtol=1e-9)


def test_without_an_unstable_member_none_is_found() -> None:
    system = random_system(1)
    search = CornerSearch(system, 1e-3 * ends_of(system))
    assert earliest_unstable_corner(search, 1.0, lambda corner: 1.0, samples=4, seed=0) == (np.inf, None)
