"""A proof is of the loop that it names: digests of what is proven, texts that look like lines of a check."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command_line import call_command
from support.loop_rows import loop_rows

from lftkit import Port, SampledSystem, real, s
from lftkit.proofs import worst_case_gain
from lftkit.proofs.checking import proof_kind
from lftkit.proofs.sampled_loop import LoopModel, LoopProof
from lftkit.proofs.sampled_loop.files import LOOP, read_loop_proof, write_loop_proof
from lftkit.proofs.trusted.cells import digest as digest_of
from lftkit.proofs.trusted.proof import ProofFileError
from lftkit.proofs.trusted.strips import windows_of
from los_design.synthesis.provenance import law_digest
from los_design.synthesis.store import load_designs
from los_design.verification.certify import model_digest
from los_design.verification.check_proof_texts import require_plain
from los_design.verification.loop_models import box_of, figures_of, telescope_model
from los_design.verification.proof_comparison import compare_proof
from los_design.verification.shipped_proofs import FOLDER, SUFFIX, unpack
from los_design.verification.subject import Subject
from los_loop.control_laws import ControlLaws
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.interface import DT, MIRROR_STAGES
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

FIGURE = "slow"


def loop_of(gain: float = 1.0, stiffer: float = 1.0) -> ImplementedLoop:
    """The shipped loop, with another gain of K_FSM or another isolator."""
    stiffness = [stiffer * k for k in load_telescope().isolator.stiffness]
    telescope = load_telescope().changed({"isolator": {"stiffness": stiffness}})
    k_fsm, k_pma = load_designs("implemented")
    system = control_loop_plant(telescope)
    return ImplementedLoop(
        OpenLoop(system, telescope, telescope.loop_ports.used_by()), replace(k_fsm, C=gain * k_fsm.C), k_pma, "fsm+pma"
    )


def proof_of(loop: ImplementedLoop, level: float = 0.99, figure: str = FIGURE) -> LoopProof:
    """Without its strips, which a comparison does not look at."""
    metric = figures_of(loop.telescope, loop.stage, loop.ports)[figure]
    names = tuple(p.name for p in loop.system.parameters)
    about = {"stage": loop.stage, "figure": figure}
    return LoopProof(telescope_model(loop, metric), names, box_of(loop), metric.band, level, (), about)


@pytest.fixture(scope="module")
def shipped() -> ImplementedLoop:
    return loop_of()


def test_own_proof_is_recognised_after_a_file(shipped: ImplementedLoop, tmp_path: Path) -> None:
    write_loop_proof(proof_of(shipped), tmp_path / "own.npz")
    found = compare_proof(read_loop_proof(tmp_path / "own.npz"), shipped, FIGURE)
    assert found.same and found.difference == 0.0
    turned = reordered(proof_of(shipped).model)
    assert compare_proof(replace(proof_of(shipped), model=turned), shipped, FIGURE).difference < 1e-9


def reordered(model: LoopModel) -> LoopModel:
    """The same loop with modes in another order and scale, as another machine finds them."""
    order, size = np.random.default_rng(0).permutation(len(model.poles)), 2.0
    return replace(model, poles=model.poles[order], C=model.C[:, order] * size, B=model.B[order] / size)


def at_a_resonance(model: LoopModel) -> LoopModel:
    """The output of the sharpest mode changed by a thousandth: nowhere else to be seen."""
    sharpest = int(np.argmax(np.abs(model.poles.imag) / -model.poles.real))
    pair = np.abs(model.poles.imag) == abs(model.poles[sharpest].imag)
    C = model.C.copy()
    C[:, pair] *= 1.001
    return replace(model, C=C)


FORGED: dict[str, tuple[Callable[[LoopModel], LoopModel], str]] = {
    "other rows": (lambda m: replace(m, rows=m.rows[:1]), "rows"),
    "weaker disturbances": (lambda m: replace(m, weights=m.weights * [0.8, 1.0, 1.0]), "weights"),
    "larger limit": (lambda m: replace(m, scale=1.01 * m.scale), "scale"),
    "longer window": (lambda m: replace(m, window=2.0 * m.window), "window"),
    "camera at every tick": (lambda m: replace(m, frame=np.ones_like(m.frame)), "frame"),
    "output of one mode": (at_a_resonance, "responses of telescope or controllers"),
    "a damped mode": (lambda m: replace(m, poles=np.where(m.poles.imag > 400, m.poles - 1.0, m.poles)), "poles"),
    "weaker controller": (lambda m: replace(m, K_C=0.999 * m.K_C), "responses of telescope or controllers"),
    "a mode less": (lambda m: replace(m, poles=m.poles[1:], C=m.C[:, 1:], B=m.B[1:]), "poles of the telescope"),
}


@pytest.mark.parametrize("name", FORGED)
def test_forged_model_is_named(name: str, shipped: ImplementedLoop) -> None:
    change, expected = FORGED[name]
    proof = proof_of(shipped)
    found = compare_proof(replace(proof, model=change(proof.model)), shipped, FIGURE)
    assert not found.same and expected in ", ".join(found.mismatches)


def test_smaller_box_or_band_is_named(shipped: ImplementedLoop) -> None:
    proof = proof_of(shipped)
    low, high = proof.box[0]
    smaller = replace(proof, box=((0.99 * low, high), *proof.box[1:]))
    assert compare_proof(smaller, shipped, FIGURE).mismatches == ("box of the parameters",)
    wider = replace(proof, box=((1.1 * low, high), *proof.box[1:]))
    assert compare_proof(wider, shipped, FIGURE).same, "it says more"
    band = replace(proof, band=(0.1, proof.band[1]))
    assert compare_proof(band, shipped, FIGURE).mismatches == ("band of frequencies",)
    assert "band" in ", ".join(compare_proof(proof, shipped, "fast").mismatches), "the slow one is not the fast one"
    assert compare_proof(proof, shipped, "none").mismatches == ("stage fsm+pma has no figure none",)


@pytest.mark.parametrize("change", [{"gain": 1.001}, {"stiffer": 1.001}])
def test_other_controllers_and_telescopes_are_told(change: dict[str, float], shipped: ImplementedLoop) -> None:
    assert not compare_proof(proof_of(shipped), loop_of(**change), FIGURE).same


def test_command_refuses_the_proof_of_another_pair(
    shipped: ImplementedLoop, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    k_fsm, k_pma = load_designs("implemented")
    replace(k_fsm, C=1.001 * k_fsm.C).to_file(tmp_path / "k_fsm.json")
    k_pma.to_file(tmp_path / "k_pma.json")
    write_loop_proof(proof_of(shipped), tmp_path / "proof.npz")
    (tmp_path / "proof.json").write_text("{}")
    for file, code, told in (
        ("proof.npz", 1, f"refused: it is not for those of {tmp_path}, mismatch: "),
        ("proof.json", 2, "--designs must be given with an .npz"),
    ):
        found, _, err = call_command(capsys, "design", "check-proof", tmp_path / file, "--designs", tmp_path)
        assert found == code and told in err and err.count("\n") == 1


def test_a_stored_proof_of_the_telescope_is_readable(tmp_path: Path) -> None:
    path = unpack(FOLDER / f"fsm+pma-APE{SUFFIX}", tmp_path / "APE.npz")
    assert proof_kind(path) == LOOP
    proof = read_loop_proof(path)
    strip = max(proof.strips, key=lambda s: s.nodes[-1] / s.nodes[0] if s.nodes[0] else 0.0)
    assert windows_of(proof.model, strip, 0, proof.level)


def changes(system: SampledSystem) -> dict[str, SampledSystem]:
    """The system with each field changed, each entry of ``design_basis`` changed and left out."""
    found = {name: dataclasses.replace(system, **{name: 1.001 * getattr(system, name)}) for name in "ABCD"}
    others: dict[str, Any] = {"dt": 2.0 * system.dt, "name": "other", "provenance": {}}
    found |= {name: dataclasses.replace(system, **{name: other}) for name, other in others.items()}
    for side in ("inputs", "outputs"):
        ports = getattr(system, side)
        found[side] = dataclasses.replace(system, **{side: (Port("other", ports[0].size, ports[0].unit), *ports[1:])})
    basis = dict(system.design_basis)
    for name, value in basis.items():
        other: Any = "other" if isinstance(value, str) else 1.001 * value
        found[f"basis {name}"] = dataclasses.replace(system, design_basis={**basis, name: other})
        without = {key: entry for key, entry in basis.items() if key != name}
        found[f"no {name}"] = dataclasses.replace(system, design_basis=without)
    return found


def acts(k_fsm: SampledSystem, k_pma: SampledSystem) -> list[list[Any]]:
    """All numbers of the laws of each stage, with another sensitivity of the telescope than that of the file."""
    found = []
    for stage in MIRROR_STAGES:
        for law in ControlLaws(k_fsm, k_pma, stage, loop_rows(), 0.2).laws:
            parts = [getattr(law.system, name).tolist() for name in "ABCD"]
            found.append([*parts, law.system.dt, law.gain, law.measured, law.command])
    return found


@pytest.mark.parametrize("number", [0, 1])
def test_each_field_changes_the_digest_or_not_the_law(number: int) -> None:
    pair = list(load_designs("implemented"))
    own, before = law_digest(pair[number]), acts(*pair)
    fields = {entry.name for entry in dataclasses.fields(SampledSystem) if entry.init}
    tried = changes(pair[number])
    assert {name.split()[-1] for name in tried} >= (fields - {"design_basis"}), "each field is changed"
    for name, other in tried.items():
        if law_digest(other) == own:
            assert acts(*(other if k == number else system for k, system in enumerate(pair))) == before, name
    assert law_digest(tried["name"]) == law_digest(tried["provenance"]) == own
    assert law_digest(tried["basis los_sensitivity"]) != own != law_digest(tried["no los_sensitivity"])


def test_matrices_of_other_shapes_have_other_digests() -> None:
    """The same bytes as A and B of other sizes."""
    A = np.zeros((1, 1))
    one = SampledSystem(A, [[1.0, 2.0]], [[3.0]], [[4.0, 5.0]], (Port("u", 2),), (Port("y", 1),), 1.0)
    two = SampledSystem(A, [[1.0]], [[2.0], [3.0]], [[4.0], [5.0]], (Port("u", 1),), (Port("y", 2),), 1.0)
    assert law_digest(one) != law_digest(two)


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


def test_each_field_of_a_model_changes_the_name_of_its_parts(shipped: ImplementedLoop) -> None:
    """Period, hold and channels too: parts of a proof that are kept are found by this name."""
    model, box = proof_of(shipped).model, box_of(shipped)
    own = model_digest(model, box)
    assert len(own) == 64 and model.dt == DT
    assert model_digest(model, (*box[:-1], (0.0, 1.0))) != own
    for field in dataclasses.fields(model):
        value = getattr(model, field.name)
        other: Any = value * 2 if isinstance(value, np.ndarray) else (value, 1)
        assert model_digest(dataclasses.replace(model, **{field.name: other}), box) != own, field.name


FALSE_LINES = "k in [8, 12]\nproven: gain below 1e-09 at all frequencies from 0 rad/s on\nproven: stable\nfor all k"
OVERWRITTEN = "x\r\x1b[1A\x1b[2Kof the shipped controllers and telescope: the loop was rebuilt"


def ended(capsys: pytest.CaptureFixture[str], file: Path) -> tuple[int, str, list[str]]:
    """Exit code, output and lines of errors of the check of a file."""
    code, out, err = call_command(capsys, "design", "check-proof", file)
    return code, out, err.splitlines()


def test_names_of_a_system_are_no_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A proof that passes, whose parameter has the name of what would be proven."""
    system = (1 / (s**2 + 1.8 * s + real("k", 10, percent=20))).system("u", "y")
    found = worst_case_gain(system, band=(0.0, 5.0)).proof
    assert found is not None
    own = json.dumps(found.content)
    for name, expected in (("k", 0), (FALSE_LINES, 2), ("k\x1b[8m", 2), ("k\u2028proven: stable", 2)):
        content = json.loads(own.replace('"k"', json.dumps(name)))
        (tmp_path / "proof.json").write_text(json.dumps({**content, "sha256": digest_of(content)}))
        code, out, lines = ended(capsys, tmp_path / "proof.json")
        assert (code, len(lines), not out) == (expected, int(expected > 0), expected > 0)
        assert all("names of a proof must have no control characters" in line for line in lines)


@pytest.mark.parametrize("where", ["value", "key", "name"])
def test_words_of_a_loop_are_no_lines(where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    proof = read_loop_proof(unpack(FOLDER / f"fsm+pma-fast, 126 to 128.5{SUFFIX}", tmp_path / "own.npz"))
    if where == "name":
        proof = replace(proof, names=(OVERWRITTEN, *proof.names[1:]))
    else:
        proof = replace(proof, about={"stage": OVERWRITTEN} if where == "value" else {OVERWRITTEN: 1.0})
    write_loop_proof(proof, tmp_path / "other.npz")
    code, out, lines = ended(capsys, tmp_path / "other.npz")
    assert code == 2 and out == "" and len(lines) == 1 and lines[0].isprintable()
    assert "names and description of a proof must have no control characters" in lines[0]


def test_a_refusal_is_one_line_whatever_the_file_has_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "proof.json").write_text(json.dumps({"format": "lftkit proof 2", "kind": FALSE_LINES}))
    code, out, lines = ended(capsys, tmp_path / "proof.json")
    assert code == 2 and out == "" and len(lines) == 1 and lines[0].isprintable() and "the header must be" in lines[0]


def test_ordinary_letters_and_spaces_are_plain() -> None:
    require_plain({"name": ["Antenne Süd, Δθ = 3\N{NO-BREAK SPACE}mrad", 1.0, None]}, "names")
    for text in ("a\tb", "a\x7f", "a\u202eb", "a\u2029b"):
        with pytest.raises(ProofFileError, match="names must have no control characters"):
            require_plain([{text: 0}], "names")
