"""A proof is of the loop that it names, or the comparison says what is another one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli.app import main

from lftkit.proofs.checking import proof_kind
from lftkit.proofs.sampled_loop import LoopModel, LoopProof
from lftkit.proofs.sampled_loop.files import LOOP, read_loop_proof, write_loop_proof
from lftkit.proofs.trusted.strips import windows_of
from los_design.synthesis.store import load_designs
from los_design.verification.loop_models import box_of, figures_of, telescope_model
from los_design.verification.proof_comparison import compare_proof
from los_design.verification.shipped_proofs import FOLDER, SUFFIX, unpack
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

FIGURE = "slow"


def loop_of(gain: float = 1.0, stiffer: float = 1.0) -> ImplementedLoop:
    """The shipped loop, with another gain of K_FSM or another isolator."""
    stiffness = [stiffer * k for k in load_telescope().isolator.stiffness]
    telescope = load_telescope().changed({"isolator": {"stiffness": stiffness}})
    k_fsm, k_pma = load_designs("implemented")
    system = control_loop_plant(telescope)
    return ImplementedLoop(OpenLoop(system, telescope), replace(k_fsm, C=gain * k_fsm.C), k_pma, "fsm+pma")


def proof_of(loop: ImplementedLoop, level: float = 0.99, figure: str = FIGURE) -> LoopProof:
    """Without its strips, which a comparison does not look at."""
    metric = figures_of(loop.telescope, loop.stage)[figure]
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
    assert compare_proof(replace(proof, box=((0.99 * low, high), *proof.box[1:])), shipped, FIGURE).mismatches == (
        "box of the parameters",
    )
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
    for file, code in (("proof.npz", 1), ("proof.json", 2)):
        with pytest.raises(SystemExit) as ended:
            main(["design", "check-proof", str(tmp_path / file), "--designs", str(tmp_path)])
        assert ended.value.code == code
    refused, mistake = capsys.readouterr().err.strip().splitlines()
    assert refused.startswith(f"refused: it is not for those of {tmp_path}, mismatch: ")
    assert "--designs must be given with an .npz" in mistake


def test_a_stored_proof_of_the_telescope_is_readable(tmp_path: Path) -> None:
    path = unpack(FOLDER / f"fsm+pma-APE{SUFFIX}", tmp_path / "APE.npz")
    assert proof_kind(path) == LOOP
    proof = read_loop_proof(path)
    strip = max(proof.strips, key=lambda s: s.nodes[-1] / s.nodes[0] if s.nodes[0] else 0.0)
    assert windows_of(proof.model, strip, 0, proof.level)
