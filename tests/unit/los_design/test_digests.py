"""A digest covers every number that a law uses: where it stays, the law does what it did."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from lftkit import Port, SampledSystem
from los_design.synthesis.provenance import digest
from los_design.synthesis.store import load_designs
from los_design.verification.certify import model_digest
from los_design.verification.loop_models import box_of, figures_of, telescope_model
from los_design.verification.subject import Subject
from los_loop.control_laws import ControlLaws
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.interface import DT, MIRROR_STAGES
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope


def changes(system: SampledSystem) -> dict[str, SampledSystem]:
    """The system with each field changed, each entry of ``design_basis`` changed and left out."""
    found = {name: dataclasses.replace(system, **{name: 1.001 * getattr(system, name)}) for name in "ABCD"}
    found |= {"dt": dataclasses.replace(system, dt=2.0 * system.dt)}
    found |= {
        "name": dataclasses.replace(system, name="other"),
        "provenance": dataclasses.replace(system, provenance={}),
    }
    for side in ("inputs", "outputs"):
        ports = getattr(system, side)
        found[side] = dataclasses.replace(system, **{side: (Port("other", ports[0].size, ports[0].unit), *ports[1:])})
    basis = dict(system.design_basis)
    for name, value in basis.items():
        other: Any = "other" if isinstance(value, str) else 1.001 * value
        found[f"basis {name}"] = dataclasses.replace(system, design_basis={**basis, name: other})
        found[f"no {name}"] = dataclasses.replace(
            system, design_basis={key: entry for key, entry in basis.items() if key != name}
        )
    return found


def acts(k_fsm: SampledSystem, k_pma: SampledSystem) -> list[list[Any]]:
    """All numbers of the laws of each stage, with another sensitivity of the telescope than that of the file."""
    found = []
    for stage in MIRROR_STAGES:
        for law in ControlLaws(k_fsm, k_pma, stage, 0.2).laws:
            parts = [getattr(law.system, name).tolist() for name in "ABCD"]
            found.append([*parts, law.system.dt, law.gain, law.measured, law.command])
    return found


@pytest.mark.parametrize("number", [0, 1])
def test_each_field_changes_the_digest_or_not_the_law(number: int) -> None:
    pair = list(load_designs("implemented"))
    own, before = digest(pair[number]), acts(*pair)
    fields = {entry.name for entry in dataclasses.fields(SampledSystem) if entry.init}
    tried = changes(pair[number])
    assert {name.split()[-1] for name in tried} >= (fields - {"design_basis"}), "each field is changed"
    for name, other in tried.items():
        if digest(other) == own:
            assert acts(*(other if k == number else system for k, system in enumerate(pair))) == before, name
    assert digest(tried["name"]) == digest(tried["provenance"]) == own
    assert digest(tried["basis los_sensitivity"]) != own != digest(tried["no los_sensitivity"])


def test_matrices_of_other_shapes_have_other_digests() -> None:
    """The same bytes as A and B of other sizes."""
    one = SampledSystem(np.zeros((1, 1)), [[1.0, 2.0]], [[3.0]], [[4.0, 5.0]], (Port("u", 2),), (Port("y", 1),), 1.0)
    two = SampledSystem(
        np.zeros((1, 1)), [[1.0]], [[2.0], [3.0]], [[4.0], [5.0]], (Port("u", 1),), (Port("y", 2),), 1.0
    )
    assert digest(one) != digest(two)


def test_what_decides_has_128_bits() -> None:
    telescope = load_telescope()
    subject = Subject.of(*load_designs("implemented"), telescope.digest)
    assert [len(name) for name in vars(subject).values()] == [32, 32, 32]
    assert telescope.digest.startswith(telescope.parameters_hash)


def test_a_proof_for_one_sensitivity_is_none_for_another() -> None:
    k_fsm, k_pma = load_designs("implemented")
    other = dataclasses.replace(k_fsm, design_basis={**k_fsm.design_basis, "los_sensitivity": 0.11})
    own = Subject.of(k_fsm, k_pma, "telescope")
    assert own.covers(own, "fsm") and not own.covers(Subject.of(other, k_pma, "telescope"), "fsm")


def test_each_field_of_a_model_changes_the_name_of_its_parts() -> None:
    """Period, hold and channels too: parts of a proof that are kept are found by this name."""
    telescope = load_telescope()
    loop = ImplementedLoop(OpenLoop(control_loop_plant(telescope), telescope), *load_designs("implemented"), "fsm")
    model, box = telescope_model(loop, figures_of(telescope, "fsm")["slow"]), box_of(loop)
    own = model_digest(model, box)
    assert len(own) == 64 and model.dt == DT
    assert model_digest(model, (*box[:-1], (0.0, 1.0))) != own
    for field in dataclasses.fields(model):
        value = getattr(model, field.name)
        other: Any = value * 2 if isinstance(value, np.ndarray) else (value, 1)
        assert model_digest(dataclasses.replace(model, **{field.name: other}), box) != own, field.name
