"""One check for proofs of every kind: what it loads, which files pass, and what is changed in cells is refused."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import linalg
from support.forged_proofs import forged
from support.trusted_code import CHECKERS, file_of, imported_by
from support.uncertain_examples import aligned_modes, chain_of_masses, de_gaston_safonov

from lftkit import proofs, real, s
from lftkit.proofs import BoundOptions, ProofError, check_proof, robust_performance, robust_stability, worst_case_gain
from lftkit.proofs.axis.proof import AxisProof
from lftkit.proofs.checking import KINDS, proof_kind
from lftkit.proofs.state_space.proof import Proof
from lftkit.proofs.trusted.arithmetic import Ball, definite_ratio, exact_product
from lftkit.proofs.trusted.proof import uncovered

STORED = Path(__file__).parents[3] / "fixtures" / "proofs"
LONG = BoundOptions(wall_limit=3600.0)
PROVERS = (
    "axis.bounds",
    "robustness",
    "state_space",
    *(f"sampled_loop.{name}" for name in ("bounds", "build", "scalings")),
)


def test_a_check_loads_nothing_of_what_finds_proofs() -> None:
    code = (
        "import sys, lftkit.proofs.checking\n"
        "print(*sorted(m[len('lftkit.proofs.'):] for m in sys.modules if m.startswith('lftkit.proofs.')))\n"
        "print(any(m.startswith(('scipy.optimize', 'lftkit.analysis', 'lftkit.tuning')) for m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    loaded, others = done.stdout.splitlines()
    assert not any(name.startswith(PROVERS) for name in loaded.split()) and "trusted.axis" in loaded.split()
    assert others == "False"
    files = [Path(proofs.__file__).parent / name.replace(".", "/") for name in PROVERS]
    assert all(file.is_dir() or file.with_suffix(".py").exists() for file in files), "a prover has another name now"


def test_the_proof_of_bounds_passes_as_object_content_and_file(tmp_path: Path) -> None:
    few, many = aligned_modes(1, damping=0.05), chain_of_masses(4, 0.1)
    cells, strips = (worst_case_gain(system, options=LONG) for system in (few, many))
    assert isinstance(cells.proof, Proof) and isinstance(strips.proof, AxisProof)
    for number, bounds in enumerate((cells, strips)):
        path = tmp_path / f"{number}.proof"
        bounds.proof.to_file(path)
        for what in (bounds.proof, (path, str(path))[number]):
            assert check_proof(what).level == bounds.upper
        assert proof_kind(path) == ("cells", "axis")[number] in KINDS
    assert check_proof(cells.proof.content).stable


@pytest.mark.parametrize(
    ("name", "level", "stable"),
    [
        ("axis.npz", 5.278047045285301, True),
        ("cells.json", 5.278047045285301, True),
        ("discrete.json", 1.7416666666666665, True),
        ("loop.npz", 5.3, False),
        ("stable.json", None, True),
    ],
)
def test_stored_files_prove_what_they_proved(name: str, level: float | None, stable: bool) -> None:
    checked: Any = check_proof(STORED / name)
    assert (checked.level, checked.stable) == (level, stable)
    box = {"p": (0.3, 0.7)} if name == "discrete.json" else {"p": (-1.0, 1.0)}
    assert (checked.box if isinstance(checked.box, dict) else dict(zip(checked.names, checked.box))) == box
    assert checked.band == ((0.0, np.inf) if not name.startswith(("loop", "discrete")) else (0.0, 10.0 * np.pi))


def test_a_stored_proof_of_noise_proves_what_it_proved() -> None:
    checked: Any = check_proof(STORED / "noise.npz")
    assert (checked.absolute.rms, checked.absolute.along) == pytest.approx((10.60660172841012, 7.5000000075037505))


NO_PROOFS = (b"", b"{}", b'{"format": "other"}', b"PK\x03\x04", b"\x00\xff", b"[1]")


@pytest.mark.parametrize("what", [*NO_PROOFS, None, 3, Path("/nowhere/proof.json"), {}, {"format": "other"}])
def test_what_is_no_proof_is_refused(what: object, tmp_path: Path) -> None:
    """Content of files, and other objects."""
    if isinstance(what, bytes):
        (tmp_path / "proof").write_bytes(what)
        what = tmp_path / "proof"
    with pytest.raises(ProofError):
        check_proof(what)


@pytest.mark.further
def test_stability_by_size() -> None:
    few, many = robust_stability(aligned_modes(1, 0.05)), robust_stability(chain_of_masses(4, 0.3, damping=0.2))
    assert isinstance(few.proof, Proof) and isinstance(many.proof, AxisProof)
    assert many.upper == pytest.approx(1.0 / 0.3, rel=1e-4) and many.upper <= 1.05 * many.lower
    for bounds in (few, many):
        assert check_proof(bounds.proof).stable


@pytest.mark.further
def test_without_inputs_performance_is_stability() -> None:
    bare = chain_of_masses(4, 0.3, damping=0.2).select(inputs=())
    bounds = robust_performance(bare, level=1.0)
    assert bounds.upper == pytest.approx(1.0 / 0.3, rel=1e-4) and check_proof(bounds.proof).kind == "stability"


@pytest.mark.further
def test_robust_performance_of_a_spring_by_hand() -> None:
    """Velocity over force at the resonance is 1 / (2 damping) whatever the stiffness; position has 1 / (2 zeta w^2)."""
    system = chain_of_masses(1, 0.2, damping=0.1)  # peak 1 / (c sqrt(k - c^2 / 4))
    stiffness = 0.0025 + (1.0 / (0.1 * 11.0)) ** 2  # where the peak is 11
    bounds = robust_performance(system, level=11.0, options=LONG)
    assert bounds.status == "closed" and bounds.upper == pytest.approx((1.0 - stiffness) / 0.2, rel=1e-4)
    assert bounds.lower <= bounds.upper <= 1.05 * bounds.lower
    checked: Any = check_proof(bounds.proof)
    assert checked.level == 11.0 and checked.box["k0"][0] == pytest.approx(1.0 - 0.2 * bounds.lower)
    free = robust_performance(system, level=30.0, largest=1.5, options=LONG)
    assert free.status == "closed" and free.lower == 1.5 and free.upper == np.inf
    nominal = robust_performance(system, level=9.0, options=LONG)
    assert nominal.status == "violated" and nominal.upper == 0.0 and nominal.proof is None


def test_robust_performance_needs_a_stable_nominal_member_in_the_box() -> None:
    p = real("p", 0.0, plus_minus=0.5)
    with pytest.raises(ValueError, match="nominal member must be stable, got an unstable one"):
        robust_performance((1 / (s - 1 + p)).system("u", "y"))
    with pytest.raises(ValueError, match="box must contain the nominal values"):
        robust_performance((1 / (s + 1 + p)).system("u", "y"), 2.0, {"p": (0.1, 0.2)})


def test_the_checks_import_only_their_own_package() -> None:
    folder = file_of(CHECKERS[0]).parent
    files = imported_by(*CHECKERS)
    assert files == {path for path in folder.glob("*.py") if path.name != "__init__.py"}, "and all of it is used"
    for path in files:
        lines = [line for line in path.read_text("utf-8").splitlines() if "lftkit." in line and "import" in line]
        assert all(line.lstrip().startswith("from lftkit.proofs.trusted.") for line in lines), "for types neither"


def test_what_runs_is_what_is_counted() -> None:
    """Modules of lftkit that a process has loaded when it can check, but for empty ones of packages."""
    code = f"import sys, {', '.join(CHECKERS)}; print(*(m for m in sys.modules if m.startswith('lftkit.')))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    allowed = {path.resolve() for path in imported_by(*CHECKERS)} | {file_of("lftkit.support.on_demand").resolve()}
    assert {f for m in loaded if (f := file_of(m).resolve()) not in allowed and f.name != "__init__.py"} == set()


Content = dict[str, Any]


@pytest.fixture(scope="module")
def proof() -> Content:
    bounds = worst_case_gain(aligned_modes(2, damping=0.02), options=BoundOptions(wall_limit=3600.0))
    assert bounds.proof is not None and bounds.proof.cells > 2 and check_proof(bounds.proof).margin >= 1.0
    return bounds.proof.content


def test_a_change_without_a_new_digest_is_refused(proof: Content) -> None:
    content = {**proof, "cells": [{**proof["cells"][0], "performance": 1.0}, *proof["cells"][1:]]}
    with pytest.raises(ProofError, match="SHA-256"):
        check_proof(content)


def damages(number: int, cell: Content) -> tuple[tuple[Callable[[Content], object], str], ...]:
    low, high = cell["band"]
    wide = [0.9 * low, None if high is None else 1.1 * high]
    return (
        (lambda c: c["cells"].pop(number), "hole"),
        (lambda c: c["cells"][number].update(band=wide), "overlap"),
        (lambda c: c.update(cells=[{**cell, "band": [0.0, None]}]), "inequality"),
    )


def test_no_cell_can_be_left_out_or_widened_or_replace_the_others(proof: Content) -> None:
    for number, cell in enumerate(proof["cells"]):
        for change, reason in damages(number, cell):
            with pytest.raises(ProofError, match=reason):
                check_proof(forged(proof, change))


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c["claim"].update(level=0.94 * c["claim"]["level"]),  # the gain reaches 50
        lambda c: c["cells"][0].update(performance=-1.0),
        lambda c: c["cells"][0]["P"][0][0].__setitem__(0, -1.0),
        lambda c: c["cells"][1]["D"]["k0"][0][0].__setitem__(0, 0.0),
        lambda c: c["cells"][1].update(D={**c["cells"][1]["D"], "k0": [[[1e6]], [[0.0]]]}),
        lambda c: c["plant"]["A"][1].__setitem__(1, -0.03),  # less damping
        lambda c: c["claim"]["box"].update(k0=[0.8, 2.7]),
        lambda c: c["stable"]["point"].__setitem__(0, 9.0),
        lambda c: c["stable"]["L"][0].__setitem__(0, float("inf")),
        lambda c: c["cells"][0].pop("Q"),
        lambda c: c["cells"][0]["Q"][0][0].__setitem__(0, float("nan")),
        lambda c: c.update(claim={**c["claim"], "property": "stability", "level": None}, stable=None),
        lambda c: c["claim"].update(property="stability"),
        lambda c: c["claim"].update(level=None),
        lambda c: c["cells"].clear(),
    ],
)
def test_what_is_altered_is_refused_even_with_a_new_digest(proof: Content, change: Callable[[Content], None]) -> None:
    with pytest.raises(ProofError):
        check_proof(forged(proof, change))


def test_a_proof_of_stability_does_not_hold_for_an_unstable_box() -> None:
    proof = robust_stability(de_gaston_safonov(), options=BoundOptions(wall_limit=3600.0)).proof
    assert proof is not None

    def larger(content: Content) -> None:
        box = content["claim"]["box"]
        for owner in [box, *(dict(zip(box, c["intervals"])) for c in content["cells"])]:
            for ends in owner.values():
                ends[:] = [3.42 / 3.27 * end for end in ends]

    with pytest.raises(ProofError, match="inequality"):
        check_proof(forged(proof.content, larger))


def test_the_rounding_bound_of_a_product_covers_the_exact_one() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        a, b = (rng.normal(size=(6, 6)) * np.exp(rng.normal(size=(6, 6)) * 8.0) for _ in range(2))
        exact, rounded = exact_product(a, b), Ball(a) @ Ball(b)
        assert np.all(np.abs(exact.mid - rounded.mid) <= rounded.rad + exact.rad)


def test_a_matrix_that_is_not_certainly_definite_fails() -> None:
    rng = np.random.default_rng(4)
    for n in (2, 5, 12):
        basis = linalg.qr(rng.normal(size=(n, n)))[0]
        eigenvalues = np.linspace(1.0, 2.0, n)
        for least, passes in ((1e-3, True), (1e-17, False), (-1e-12, False)):
            matrix = basis @ np.diag([least, *eigenvalues[1:]]) @ basis.T
            assert (definite_ratio(Ball(matrix)) >= 1.0) is passes
        certain = basis @ np.diag(eigenvalues) @ basis.T
        assert definite_ratio(Ball(certain, np.full((n, n), 1.1 / n))) == 0.0  # the bound of the error is too large


def test_coverage_finds_a_hole_of_any_size() -> None:
    box = [(0.0, 1.0), (0.0, np.inf)]
    cells = [[(0.0, 1.0), (0.0, 1.0)], [(0.0, 0.5), (1.0, np.inf)], [(0.5, 1.0), (1.0, np.inf)]]
    assert uncovered(box, cells) is None
    assert uncovered([(0.3, 0.3), (0.0, np.inf)], cells) is None
    cells[2] = [(np.nextafter(0.5, 1.0), 1.0), (1.0, np.inf)]
    assert uncovered(box, cells) == [(0.5, np.nextafter(0.5, 1.0)), (1.0, np.inf)]
    assert uncovered(box, []) == box
