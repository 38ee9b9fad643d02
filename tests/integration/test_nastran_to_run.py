"""A payload that goes through NASTRAN files runs as the payload itself, to the single precision of the files."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "nastran_payload_to_run.py"


def test_the_reference_payload_through_nastran_files(tmp_path: Path) -> None:
    pytest.importorskip("pyNastran", reason="extra nastran")
    example = runpy.run_path(str(EXAMPLE))
    imported = example["main"](tmp_path / "imported", [], duration=2.0)
    direct = example["judged"](tmp_path / "direct", 2.0)
    assert imported.ticks == direct.ticks == 2000
    assert imported.ape_max == pytest.approx(direct.ape_max, rel=1e-5)
    assert imported.rpe_rms == pytest.approx(direct.rpe_rms, rel=1e-5)
