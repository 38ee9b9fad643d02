"""``los-testbed design check-proof`` passes a proof and refuses a changed one."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from los_testbed.cli.app import main
from support.command_line import call_command
from support.uncertain_examples import aligned_modes

from lftkit.proofs import BoundOptions, robust_stability
from los_design.verification import shipped_proofs

Content = dict[str, Any]
PROOFS = Path(__file__).parents[3] / "fixtures" / "proofs"
PLACE = shipped_proofs.FOLDER


@pytest.fixture(scope="module")
def proof() -> Content:
    bounds = robust_stability(aligned_modes(2, damping=0.02), options=BoundOptions(wall_limit=3600.0))
    assert bounds.proof is not None
    return bounds.proof.content


def test_the_command_checks_a_file(proof: Content, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "proof.json"
    for content, expected, text in (
        (proof, 0, "proven: stable"),
        ({**proof, "stable": None}, 1, "refused: the content must match"),
    ):
        path.write_text(json.dumps(content), "utf-8")
        code, out, err = call_command(capsys, "design", "check-proof", path)
        assert code == expected and text in out + err


@pytest.mark.parametrize(
    ("name", "text", "not_text"),
    [
        ("gain_of_an_unstable_system", "\nnot proven: stable", "\nproven: stable"),
        (
            "name_like_an_interval",
            'for all "stiffness in [0, 1e+09], x" in [0.8, 1.2]',
            "for all stiffness in [0, 1e+09]",
        ),
    ],
)
def test_what_a_proof_does_not_say_is_not_printed(
    name: str, text: str, not_text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A gain whose file claims no stability, of a system that is unstable; a name that continues like an interval."""
    assert main(["design", "check-proof", str(PROOFS / f"{name}.json")]) == 0
    shown = capsys.readouterr().out
    assert text in shown and not_text not in shown


def test_without_a_file_the_shipped_proofs_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of them here; where they are not installed, or damaged, one line says so."""
    (name,) = (file.name for file in shipped_proofs.FOLDER.glob("*fast, 126 to*"))
    assert len(list(shipped_proofs.FOLDER.iterdir())) == 17
    monkeypatch.setattr(shipped_proofs, "FOLDER", tmp_path)
    with pytest.raises(SystemExit, match="2"):
        main(["design", "check-proof"])
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert f"must be in {tmp_path}, got none" in line
    stored = (PLACE / name).read_bytes()
    (tmp_path / name).write_bytes(stored[:-1000])
    with pytest.raises(SystemExit, match="1"):
        main(["design", "check-proof"])
    assert capsys.readouterr().err.startswith(f"refused: {name} must be a stored proof, got ")
    (tmp_path / name).write_bytes(stored)
    assert main(["design", "check-proof"]) == 0
    assert re.search(
        r"^proven: fsm\+pma, .* of the limit, from 126 to 128.5 rad/s$", capsys.readouterr().out, re.MULTILINE
    )
    with pytest.raises(SystemExit, match="2"):
        main(["design", "check-proof", "--designs", str(tmp_path)])
