"""Command lines and text files of any content: an exit code of the table, one line, nothing left behind."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from fuzz.fuzz_profile import examples
from hypothesis import given
from hypothesis import strategies as st
from los_testbed.cli import app as cli
from support.simple_telescope import write_controllers

from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from titop_plant.telescope.load import load_telescope

CODES = {0, 1, 2, 3, 130}
LIMIT_S = 20.0
QUICK = 5
"""A command line takes a fraction of the time of a damaged bag, so that there are more of them in a round."""
ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**400), 10**400),
    st.floats(),
    st.text(max_size=20),
    st.sampled_from(["[x]", "[/]", "\0", "../x", "nan", "1e999", "", " ", "\u202e", "x" * 400]),
)
VALUES = st.recursive(
    ODD, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4)
)


@pytest.fixture(scope="module", autouse=True)
def command_made_once() -> Iterator[None]:
    """Typer makes all commands anew at each call: 50 ms, more than most of the examples take."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli.typer.main, "get_command", functools.cache(cli.typer.main.get_command))
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("inputs")
    write_controllers(made)
    los = np.random.default_rng(0).standard_normal((1500, 2)) * 1e-8
    write_bag(made / "bag", {"truth/los": los}, parameters={"loop": "fsm"})
    (made / "work").mkdir()
    (made / "temporary").mkdir()
    return made


def called(folder: Path, arguments: list[str]) -> tuple[int, str]:
    """Exit code and error output of a command; it must not leave anything in the temporary folder."""
    # processor time: a busy machine is no hang, and one that waits for ever meets the time limit of the test
    start_time, temporary, tempfile.tempdir = time.process_time(), tempfile.tempdir, str(folder / "temporary")
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
        tempfile.tempdir = temporary
    assert time.process_time() - start_time < LIMIT_S
    assert not list((folder / "temporary").iterdir())
    return code, err.getvalue()


def check(code: int, err: str) -> None:
    assert code in CODES
    assert "Traceback" not in err and "unexpected" not in err
    if code == 2:
        assert err.startswith("los-testbed: ") or "warning: " in err


OPTIONS = {
    command: [f"--{name}" for name in names.split()]
    for command, names in {
        "run": "duration camera-rate seed domain theta set loop case sample config k-fsm parameters omega-1 "
        "ramp-duration",
        "report": "transient from to namespace max-chunk requirements",
        "replay": "transient timeout domain loop k-fsm max-chunk",
        "bag repair": "max-chunk output",
        "design verify": "samples",
        "plant": "parameters",
        "analyse": "transient los unit rate time requirements output max-chunk",
        "budget": "output",
        "bag topics": "json",
        "bag info": "max-chunk",
        "bag verify": "max-chunk public-key",
        "bag sign": "max-chunk key",
        "stages": "scenario samples duration seed mode k-fsm designs camera-rate",
        "campaign": "samples seed sampling depth loop duration workers keep",
    }.items()
}
TEXTS = st.one_of(
    st.sampled_from(["nan", "inf", "-inf", "1e308", "-1", "0", "9" * 400, "[x]", "[/red]", "a=b", "seed=[[", "../.."]),
    st.sampled_from(["\u0000", "", " ", "none", "seed=.inf", "x" * 300, "--", "wheel_speed={a: [1]}"]),
    st.floats().map(str),
    st.integers().map(str),
    st.text(max_size=30).filter(lambda text: "\0" not in text and text.isprintable()),
)


@pytest.mark.further
@given(data=st.data())
@examples(40, times=QUICK)
def test_any_command_line(folder: Path, data: st.DataObject) -> None:
    command = data.draw(st.sampled_from(sorted(OPTIONS)))
    option = data.draw(st.sampled_from(OPTIONS[command]))
    arguments = [*command.split(), f"{option}={data.draw(TEXTS)}"]
    if command == "run":
        arguments.append("--mode=inprocess")
    if command in ("run", "stages"):
        arguments.append(f"--output={folder / 'bag'}")  # exists: no run begins
    if command == "campaign":
        arguments += [f"--output={folder / 'work' / 'new'}", "--scheduler=none://"]  # is no address: no campaign begins
    if command in ("analyse", "bag topics", "bag info", "bag verify", "bag sign", "budget"):
        arguments.append(str(folder / "bag" / "metadata.yaml"))
    if command == "design verify":
        arguments[-1] = f"--samples={data.draw(st.sampled_from(['-1', 'nan', 'x', '1e9', '9' * 400]))}"
    if command == "plant":
        arguments += ["--json"]
    if command in ("report", "replay", "bag repair"):
        arguments += [str(folder / "nothing" if command == "bag repair" else folder / "bag" / "metadata.yaml")]
    check(*called(folder, arguments))
    assert not list((folder / "work").iterdir())


@given(value=VALUES, key=st.sampled_from(["A", "D", "dt", "inputs", "version", "design_basis", "provenance", "name"]))
@examples(12, times=QUICK)
def test_any_value_in_a_controller(folder: Path, value: object, key: str) -> None:
    content = json.loads((folder / "k_fsm.json").read_text())
    content[key] = value
    (folder / "odd.json").write_text(json.dumps(content))
    arguments = ["run", "--mode=inprocess", f"--k-fsm={folder / 'odd.json'}", f"--k-pma={folder / 'k_pma.json'}"]
    check(*called(folder, [*arguments, f"--output={folder / 'bag'}"]))
    check(*called(folder, ["replay", str(folder / "bag"), f"--k-fsm={folder / 'odd.json'}", "--loop=fsm"]))


KEYS = ["relative_file_paths", "files", "version", "compression_mode", "topics_with_message_count", "message_count"]


@given(value=VALUES, where=st.lists(st.sampled_from(KEYS), max_size=2))
@examples(12, times=QUICK)
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
@examples(12, times=QUICK)
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


def as_toml(value: object) -> str:
    """A value as TOML; None, which TOML does not have, as a text."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(as_toml, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(str(key))} = {as_toml(entry)}' for key, entry in value.items())}}}"
    if isinstance(value, (bool, str)):
        return json.dumps(value)
    return '"none"' if value is None else repr(value)


REFERENCE = load_telescope()
ENTRIES = [
    (table, key)
    for table, content in REFERENCE.to_mapping().items()
    for key in (content if isinstance(content, dict) else ())
]


@given(
    value=VALUES, place=st.sampled_from(ENTRIES), kind=st.sampled_from(["{} = {}", "{}.x = {}", "[[{}]]\nname = {}"])
)
@examples(12, times=QUICK)
def test_any_value_in_a_parameter_file(folder: Path, value: object, place: tuple[str, str], kind: str) -> None:
    table, key = place
    where = f"{table}.{key}" if kind.startswith("[[") else key
    head = "" if kind.startswith("[[") else f"[{table}]\n"
    (folder / "own.toml").write_text('base = "reference"\n' + head + kind.format(where, as_toml(value)) + "\n", "utf-8")
    check(*called(folder, ["plant", f"--parameters={folder / 'own.toml'}", "--json"]))


@given(value=VALUES, key=st.sampled_from(["", "requirement", "name", "text", "contribution", "budget", "version"]))
@examples(12, times=QUICK)
def test_any_value_in_a_toml_file_of_requirements_or_a_budget(folder: Path, value: object, key: str) -> None:
    (folder / "own.toml").write_text(f"base = 'reference'\n{key or 'requirement.x'} = {as_toml(value)}\n", "utf-8")
    check(
        *called(folder, ["report", str(folder / "bag"), "--output=no/r.html", f"--requirements={folder / 'own.toml'}"])
    )
    check(*called(folder, ["budget", str(folder / "own.toml"), "--output=no/b.html"]))


@given(
    text=st.text(st.characters(codec="utf-8"), max_size=200)
    | st.sampled_from(["[" * 9000, "a = " + "[" * 9000, "a." * 5000 + "b = 1"])
)
@examples(12, times=QUICK)
def test_any_text_as_a_file(folder: Path, text: str) -> None:
    for name, arguments in (
        ("t.toml", ["plant", "--parameters=FILE"]),
        ("t.toml", ["budget", "FILE", "--output=no/b.html"]),
        ("t.yaml", ["run", "--mode=inprocess", "--config=FILE", f"--output={folder / 'bag'}"]),
        ("t.json", ["run", "--mode=inprocess", "--k-fsm=FILE", f"--output={folder / 'bag'}"]),
        ("t.csv", ["analyse", "FILE", "--unit=rad", "--rate=100"]),
        ("t.mcap", ["analyse", "FILE"]),
    ):
        (folder / name).write_text(text, "utf-8")
        check(*called(folder, [a.replace("FILE", str(folder / name)) for a in arguments]))
