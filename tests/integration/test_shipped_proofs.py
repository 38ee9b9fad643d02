"""The proofs of the shipped pair: checked anew, and of the loop that ships (slow)."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.stored_proofs import halves, planes, rounded, rounded_matrices

from lftkit.analysis.eigenvectors import modal
from lftkit.proofs.sampled_loop import check_loop_proof
from lftkit.proofs.sampled_loop.files import read_loop_proof, read_noise_proof
from lftkit.proofs.trusted.noise import NoiseBound, noise_bound
from lftkit.proofs.trusted.strips import windows_of
from los_design.search.worst_points import load_worst_points
from los_design.synthesis.store import load_designs
from los_design.verification.bundle import ProofBundle, as_mapping, check_bundle, figures_proven, member_of, open_bundle
from los_design.verification.certify import nominal_stable
from los_design.verification.combined_bounds import error_sums
from los_design.verification.error_sum import PART, ErrorSum
from los_design.verification.loop_models import NYQUIST
from los_design.verification.proof_comparison import compare_proof
from los_design.verification.shipped_proofs import FOLDER, SUFFIX, unpack, unplaned, whole, write_shipped_bundle
from los_design.verification.statements import SHIPPED
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

ROOT = Path(__file__).parents[2]
WHOLE = (0.0, NYQUIST)
BAND_EDGE = 85.0
BANDS = {"APE": WHOLE, "slow": (0.0, BAND_EDGE), "fast": (BAND_EDGE, NYQUIST), "mirror": WHOLE, "force": WHOLE}
NAMES = {"slow": "RPE, slow tone", "fast": "RPE, fast tone"}
"""Figures as the page on certificates calls them, where it has another name."""


def printed_bound(figure: str) -> float:
    """Upper bound of the page's table, with both stages."""
    page = (ROOT / "docs" / "certificates.md").read_text("utf-8")
    (row,) = re.findall(rf"^\| fsm\+pma, {NAMES.get(figure, figure)} \|(.*)\|$", page, re.MULTILINE)
    return float(row.split("|")[2])


@pytest.fixture(scope="module")
def proofs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Files of the proofs by figure, as the command writes them."""
    folder = tmp_path_factory.mktemp("proofs")
    names = {figure: f"fsm+pma-{figure}" for figure in BANDS}
    return {figure: unpack(FOLDER / f"{name}{SUFFIX}", folder / f"{name}.npz") for figure, name in names.items()}


@pytest.fixture(scope="module")
def loop() -> ImplementedLoop:
    telescope = load_telescope()
    open_loop = OpenLoop(control_loop_plant(telescope), telescope, telescope.loop_ports.used_by())
    return ImplementedLoop(open_loop, *load_designs("implemented"), "fsm+pma")


@pytest.mark.parametrize("figure", BANDS)
def test_the_proof_is_of_the_loop_that_ships(figure: str, loop: ImplementedLoop, proofs: dict[str, Path]) -> None:
    """Remade by ``los-testbed design certify`` when the telescope or the controllers change."""
    proof = read_loop_proof(proofs[figure])
    assert printed_bound(figure) - 1e-4 < proof.level <= printed_bound(figure) <= 1.0, "rounded up"
    assert proof.band == pytest.approx(BANDS[figure])
    assert compare_proof(proof, loop, figure).mismatches == ()


def test_scalings_are_stored_without_a_change_but_their_rounding() -> None:
    chance = np.random.default_rng(0)
    square = chance.normal(size=(5, 3, 3)) * 10.0 ** chance.uniform(-6, 6, (5, 1, 1))
    matrices = (square + square.swapaxes(1, 2) + 1j * (square - square.swapaxes(1, 2))).astype(np.complex64)
    np.testing.assert_array_equal(whole(unplaned(planes(halves(matrices)))), matrices)
    np.testing.assert_array_equal(rounded_matrices(matrices, 23), matrices)
    for bits in (7, 16):
        coarse = rounded(matrices.real, bits)
        assert np.all(np.abs(coarse - matrices.real) <= 2.0 ** -(bits + 1) * np.abs(matrices.real))
        assert not np.any(coarse.view(np.uint32) % (1 << (23 - bits)))


def test_modal_coordinates_of_the_telescope_keep_its_responses(loop: ImplementedLoop) -> None:
    """To 1e-10 of the largest one, on any processor: the loop at 0.001 rad/s is 10^4 times as sensitive."""
    system = loop.system
    poles, B, C = modal(system.A, system.B, system.C)
    for omega in (1e-3, 0.06, 0.9, 2.8):
        direct = system.C @ np.linalg.solve(1j * omega * np.eye(len(system.A)) - system.A, system.B.astype(complex))
        np.testing.assert_allclose((C / (1j * omega - poles)) @ B, direct, rtol=0.0, atol=1e-10 * np.abs(direct).max())


@pytest.mark.slow
@pytest.mark.parametrize("figure", BANDS)
def test_the_proof_passes(figure: str, proofs: dict[str, Path]) -> None:
    checked = check_loop_proof(read_loop_proof(proofs[figure]))
    assert checked.level <= printed_bound(figure) and checked.band == pytest.approx(BANDS[figure])
    assert checked.stable == (BANDS[figure] == WHOLE), "poles above half of the sampling rate included"


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ProofBundle]:
    path = tmp_path_factory.mktemp("bundle") / "bundle.zip"
    write_shipped_bundle(path)
    with open_bundle(path) as found:
        yield found


def test_shipped_statements_are_those_of_the_stored_proofs(bundle: ProofBundle) -> None:
    said = json.loads(SHIPPED.read_text("utf-8"))
    assert said["name"] == bundle.name and said["subject"] == asdict(bundle.subject)
    for row in said["figures"]:
        assert row["level"] == bundle.proof(row["stage"], row["figure"]).level
        assert row["figure"].startswith(PART) or row["text"] in figures_proven(bundle, row["stage"])
    for stage in bundle.noise:
        proof = read_noise_proof(bundle.folder / member_of(stage, "noise"))
        for bound, window in zip(said["noise"][stage], (0.0, 0.02)):
            assert noise_bound(proof.model, proof.parts, window).rms == pytest.approx(bound["rms"], rel=1e-12)


@pytest.mark.parametrize("stage", ["fsm", "fsm+pma"])
def test_shipped_sums_are_those_of_the_shipped_bounds(stage: str) -> None:
    """Made of the stated levels and noise, for the probabilities that the reference asks for; so are their texts."""
    said, telescope = json.loads(SHIPPED.read_text("utf-8")), load_telescope()
    tones = {row["figure"]: row["level"] * row["limit"] for row in said["figures"] if row["stage"] == stage}
    absolute, relative = (NoiseBound(**bound) for bound in said["noise"][stage])
    sums = error_sums(telescope, stage, tones, (absolute, relative))
    for row, found in zip(said["sums"][stage], sums, strict=True):
        assert row["value"] == pytest.approx(found.value, rel=1e-9) and row["kept"] == found.kept
        stated = ErrorSum(row["name"], row["value"], row["limit"], row["unit"], row["probability"])
        assert row == {**asdict(stated), "text": stated.text, "kept": stated.kept}
        assert stated.probability == found.probability and (found.name, found.unit) == (row["name"], row["unit"])


def in_nine_digits(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: in_nine_digits(one) for key, one in value.items()}
    if isinstance(value, list):
        return [in_nine_digits(one) for one in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


@pytest.mark.slow
def test_the_bundle_passes_and_says_what_is_shipped(bundle: ProofBundle) -> None:
    """With the models made anew; the numbers of windows depend on the processor's rounding."""
    found, said = as_mapping(check_bundle(bundle)), json.loads(SHIPPED.read_text("utf-8"))
    for one in (found, said):
        one["figures"] = [{k: v for k, v in row.items() if k not in ("windows", "limit")} for row in one["figures"]]
        del one["box"]
    assert in_nine_digits(json.loads(json.dumps(found))) == in_nine_digits(said)


@pytest.mark.slow
def test_the_nominal_loop_is_proven_stable(loop: ImplementedLoop) -> None:
    assert nominal_stable(loop)


@pytest.mark.parametrize(
    "figure", [pytest.param(name, marks=[pytest.mark.slow] * (name in ("fast", "force"))) for name in BANDS]
)
def test_the_scalings_do_not_prove_less_than_the_worst_point(figure: str, proofs: dict[str, Path]) -> None:
    """Level 0.5 % below the largest value known: the window of its frequency is refused for some part of the box."""
    proof = read_loop_proof(proofs[figure])
    known = [p for table in load_worst_points(None).values() for p in table.values()]
    worst = max((p for p in known if (p.stage, p.requirement) == ("fsm+pma", figure)), key=lambda p: p.gamma)
    held = []
    for strip in proof.strips:
        if strip.nodes[0] <= worst.omega <= strip.nodes[-1]:
            number = min(int(np.searchsorted(strip.nodes, worst.omega)) or 1, len(strip.nodes) - 1) - 1
            held.append(windows_of(proof.model, strip, number, 0.995 * worst.gamma) > 0)
            assert windows_of(proof.model, strip, number, proof.level)
    assert not all(held)
