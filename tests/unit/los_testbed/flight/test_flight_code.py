"""``los-testbed export``: what is written, refused and compared."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.flight import export
from los_testbed.flight.export import c_string, provenance, render
from los_testbed.flight.laws import FlightLaws, laws_of
from los_testbed.flight.tables import UNITS, read_tables
from los_testbed.flight.vectors import VERDICTS, gate_ticks, law_ticks
from los_testbed.parts.run_parts import RunParts

import fsm_pma_controller
import los_estimator
from los_design.verification.bundle import write_bundle
from titop_plant.telescope.load import load_telescope

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def laws() -> FlightLaws:
    return laws_of()


@pytest.fixture
def without_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(export.shutil, "which", lambda name: None)


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """A folder of designs: the shipped pair."""
    folder = tmp_path / "pair"
    folder.mkdir()
    for package, name in ((los_estimator, "k_fsm"), (fsm_pma_controller, "k_pma")):
        shutil.copy(Path(str(package.__file__)).parent / f"designs/{name}.json", folder)
    return folder


def change(file: Path, key: str) -> None:
    content = json.loads(file.read_text())
    content[key][0][0] += 1e-12
    file.write_text(json.dumps(content))


def test_the_tables_are_the_numbers_of_the_designs(laws: FlightLaws, tmp_path: Path) -> None:
    files = render(laws)
    for unit in UNITS:
        (tmp_path / f"{unit}.c").write_text(files[f"{unit}.c"])
        read, stated = read_tables(tmp_path / f"{unit}.c")
        assert stated == read.sha256 == laws.tables()[unit].sha256
    read, _ = read_tables(tmp_path / "k_fsm.c")
    row = [*laws.k_fsm.A[0], *laws.k_fsm.B[0]]
    assert read.values["TABLE"][: len(row)].tolist() == row


def test_no_heap_no_recursion_no_global_state(laws: FlightLaws) -> None:
    for name, text in render(laws).items():
        if name in {f"{unit}.c" for unit in UNITS}:
            code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
            assert not re.search(r"\b(malloc|calloc|realloc|free|alloca|float|while|goto)\b", code)
            assert not re.search(r"^(static )?(double|int|los_\w+) \w+( =|;|\[)", code, re.MULTILINE)
            functions = re.findall(r"^[\w ]+?\**(\w+)\([^;]*?\)\n\{\n(.*?)^\}", code, re.MULTILINE | re.DOTALL)
            assert functions
            assert not [function for function, body in functions if re.search(rf"\b{function}\(", body)]


def test_provenance_cannot_leave_its_comment_or_its_string(laws: FlightLaws) -> None:
    nasty = 'a */ b /* c ??/ "d" \\ \n e'
    named = replace(laws, k_fsm=replace(laws.k_fsm, name=nasty, provenance={"x": nasty, "long": 1000 * "y"}))
    text = render(named)["k_fsm.c"]
    assert text.count("*/") == render(laws)["k_fsm.c"].count("*/") and "??" not in text
    literal = "".join(re.findall(r'^    "(.*)"', c_string(provenance(named.k_fsm)), re.MULTILINE))
    assert json.loads(literal.replace('\\"', '"').replace("\\\\", "\\"))["name"] == nasty


def test_the_vectors_have_every_kind_of_tick(laws: FlightLaws) -> None:
    ticks = list(law_ticks(laws))
    assert {tick.stage for tick in ticks} == {0, 1, 2, 3}
    values = [value for tick in ticks for value in (*tick.measurement, *tick.command)]
    assert any(value != value for value in values) and any(0.0 < abs(value) < 2e-308 for value in values)
    assert any(abs(value) > 1e299 for value in values)
    for gate in laws.gates():
        offers = list(gate_ticks(gate, laws.hold_ticks, laws.fade_ticks))
        assert {tick.verdict for tick in offers} == set(range(len(VERDICTS)))
        assert any(not tick.applied.any() for tick in offers[25:])  # faded out


def test_check_compares_with_the_designs(call: Call, without_compiler: None, pair: Path, tmp_path: Path) -> None:
    assert call("export", "c", "--designs", "pair", "--output", "mine")[0] == 0
    assert call("export", "check", "mine", "--designs", "pair")[0] == 0
    code, out, _ = call("export", "check", "mine", "--json")  # the shipped pair is the same
    found = json.loads(out)
    assert code == 0 and found["found"] == found["expected"] and not found["faults"]
    change(pair / "k_pma.json", "D")
    code, out, _ = call("export", "check", "mine", "--designs", "pair")
    assert code == 1 and "tables of k_pma.c differ from the designs" in out and "k_fsm.c" not in out


def test_check_finds_what_is_changed_or_no_flight_code(call: Call, without_compiler: None, tmp_path: Path) -> None:
    assert call("export", "c", "--output", "mine")[0] == 0
    unit, header = tmp_path / "mine/controller.c", tmp_path / "mine/los_flight.h"
    good = unit.read_text()
    unit.write_text(good.replace("-0x1.4", "-0x1.5", 1))
    code, out, _ = call("export", "check", "mine")
    assert code == 1 and "controller.c states" in out and "tables of controller.c differ" in out
    unit.write_text(good)
    stated = re.search(r'"([0-9a-f]{64})"', header.read_text())
    assert stated is not None
    header.write_text(header.read_text().replace(stated[1], stated[1][::-1]))
    code, out, _ = call("export", "check", "mine")
    assert code == 1 and "los_flight.h states" in out
    (tmp_path / "mine" / "gate.c").write_text("int x;\n")
    code, out, err = call("export", "check", "mine")
    assert (code, out) == (2, "") and err.count("\n") == 1 and "none" in err


def test_the_check_compares_with_what_a_bundle_of_proofs_is_about(
    call: Call, laws: FlightLaws, without_compiler: None, tmp_path: Path
) -> None:
    (tmp_path / "proof.npz").write_bytes(b"of the loop, which this command does not read")
    parts = RunParts(RunConfig())
    pair = parts.models["k_fsm"], parts.models["k_pma"]
    other = replace(pair[0], C=pair[0].C * (1 + 1e-15)), pair[1]
    for name, controllers in (("same", pair), ("other", other)):
        proofs = {("fsm", "APE"): tmp_path / "proof.npz"}
        write_bundle(tmp_path / f"{name}.zip", load_telescope(), controllers, proofs)
    assert call("export", "c", "--output", "code")[0] == 0
    code, out, _ = call("export", "check", "code", "--proof", "same.zip")
    assert code == 0 and "has the tables of the proofs in" in out
    code, out, _ = call("export", "check", "code", "--proof", "other.zip")
    assert code == 1 and "tables of k_fsm.c differ" in out
    code, _, err = call("export", "check", "code", "--proof", "proof.npz")
    assert code == 2 and err.count("\n") == 1
