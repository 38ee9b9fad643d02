"""Texts in files of proofs do not look like lines of their check: refused with exit code 2, one line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from los_testbed.cli.app import main

from lftkit import real, s
from lftkit.proofs import worst_case_gain
from lftkit.proofs.sampled_loop.files import read_loop_proof, write_loop_proof
from lftkit.proofs.trusted.cells import digest
from lftkit.proofs.trusted.proof import ProofFileError
from los_design.verification.check_proof_texts import require_plain
from los_design.verification.shipped_proofs import FOLDER, SUFFIX, unpack

FORGED = "k in [8, 12]\nproven: gain below 1e-09 at all frequencies from 0 rad/s on\nproven: stable\nfor all k"
OVERWRITTEN = "x\r\x1b[1A\x1b[2Kof the shipped controllers and telescope: the loop was rebuilt"


def ended(capsys: pytest.CaptureFixture[str], file: Path) -> tuple[int, str, list[str]]:
    """Exit code, output and lines of errors of the check of a file."""
    code = 0
    try:
        main(["design", "check-proof", str(file)])
    except SystemExit as stopped:
        code = int(stopped.code or 0)
    told = capsys.readouterr()
    return code, told.out, told.err.splitlines()


def test_names_of_a_system_are_no_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A proof that passes, whose parameter has the name of what would be proven."""
    system = (1 / (s**2 + 1.8 * s + real("k", 10, percent=20))).system("u", "y")
    found = worst_case_gain(system, band=(0.0, 5.0)).proof
    assert found is not None
    own = json.dumps(found.content)
    for name, expected in (("k", 0), (FORGED, 2), ("k\x1b[8m", 2), ("k\u2028proven: stable", 2)):
        content = json.loads(own.replace('"k"', json.dumps(name)))
        (tmp_path / "proof.json").write_text(json.dumps({**content, "sha256": digest(content)}))
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
    (tmp_path / "proof.json").write_text(json.dumps({"format": "lftkit proof 2", "kind": FORGED}))
    code, out, lines = ended(capsys, tmp_path / "proof.json")
    assert code == 2 and out == "" and len(lines) == 1 and lines[0].isprintable() and "the header must be" in lines[0]


def test_ordinary_letters_and_spaces_are_plain() -> None:
    require_plain({"name": ["Antenne Süd, Δθ = 3\N{NO-BREAK SPACE}mrad", 1.0, None]}, "names")
    for text in ("a\tb", "a\x7f", "a\u202eb", "a\u2029b"):
        with pytest.raises(ProofFileError, match="names must have no control characters"):
            require_plain([{text: 0}], "names")
