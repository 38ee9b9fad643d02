"""``los-testbed design check-proof`` passes a proof and refuses a changed one."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from support.uncertain_examples import aligned_modes

from lftkit.proofs import robust_stability

Content = dict[str, Any]


@pytest.fixture(scope="module")
def proof() -> Content:
    bounds = robust_stability(aligned_modes(2, damping=0.02), wall_limit=3600.0)
    assert bounds.proof is not None
    return bounds.proof.content


def test_the_command_checks_a_file(proof: Content, tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    code = "import sys; from los_testbed.cli.app import main; main(sys.argv[1:])"
    for content, expected, text in (
        (proof, 0, "proven: stable"),
        ({**proof, "kind": "gain"}, 1, "refused: the content must match"),
    ):
        path.write_text(json.dumps(content), "utf-8")
        done = subprocess.run(
            [sys.executable, "-c", code, "design", "check-proof", str(path)],
            capture_output=True,
            text=True,
            timeout=250,
        )
        assert done.returncode == expected and text in done.stdout + done.stderr
