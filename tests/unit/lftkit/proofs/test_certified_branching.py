"""Choice of the parameter to bisect: what a smaller interval gains decides, not the loss."""

from __future__ import annotations

import numpy as np
import pytest
from support.uncertain_examples import aligned_modes

from lftkit import Port, RealParameter, System
from lftkit.proofs.sampled_loop import BisectionOptions, LoopProof, box_of, check_loop_proof, loop_model, prove_level
from lftkit.proofs.sampled_loop.branching import Branching

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


def test_losses_decide_where_nothing_is_gained() -> None:
    """A level twenty times below the truth: no level near it can be proven, whichever parameter is held."""
    system = two_oscillators()
    branching = Branching(loop_model(system, dt=0.01), 0.05 / (2.0 * ZETA))
    box = box_of(system)
    assert [branching.axis(box, box, 1.0, np.eye(2)[k]) for k in (0, 1)] == [0, 1]


def test_time_that_is_up_is_kept() -> None:
    """No measurement after the end: losses decide."""
    system = two_oscillators()
    branching = Branching(loop_model(system, dt=0.01), 0.9 / (2.0 * ZETA), until=0.0)
    box = box_of(system)
    assert [branching.axis(box, box, 1.0, np.eye(2)[k]) for k in (0, 1)] == [0, 1]


def test_a_box_is_bisected_at_most_as_often_as_asked() -> None:
    """A level that no scalings of the whole box prove: without bisections its parts of the band stay open at once."""
    system = aligned_modes(2, damping=0.1)
    claim = loop_model(system, dt=0.1), box_of(system), (0.98, 1.02), 10.0
    whole, cut = (prove_level(*claim, options=BisectionOptions(deepest=deepest)) for deepest in (0, 3))
    assert not whole.strips and {box for box, _ in whole.uncovered} == {box_of(system)}
    assert len({strip.box for strip in cut.strips}) > 1


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
