"""A payload that goes through NASTRAN files runs as the payload itself, to the single precision of the files."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.nastran_deliveries import Delivery, write_deck, write_superelement
from unit.titop_plant.test_nastran_decks import scaled

from titop_plant.nastran import read_nastran_matrices
from titop_plant.structures import write_modal_data
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.bodies import payload_frame
from titop_plant.telescope.load import load_telescope

EXAMPLE = Path(__file__).parents[2] / "examples" / "nastran_payload_to_run.py"


@pytest.mark.further
def test_the_reference_payload_through_nastran_files(tmp_path: Path) -> None:
    pytest.importorskip("pyNastran", reason="extra nastran")
    example = runpy.run_path(str(EXAMPLE))
    imported = example["main"](tmp_path / "imported", [], duration=2.0)
    direct = example["judged"](tmp_path / "direct", 2.0)
    assert imported.ticks == direct.ticks == 2000
    assert imported.ape_max == pytest.approx(direct.ape_max, rel=1e-5)
    assert imported.rpe_rms == pytest.approx(direct.rpe_rms, rel=1e-5)


def test_a_deck_without_the_ports_ends_the_example_with_code_2_and_one_line(tmp_path: Path) -> None:
    pytest.importorskip("pyNastran", reason="extra nastran")
    (tmp_path / "x.bdf").write_text("GRID,1\n")
    command = [sys.executable, str(EXAMPLE), str(tmp_path / "x.bdf"), str(tmp_path / "x.op2")]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stdout) == (2, "")
    assert found.stderr.startswith(f"error: {tmp_path / 'x.bdf'}: ") and found.stderr.count("\n") == 1


def test_the_reference_payload_as_a_superelement_in_millimetres(tmp_path: Path) -> None:
    """In tonnes and millimetres, reduced to its five points and 60 component modes: the first modes of the telescope's
    payload are the same, and the mass is."""
    pytest.importorskip("pyNastran", reason="extra nastran")
    points = ("I_p", "M1", "M2", "DET", "I_f")
    delivery = Delivery(scaled(payload_frame(load_telescope()).divided(), 1e-3, 1e3))
    write_deck(delivery, tmp_path / "payload.bdf")
    write_superelement(delivery, tmp_path / "payload.pch", dict.fromkeys(points, "123456"), 60)
    parent, *ports = ((name, delivery.grid(name)) for name in points)
    files = tmp_path / "payload.pch", tmp_path / "payload.bdf"
    body = read_nastran_matrices(
        *files, name="payload", parent=parent, ports=dict(ports), units="mm-t-s", damping=0.003, n_modes=36
    )
    write_modal_data(body, tmp_path / "payload.toml")
    (tmp_path / "telescope.toml").write_text('base = "reference"\n[payload]\nmodal_data = "payload.toml"\n', "utf-8")
    found, reference = (assembled_telescope(load_telescope(file)) for file in (tmp_path / "telescope.toml", ""))
    mine, theirs = (next(b for b in one.bodies if b.name == "payload") for one in (found, reference))
    assert mine.mass == pytest.approx(theirs.mass, rel=1e-8)
    ratio = mine.frequencies[:20] / theirs.frequencies[:20]
    assert 1.0 - 1e-7 <= ratio.min() <= ratio.max() <= 1.005  # from above, by Ritz
    np.testing.assert_allclose(found.rigid_mass, reference.rigid_mass, atol=1e-7 * np.abs(reference.rigid_mass).max())
