"""A checked proof names the plant that it is about by its numbers, and is compared with that of its reader."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.uncertain_examples import aligned_modes, chain_of_masses

from lftkit import ComplexParameter, DynamicElement, Port, RealParameter, System
from lftkit.proofs import BoundOptions, ProofError, check_proof, robust_stability, worst_case_gain
from lftkit.proofs.sampled_loop import LoopProof, box_of, loop_model, prove_level
from lftkit.proofs.trusted.noise import NoisePart, NoiseProof
from lftkit.synthesis import lower_bound_proof
from lftkit.tuning.published_plants import published_plant


def lag(element: Any, dt: float = 0.0) -> System:
    """A lag of second order with an element, whose sizes decide the number of channels, in the feedback."""
    outputs, inputs = (element.outputs, element.inputs) if isinstance(element, DynamicElement) else (1, 1)
    q = max(outputs, inputs)
    A, B, C = -np.diag([1.0, 2.0]), np.ones((2, q + 1)), np.ones((q + 1, 2))
    if dt:
        A = 0.5 * np.eye(2)
    B[:, outputs:q] = 0.0
    C[inputs:q] = 0.0
    ports = (Port("u", 1),), (Port("y", 1),)
    channels = (element.name,) * q
    return System(A, B, C, np.zeros((q + 1, q + 1)), *ports, channels=channels, elements=(element,), dt=dt)


def pair() -> System:
    """A complex number before a real one, whose channels a proof orders differently."""
    channels = ("c", "p")
    elements = ComplexParameter("c", 0.0, 0.1), RealParameter("p", 0.0, -0.2, 0.3)
    A, B, C = -np.diag([1.0, 2.0]), np.ones((2, 3)), np.ones((3, 2))
    ports = (Port("u", 1),), (Port("y", 1),)
    return System(A, B, C, np.zeros((3, 3)), *ports, channels=channels, elements=elements)


SYSTEMS: dict[str, tuple[Callable[[], System], tuple[str, ...]]] = {
    "modes": (lambda: aligned_modes(1, 0.1), ("cells", "axis")),
    "masses": (lambda: chain_of_masses(2, 0.05), ("cells", "axis")),
    "complex number": (lambda: lag(ComplexParameter("c", 0.0, 0.1)), ("cells", "axis")),
    "dynamics": (lambda: lag(DynamicElement("f", 1, 1, 0.1)), ("cells", "axis")),
    "dynamics that are not square": (lambda: lag(DynamicElement("f", 1, 2, 0.1)), ("cells", "axis")),
    "two kinds": (pair, ("cells", "axis")),
    "samples": (lambda: lag(RealParameter("p", 0.0, -0.1, 0.1), dt=0.1), ("cells",)),
}


def slower(system: System) -> System:
    """The same names, and a pole that is 1e-12 further from the axis."""
    return replace(system, A=np.asarray(system.A) * (1.0 + 1e-12))


@pytest.mark.parametrize("bound", [worst_case_gain, robust_stability])
@pytest.mark.parametrize(("name", "method"), [(name, method) for name in SYSTEMS for method in SYSTEMS[name][1]])
def test_a_proof_is_of_its_system_and_of_no_other(name: str, method: Any, bound: Any, tmp_path: Path) -> None:
    system = SYSTEMS[name][0]()
    other = slower(system)
    proof, forged = (bound(each, options=BoundOptions(method=method)).proof for each in (system, other))
    assert proof is not None and forged is not None
    forged.to_file(tmp_path / "proof")
    assert len(check_proof(proof, system=system).plant) == 32
    assert check_proof(tmp_path / "proof", system=other).plant != check_proof(proof).plant
    with pytest.raises(ProofError, match="must be of the given system"):
        check_proof(tmp_path / "proof", system=system)


def test_names_nominal_values_and_sampling_are_numbers_of_a_plant() -> None:
    system = lag(RealParameter("p", 0.0, -0.1, 0.1))
    proof = worst_case_gain(system, options=BoundOptions(method="cells")).proof
    moved = replace(system, elements=(RealParameter("p", 0.01, -0.1, 0.1),))
    named = replace(system, channels=("q",), elements=(RealParameter("q", 0.0, -0.1, 0.1),))
    narrower = replace(system, elements=(RealParameter("p", 0.0, -0.05, 0.1),))
    for other in (moved, named, replace(system, A=0.1 * np.asarray(system.A), dt=0.1)):
        with pytest.raises(ProofError, match="must be of the given system"):
            check_proof(proof, system=other)
    check_proof(proof, system=narrower)  # the box is that of the claim


def test_proofs_of_a_loop_are_of_its_model() -> None:
    system, band, level = aligned_modes(1, damping=0.1), (0.0, math.pi / 0.5), 11.0
    model, other = (loop_model(each, dt=0.5) for each in (system, slower(system)))
    box, names = box_of(system), tuple(p.name for p in system.parameters)
    strips = tuple(prove_level(model, box, band, level=level).strips)
    loop = LoopProof(model, names, box, band, level, strips, {})
    noise = NoiseProof(model, names, box, (NoisePart(model.rows, band, level, strips),))
    for proof in (loop, noise):
        forged = replace(proof, model=other)
        assert check_proof(proof, system=model).plant == model.digest != check_proof(forged).plant
        for wrong in ((forged, model), (proof, system)):
            with pytest.raises(ProofError, match="must be of the given system"):
                check_proof(wrong[0], system=wrong[1])


def test_a_lower_bound_is_of_its_plant() -> None:
    plant = published_plant("HE1")
    proof, forged = (lower_bound_proof(each, "y", "u").proof for each in (plant, slower(plant)))
    checked = check_proof(proof, system=plant)
    assert str(checked).startswith(f"plant {checked.plant}, ")
    with pytest.raises(ProofError, match="must be of the given system"):
        check_proof(forged, system=plant)
