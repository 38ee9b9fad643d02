"""What docs/certificates_mathematics.md states of the checks: their lines, and the premises of sampled loops."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest
from support.packages import LIBRARIES
from support.trusted_code import CHECKERS, code_lines, imported_by, lines

TESTS = Path(__file__).parents[1]
PAGE = (TESTS.parent / "docs" / "certificates_mathematics.md").read_text("utf-8")


def stated(pattern: str) -> list[int]:
    found = re.search(pattern, " ".join(PAGE.split()))
    assert found is not None, pattern
    return [int(number) for number in found.groups()]


def test_the_page_states_how_much_code_is_trusted() -> None:
    files = imported_by(*CHECKERS, packages=LIBRARIES)
    found = [len(files), lines(files), sum(map(code_lines, files))]
    assert found == stated(
        r"What is trusted is the package `lftkit/proofs/trusted`: (\d+) files, (\d+) lines, (\d+) of"
    )


def test_the_page_states_what_makes_the_model() -> None:
    """To a tenth: it is the program itself, and changes with it."""
    files = imported_by("los_design.verification.loop_models", packages=LIBRARIES)
    assert [len(files), lines(files)] == pytest.approx(
        stated(r"some (\d+) files with (\d+) lines make the model"), rel=0.1
    )


def test_each_premise_of_the_page_has_a_forged_proof() -> None:
    """The table of the page names the functions that are tried, and no others."""
    tried = runpy.run_path(str(TESTS / "unit/lftkit/proofs/test_proof_premises.py"))
    table = PAGE.split("**Premises.**")[1].split("\n\n")[1]
    named = {row.split("|")[2].strip().strip("`") for row in table.splitlines()[2:]}
    others = {"require_cover", "scalings_allowed", "negative", "proof_of_loop"}
    assert named == {function for function, _ in tried["ALONE"].values()} | others | set(tried["UNSTABLE"])
