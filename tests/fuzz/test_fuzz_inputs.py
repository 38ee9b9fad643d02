"""Command lines and text files of any content: an exit code of the table, one line, nothing left behind."""

from __future__ import annotations

import contextlib
import io
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from fuzz.fuzz_profile import examples
from hypothesis import given
from hypothesis import strategies as st
from los_testbed.cli import app as cli
from support.simple_telescope import write_controllers

from pointing_analysis.read import Run
from pointing_analysis.synthetic import write_bag

CODES = {0, 1, 2, 3, 130}
LIMIT_S = 20.0
ODD = st.one_of(
    st.none(), st.booleans(), st.integers(-(10**400), 10**400), st.floats(), st.text(max_size=20),
    st.sampled_from(["[x]", "[/]", "\0", "../x", "nan", "1e999", "", " ", "\u202e", "x" * 400]),
)  # fmt: skip
VALUES = st.recursive(
    ODD, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4)
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("inputs")
    write_controllers(made)
    los = np.random.default_rng(0).standard_normal((1500, 2)) * 1e-8
    write_bag(made / "bag", {"truth/los": los}, parameters={"loop": "fsm"})
    (made / "work").mkdir()
    return made


def called(folder: Path, arguments: list[str]) -> tuple[int, str]:
    """Exit code and error output of a command; it must not leave anything in the temporary folder."""
    before, start_time = set(os.listdir(tempfile.gettempdir())), time.monotonic()
    out, err, here = io.StringIO(), io.StringIO(), Path.cwd()
    os.chdir(folder / "work")
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                code = cli.main(arguments)
            except SystemExit as stop:
                code = int(stop.code or 0)
    finally:
        os.chdir(here)
    assert time.monotonic() - start_time < LIMIT_S
    left = {name for name in set(os.listdir(tempfile.gettempdir())) - before if name.startswith("los_testbed")}
    assert not left
    return code, err.getvalue()


def check(code: int, err: str) -> None:
    assert code in CODES
    assert "Traceback" not in err and "unexpected" not in err
    if code == 2:
        assert err.startswith("los-testbed: ") or "warning: " in err


OPTIONS = {
    "run": ["--duration", "--camera-rate", "--seed", "--domain", "--theta", "--set", "--loop", "--case", "--sample",
            "--config", "--k-fsm", "--parameters", "--omega-1", "--ramp-duration"],
    "report": ["--transient", "--start", "--stop", "--namespace", "--max-chunk", "--requirements"],
    "replay": ["--transient", "--timeout", "--domain", "--loop", "--k-fsm", "--max-chunk"],
    "bag repair": ["--max-chunk", "--output"],
    "design verify": ["--samples"],
    "plant": ["--parameters"],
}  # fmt: skip
TEXTS = st.one_of(
    st.sampled_from(["nan", "inf", "-inf", "1e308", "-1", "0", "9" * 400, "[x]", "[/red]", "a=b", "seed=[[", "../..",
                     "\u0000", "", " ", "none", "seed=.inf", "x" * 300, "--", "wheel_speed={a: [1]}"]),
    st.floats().map(str), st.integers().map(str),
    st.text(max_size=30).filter(lambda text: "\0" not in text and text.isprintable()),
)  # fmt: skip


@given(data=st.data())
@examples(40)
def test_any_command_line(folder: Path, data: st.DataObject) -> None:
    command = data.draw(st.sampled_from(sorted(OPTIONS)))
    option = data.draw(st.sampled_from(OPTIONS[command]))
    arguments = [*command.split(), f"{option}={data.draw(TEXTS)}"]
    if command in ("run",):
        arguments += ["--mode=inprocess", f"--output={folder / 'bag'}"]  # exists: no run begins
    if command == "design verify":
        arguments[-1] = f"--samples={data.draw(st.sampled_from(['-1', 'nan', 'x', '1e9', '9' * 400]))}"
    if command == "plant":
        arguments += ["--json"]
    if command in ("report", "replay", "bag repair"):
        arguments += [str(folder / "nothing" if command == "bag repair" else folder / "bag" / "metadata.yaml")]
    check(*called(folder, arguments))
    assert not list((folder / "work").iterdir())


@given(value=VALUES, key=st.sampled_from(["A", "D", "dt", "inputs", "version", "design_basis", "provenance", "name"]))
@examples(20)
def test_any_value_in_a_controller(folder: Path, value: object, key: str) -> None:
    content = json.loads((folder / "k_fsm.json").read_text())
    content[key] = value
    (folder / "odd.json").write_text(json.dumps(content))
    arguments = ["run", "--mode=inprocess", f"--k-fsm={folder / 'odd.json'}", f"--k-pma={folder / 'k_pma.json'}"]
    check(*called(folder, [*arguments, f"--output={folder / 'bag'}"]))
    check(*called(folder, ["replay", str(folder / "bag"), f"--k-fsm={folder / 'odd.json'}", "--loop=fsm"]))


KEYS = ["relative_file_paths", "files", "version", "compression_mode", "topics_with_message_count", "message_count"]


@given(value=VALUES, where=st.lists(st.sampled_from(KEYS), max_size=2))
@examples(20)
def test_any_value_in_metadata_yaml(folder: Path, value: object, where: list[str]) -> None:
    file = folder / "bag" / "metadata.yaml"
    good = file.read_text()
    content = yaml.safe_load(good)
    for key in where:
        content["rosbag2_bagfile_information"][key] = value
    try:
        file.write_text(yaml.safe_dump(content if where else value))
        assert len(Run.open(folder / "bag")["truth/los"]) == 1500
    finally:
        file.write_text(good)


@given(value=VALUES)
@examples(20)
def test_any_value_in_a_configuration_or_requirement_file(folder: Path, value: object) -> None:
    for name, content in (
        ("c.yaml", value),
        ("d.yaml", {"seed": value, "duration": value}),
        ("r.yaml", {"requirement": value}),
    ):
        (folder / name).write_text(yaml.safe_dump(content))
        arguments = ["run", "--mode=inprocess", f"--output={folder / 'bag'}", f"--config={folder / name}"]
        if name == "r.yaml":
            arguments = ["report", str(folder / "bag"), "--output=work/none/r.html", f"--requirements={folder / name}"]
        check(*called(folder, arguments))
