"""Proofs of sampled loops: enclosures, known worst cases, what is bisected, proofs that are altered."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import linalg
from scipy.linalg import expm
from support.sampled_modes import DAMPING, mode_and_law, tick_matrices
from support.slow_cases import slow
from support.uncertain_examples import aligned_modes, transport_aircraft

from lftkit import Port, RealParameter, System
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.sampled_loop import (
    BisectionOptions,
    LoopModel,
    LoopProof,
    box_of,
    check_loop_proof,
    loop_model,
    prove_level,
)
from lftkit.proofs.sampled_loop.bounds import member_gains
from lftkit.proofs.sampled_loop.scalings import Branching
from lftkit.proofs.state_space.corners import CornerSearch, earliest_unstable_corner
from lftkit.proofs.state_space.search import ray_factor, smallest_unstable_factor
from lftkit.proofs.trusted.polynomials import Polynomial, exponential, inverse, reciprocal
from lftkit.proofs.trusted.proof import ProofError, Strip
from lftkit.proofs.trusted.stability import nominal_windows

DT = 0.1
NYQUIST = math.pi / DT
ZETA = 0.5 * DAMPING
PLANT, LAW = mode_and_law(-0.3, DT)


def oscillator(low: float = 0.8, high: float = 1.3) -> System:
    """Unit mass on a spring of uncertain stiffness k, damping 2 zeta; position by force, worst at the least k."""
    k = RealParameter("k", 1.0, low, high)
    A, B = [[0.0, 1.0], [-1.0, -2.0 * ZETA]], [[0.0, 0.0], [-1.0, 1.0]]
    C = [[1.0, 0.0], [1.0, 0.0]]
    return System(A, B, C, np.zeros((2, 2)), (Port("force", 1),), (Port("x", 1),), channels=("k",), elements=(k,))


def peak(k: float) -> float:
    """Peak of 1 / |k - w^2 + 2 j zeta w|."""
    return 1.0 / (2.0 * ZETA * math.sqrt(k - ZETA**2))


def proof_of(system: System, level: float) -> LoopProof:
    model = loop_model(system, DT)
    bounds = prove_level(model, box_of(system), (0.0, NYQUIST), level)
    assert not bounds.uncovered
    names = tuple(p.name for p in system.parameters)
    return LoopProof(model, names, box_of(system), (0.0, NYQUIST), level, tuple(bounds.strips))


@pytest.fixture(scope="module")
def proof() -> LoopProof:
    return proof_of(oscillator(), 1.02 * peak(0.8))


def inside(p: Polynomial, t: float, value: ComplexArray) -> bool:
    found = sum(c * t**k for k, c in enumerate(p.c))
    return bool(np.all(np.abs(found - value) <= p.rad + 1e-13 * np.abs(value) + 1e-300))


def test_polynomials_enclose_what_they_stand_for() -> None:
    rng = np.random.default_rng(0)
    for half in (1e-3, 0.05, 0.3):
        middle = rng.uniform(0.0, 3.0, 4)
        wave = exponential(middle, half * np.ones(4))
        matrix = rng.normal(size=(4, 4)) + 3.0 * np.eye(4)
        whole = Polynomial(np.stack([matrix, 0.3 * half * rng.normal(size=(4, 4))]).astype(complex))
        shifted = wave + Polynomial(np.full((1, 4), 1.5, complex))
        for t in (-1.0, -0.4, 0.0, 0.7, 1.0):
            at = np.exp(1j * (middle + half * t))
            assert inside(wave, t, at)
            assert inside(reciprocal(shifted), t, 1.0 / (1.5 + at))
            assert inside(inverse(whole), t, np.linalg.inv(whole.c[0] + t * whole.c[1]))
            assert inside(wave * wave, t, at**2)
            assert inside(whole @ whole, t, np.linalg.matrix_power(whole.c[0] + t * whole.c[1], 2))


@pytest.mark.parametrize("half", [0.001, 0.02])
def test_responses_of_a_window_enclose_those_of_its_frequencies(half: float) -> None:
    model = loop_model(PLANT, DT, LAW, commands=["u"], measurements=["v"])
    V = np.eye(2, dtype=complex)
    z, e = model.responses(1.0, half, V)
    for t in np.linspace(-1.0, 1.0, 9):
        channels, errors = model.at(1.0 + half * t)
        assert inside(z, float(t), channels) and inside(e, float(t), errors)


@pytest.mark.parametrize("omega", [0.3, 0.9, 7.0, 40.0])
def test_the_model_has_the_sampled_response_of_the_nominal_loop(omega: float) -> None:
    """Error by disturbance: the steady state of the ticks under a force ``exp(j w t)``."""
    _, errors = loop_model(PLANT, DT, LAW, commands=["u"], measurements=["v"]).at(omega)
    A, _ = tick_matrices(PLANT, LAW)
    force = expm(DT * np.array([[0.0, 1.0, 0.0], [-1.0, -DAMPING, 1.0], [0.0, 0.0, 1j * omega]]))[:2, 2]
    state = np.linalg.solve(np.exp(1j * omega * DT) * np.eye(4) - A, [*force, 0.0, 0.0])
    assert complex(errors[0, 1]) == pytest.approx(state[0], rel=1e-9)


def test_a_known_worst_case_is_bounded_from_both_sides(proof: LoopProof) -> None:
    checked = check_loop_proof(proof)
    assert checked.band == (0.0, NYQUIST) and checked.strips == len(proof.strips)
    truth = peak(0.8)
    omega = math.sqrt(0.8 - 2.0 * ZETA**2)
    assert float(member_gains(proof.model, omega, np.array([[-0.2]]))[0]) == pytest.approx(truth, rel=1e-9)
    assert truth < proof.level


@pytest.mark.parametrize("factor", [0.999, *(slow(factor) for factor in (1.004, 2.0))])
def test_a_proof_of_another_level_is_used_where_it_holds(proof: LoopProof, factor: float) -> None:
    level, box = factor * peak(0.8), box_of(oscillator())
    bounds = prove_level(proof.model, box, proof.band, level, known=proof.strips)
    again = dataclasses.replace(proof, level=level, strips=tuple(bounds.strips))
    if factor < 1.0:
        assert bounds.uncovered or bounds.lower >= level
        with pytest.raises(ProofError):
            check_loop_proof(again)
        return
    assert not bounds.uncovered and check_loop_proof(again).level == level
    kept = sum(len(strip.nodes) for strip in bounds.strips)
    assert kept >= bounds.nodes and (factor < proof.level / peak(0.8) or bounds.nodes == 0)


@pytest.mark.parametrize("part", [1e-3, pytest.param(1e-2, marks=pytest.mark.slow)])
def test_an_unstable_member_is_never_covered(part: float) -> None:
    """Negative damping beyond d = 0: a pole crosses the axis inside the box."""
    d = RealParameter("d", 0.1, -0.02, 0.2)
    A, B, C = [[0.0, 1.0], [-1.0, -0.1]], [[0.0, 0.0], [-1.0, 1.0]], [[0.0, 1.0], [1.0, 0.0]]
    system = System(A, B, C, np.zeros((2, 2)), (Port("force", 1),), (Port("x", 1),), channels=("d",), elements=(d,))
    bounds = prove_level(loop_model(system, DT), box_of(system), (0.99, 1.01), 1e3, options=BisectionOptions(part))
    assert bounds.uncovered or bounds.lower >= 1e3


@pytest.mark.parametrize("gain", [-9.0, -4.9958, -4.9858, 0.05, 0.12, 20.0])
def test_the_nominal_loop_is_stable_as_its_eigenvalues_say(gain: float) -> None:
    """Velocity feedback: unstable where it takes more than the damping away, and where the lag is too large.

    Between the second and the third gain the largest eigenvalue passes 1.
    """
    plant, law = mode_and_law(gain, DT)
    radius = float(np.abs(np.linalg.eigvals(tick_matrices(plant, law)[0])).max())
    assert abs(radius - 1.0) > 1e-5
    windows = nominal_windows(loop_model(plant, DT, law, commands=["u"], measurements=["v"]))
    assert (windows > 0) == (radius < 1.0)


def test_unstable_controllers_and_open_plants_are_not_called_stable() -> None:
    growing = mode_and_law(-0.3, DT, pole=1.01)[1]
    assert not nominal_windows(loop_model(PLANT, DT, growing, commands=["u"], measurements=["v"]))
    assert not nominal_windows(loop_model(oscillator(), DT))


def test_half_a_circle_is_enough_for_real_systems_alone() -> None:
    """A mode without its conjugate: negative frequencies have not been looked at."""
    model = loop_model(PLANT, DT, LAW, commands=["u"], measurements=["v"])
    assert nominal_windows(model)
    assert not nominal_windows(dataclasses.replace(model, B=model.B * np.array([[1.0], [1.0 + 1e-9]])))
    assert not nominal_windows(dataclasses.replace(model, K_C=model.K_C * 1j))


@pytest.mark.parametrize(("factor", "proven"), [(1.002, True), (0.998, False)])
def test_near_frequency_zero_the_bound_is_as_sharp(factor: float, proven: bool) -> None:
    """Scalings D alone: the static gain of the softest spring, 1 / k."""
    high = 0.02
    truth = 1.0 / abs(0.8 - high**2 + 2j * ZETA * high)
    bounds = prove_level(loop_model(oscillator(), DT), box_of(oscillator()), (0.0, high), factor * truth)
    assert (not bounds.uncovered and bounds.lower < factor * truth) == proven


def tightest(proof: LoopProof) -> Strip:
    """The strip with the worst frequency."""
    worst, lowest = math.sqrt(0.8), proof.box[0][0]
    return next(s for s in proof.strips if s.nodes[0] <= worst <= s.nodes[-1] and s.box[0][0] == lowest)


def with_strip(proof: LoopProof, **changes: object) -> LoopProof:
    own = tightest(proof)
    strips = [dataclasses.replace(s, **changes) if s is own else s for s in proof.strips]  # type: ignore[arg-type]
    return dataclasses.replace(proof, strips=tuple(strips))


def louder(model: LoopModel) -> LoopModel:
    return dataclasses.replace(model, C=1.05 * model.C)


CHANGES: dict[str, Callable[[LoopProof], LoopProof]] = {
    "strip removed": lambda p: dataclasses.replace(p, strips=p.strips[1:]),
    "box widened": lambda p: with_strip(p, box=((p.box[0][0] - 0.1, p.box[0][1]),)),
    "claim widened": lambda p: dataclasses.replace(p, box=((p.box[0][0] - 0.1, p.box[0][1]),)),
    "frequencies moved": lambda p: with_strip(p, nodes=0.99 * tightest(p).nodes),
    "level lowered": lambda p: dataclasses.replace(p, level=0.97 * peak(0.8)),
    "D negative": lambda p: with_strip(p, D=tuple(-d for d in tightest(p).D)),
    "D zero": lambda p: with_strip(p, D=tuple(0.0 * d for d in tightest(p).D)),
    "G turned": lambda p: with_strip(p, G=tuple(-g for g in tightest(p).G)),
    "not Hermitian": lambda p: with_strip(p, G=tuple(g + 1e-3j for g in tightest(p).G)),
    "factor negative": lambda p: with_strip(p, factor=-tightest(p).factor),
    "factor infinite": lambda p: with_strip(p, factor=np.inf * tightest(p).factor),
    "nodes exchanged": lambda p: with_strip(p, nodes=tightest(p).nodes[::-1].copy()),
    "another plant": lambda p: dataclasses.replace(p, model=louder(p.model)),
    "no strips": lambda p: dataclasses.replace(p, strips=()),
    "another limit": lambda p: dataclasses.replace(p, model=dataclasses.replace(p.model, scale=0.9)),
}


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_proof_is_refused(proof: LoopProof, name: str) -> None:
    with pytest.raises(ProofError):
        check_loop_proof(CHANGES[name](proof))


SLOW, FAST = 1.0, 10.0


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
