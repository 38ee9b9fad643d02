"""What is bisected in certified bounds, and unstable corners of a box."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import linalg
from support.uncertain_examples import aligned_modes, transport_aircraft

from lftkit import Port, RealParameter, System
from lftkit.arrays import FloatArray
from lftkit.proofs.sampled_loop import LoopProof, box_of, check_loop_proof, loop_model, prove_level
from lftkit.proofs.sampled_loop.branching import Branching
from lftkit.proofs.state_space.corners import CornerSearch, earliest_unstable_corner
from lftkit.proofs.state_space.search import ray_factor, smallest_unstable_factor

SLOW, FAST, ZETA = 1.0, 10.0, 0.05


def two_oscillators() -> System:
    """Sum of the velocities of two oscillators a decade apart, each with an uncertain stiffness."""
    A, B, C = np.zeros((4, 4)), np.zeros((4, 3)), np.zeros((3, 4))
    parameters = []
    for i, omega in enumerate((SLOW, FAST)):
        position, velocity = 2 * i, 2 * i + 1
        A[position, velocity], A[velocity, position], A[velocity, velocity] = 1.0, -(omega**2), -2.0 * ZETA * omega
        B[velocity, i], B[velocity, 2] = -1.0, 1.0
        C[i, position], C[2, velocity] = 1.0, 1.0
        parameters.append(RealParameter(f"k{i}", omega**2, 0.8 * omega**2, 1.3 * omega**2))
    ports = (Port("force", 1),), (Port("velocity", 1),)
    return System(A, B, C, np.zeros((3, 3)), *ports, channels=("k0", "k1"), elements=tuple(parameters))


@pytest.mark.parametrize(("omega", "axis"), [(0.95 * SLOW, 0), (0.95 * FAST, 1)])
def test_the_stiffness_of_the_oscillator_that_resonates_is_bisected(omega: float, axis: int) -> None:
    """Below the truth, 1 / (2 zeta omega), whatever the losses say."""
    system = two_oscillators()
    branching = Branching(loop_model(system, dt=0.01), 0.9 / (2.0 * ZETA * omega))
    box = box_of(system)
    losses = np.array([0.0, 1.0]) if axis == 0 else np.array([1.0, 0.0])
    assert branching.axis(box, box, omega, losses) == axis
    ends = box[axis]
    small = list(box)
    small[axis] = ends[0], ends[0] + 1e-5 * (ends[1] - ends[0])
    assert branching.axis(tuple(small), box, omega, losses) == 1 - axis, "there is nothing left to bisect in it"


@pytest.mark.parametrize("fixed", [(0,), (0, 1)])
def test_fixed_parameters_are_proven_too(fixed: tuple[int, ...]) -> None:
    """An interval without width: D would be infinite. The bound is that of the parameters that are left."""
    system = aligned_modes(2, damping=0.1)
    model, band = loop_model(system, dt=0.1), (0.3, 3.0)
    box = tuple((0.0, 0.0) if k in fixed else ends for k, ends in enumerate(box_of(system)))
    found = prove_level(model, box, band, 11.0)
    assert not found.uncovered
    proof = LoopProof(model, tuple(p.name for p in system.parameters), box, band, 11.0, tuple(found.strips))
    assert check_loop_proof(proof).box == box


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


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 8))])
def test_no_corner_is_unstable_much_earlier_than_the_one_found(seed: int) -> None:
    system, largest = random_system(seed), 20.0
    search = CornerSearch(system, ends_of(system))

    def ray(corner: FloatArray) -> float:
        return ray_factor(system, search.offset(corner), largest)

    found, corner = earliest_unstable_corner(search, largest, ray, samples=8, seed=0)
    every = min(ray(np.array(c)) for c in itertools.product((-1.0, 1.0), repeat=PARAMETERS))
    assert corner is not None and found == pytest.approx(ray(corner), rel=1e-6)
    assert every <= found * (1.0 + 1e-6) and found <= 1.001 * every


@pytest.mark.further
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
