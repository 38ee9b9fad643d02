"""A sample of the mutations of ``benchmarks/bundle_fuzz.py``, with a proof of one window band that ships."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from support.scripts import script

from lftkit.proofs.trusted import sampled_loop
from los_design.synthesis.store import load_designs
from los_design.verification import bundle as bundles
from los_design.verification.bundle import write_bundle
from los_design.verification.shipped_proofs import FOLDER, SUFFIX, unpack
from titop_plant.telescope.load import load_telescope

fuzz = script(Path(__file__).parents[3] / "benchmarks" / "bundle_fuzz.py")

STAGE, FIGURE = "fsm+pma", "fast, 126 to 128.5"
NAME = bundles.member_of(STAGE, FIGURE)
PATCHED = ((sampled_loop, ["stable_below"]), (bundles, ["provable_open_loop"]))
"""What the script replaces."""


@pytest.mark.further
def test_no_mutation_is_accepted_with_another_statement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A proof of a wider box states the same, or another level that is proven: the box is that of the telescope."""
    for place, names in PATCHED:
        for name in names:
            monkeypatch.setattr(place, name, getattr(place, name))  # put back at the end
    monkeypatch.chdir(tmp_path)
    proof = unpack(FOLDER / f"{STAGE}-{FIGURE}{SUFFIX}", tmp_path / "proof.npz")
    write_bundle(tmp_path / "bundle.zip", load_telescope(), load_designs("implemented"), {(STAGE, FIGURE): proof})
    each, members = fuzz.remember(), fuzz.members_of(tmp_path / "bundle.zip")
    with fuzz.open_bundle(tmp_path / "bundle.zip") as bundle:
        own = fuzz.stated(fuzz.check_bundle(bundle, each))
    chance, found = random.Random(1), set()
    for _ in range(3):
        wider = {**members, NAME: fuzz.wider_box(members[NAME], chance)}
        fuzz.written(wider, tmp_path / "wider.zip")
        found.add(fuzz.outcome(tmp_path / "wider.zip", own, each))
    assert "FORGED" not in found and found & {"same", "proven"}
    counts = fuzz.attacked(tmp_path / "bundle.zip", 15, 5, each, tmp_path / "mutated.zip")
    outcomes = {found for _, found in counts}
    assert {"refused", "same"} <= outcomes <= {"refused", "same", "subject", "wording", "proven", "fewer"}
