"""A compiled flight library in the places of the designs: the bits of the testbed, and libraries that do not fit."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.flight.laws import laws_of
from los_testbed.parts.flight_library import LibraryLaw
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.replay import controllers, drive, write_bag
from support.flight_library import LIBRARY, build, write

from lftkit.errors import InputError
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.run import Run
from pointing_analysis.replay.replay import compare

BAG = Path(__file__).parents[2] / "bags/reference"

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(write(laws_of(), tmp_path_factory.mktemp("flight") / "shipped", LIBRARY), "gcc", "-O2")


@pytest.mark.further
def test_a_run_with_the_library_is_that_of_the_designs(library: Path, tmp_path: Path) -> None:
    config = RunConfig(mode="inprocess", duration=1.0, loop="fsm+pma", scenario="worst_case", seed=3)
    run_in_process(config, tmp_path / "files")
    run_in_process(replace(config, k_fsm=str(library), k_pma=str(library)), tmp_path / "library")
    files, library_run = Run.open(tmp_path / "files"), Run.open(tmp_path / "library")
    for name in files.topics:
        assert np.array_equal(files[name].values, library_run[name].values, equal_nan=True), name
    assert library_run.parameters["k_fsm"] == str(library)
    assert len(library_run.parameters["k_fsm_source_sha256"]) == 64, "of the library"
    for name in ("k_fsm", "k_pma"):
        stated = library_run.parameters[f"{name}_tables_sha256"]
        assert len(stated) == 64 and stated in (library.parent / f"{name}.c").read_text()


def test_a_replay_through_the_library_is_identical(library: Path) -> None:
    """From the recorded states, which a library of the same order takes."""
    run = Run.open(BAG)
    through = controllers(run, library, library)
    found = compare(run, drive(run, through, lambda done, total: None))
    assert found.identical and not through.as_recorded and set(through.files) == {"k_fsm.so", "k_pma.so"}


@pytest.mark.parametrize("setting", ["k_fsm", "k_pma"])
def test_libraries_that_do_not_fit_are_refused_in_one_line(library: Path, tmp_path: Path, setting: str) -> None:
    (tmp_path / "text.so").write_text("no library")
    with pytest.raises(InputError, match=f"{setting} .* must be a shared library for this processor, got [^\n]*$"):
        LibraryLaw(tmp_path / "text.so", setting)
    folder = tmp_path / "other"
    shutil.copytree(library.parent, folder)
    header = (folder / "los_flight.h").read_text()
    (folder / "los_flight.h").write_text(header.replace(f"los_{setting}_sizes", f"los_{setting}_other"))
    for unit in ("k_fsm", "k_pma"):
        file = folder / f"{unit}.c"
        file.write_text(file.read_text().replace(f"los_{setting}_sizes", f"los_{setting}_other"))
    with pytest.raises(InputError, match=f"got none of los_{setting}_sizes$"):
        LibraryLaw(build(folder, "gcc", "-O0"), setting)


def test_the_state_of_another_order_is_refused(library: Path) -> None:
    law = LibraryLaw(library, "k_pma")
    with pytest.raises(InputError, match="state must have shape"):
        law.reset(np.zeros(law.order + 1))


def test_the_bag_of_a_replay_holds_the_library_and_not_the_recorded_designs(library: Path, tmp_path: Path) -> None:
    """Else a replay of that bag would be through other controllers than those that made it."""
    run = Run.open(BAG)
    through = controllers(run, library, library)
    write_bag(tmp_path / "new", run, drive(run, through, lambda done, total: None), through)
    new = Run.open(tmp_path / "new")
    assert set(new.attachments) == {"k_fsm.so", "k_pma.so", "run.yaml", "start.json"}
    assert new.attachments["k_fsm.so"] == library.read_bytes()
    with pytest.raises(BagError, match=r"must hold the controller k_fsm.json, got k_fsm.so, .*: give --k-fsm FILE"):
        controllers(new)
