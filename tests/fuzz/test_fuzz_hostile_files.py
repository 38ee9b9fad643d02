"""Files that are made to stop, fill or end the program: one line, exit code 2, little time and memory.

Each generator finds its hole in the version 6a8cdd82.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz import hostile_files as hostile
from fuzz.fuzz_profile import examples
from hypothesis import example, given
from hypothesis import strategies as st
from los_testbed.cli import app as cli
from support.simple_telescope import write_controllers

RUN = "run --mode=inprocess --output=new"
DOORS = [
    "plant --parameters=FILE",
    "plant --parameters=body.toml",
    f"{RUN} --parameters=body.toml",
    f"{RUN} --config=FILE",
    f"{RUN} --k-fsm=FILE",
    f"{RUN} --k-pma=FILE",
    f"{RUN} --k-fsm=FILE.so",
    f"{RUN} --disturbance=FILE",
    f"{RUN} --disturbance=source.toml",
    f"{RUN} --set=profile=FILE",
    f"{RUN} --requirements=FILE",
    "run --output=new --device=los_testbed.rig.udp:UdpRig --device-address=127.0.0.1:9 --device-key=FILE",
    "run --output=new --live --live-tls-cert=FILE --live-tls-key=FILE",
    "campaign --samples=2 --output=new --scheduler=tls://127.0.0.1:9 --tls-ca-file=FILE --tls-cert=FILE",
    "analyse FILE --unit=rad --rate=100",
    "budget FILE",
    "bag sign FILE --key=FILE",
    "bag info FILE",
    "bag verify bag --public-key=FILE",
    "image figures FILE --optics=FILE --output=new",
    "export check FILE",
    "design check-proof FILE",
]
MAT_DOORS = [line for line in DOORS if line.startswith((f"{RUN} --k", f"{RUN} --disturbance=F", "analyse"))]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("hostile")
    write_controllers(made)
    (made / "body.toml").write_text('base = "reference"\n[payload]\nmodal_data = "file"\n')
    (made / "source.toml").write_text(
        'base = "reference"\n[[disturbance]]\nname = "x"\nkind = "series"\nfile = "file"\n'
    )
    return made


def check(folder: Path, line: str, name: str = "file") -> None:
    """The command ends by itself, soon, with little memory, and says one line where it refuses."""
    arguments = [part.replace("FILE", name) for part in line.split()]
    end = hostile.in_child(cli.main, arguments, folder)
    assert end.code in (0, 1, 2, 3), (line, end)
    assert "Traceback" not in end.err and "unexpected" not in end.err and "memory" not in end.err, (line, end)
    assert end.memory < hostile.MEMORY, (line, end)
    if end.code == 2:
        last = [text for text in end.err.splitlines() if text.startswith("los-testbed: ")]
        assert len(last) == 1 and end.err.endswith(f"{last[0]}\n"), (line, end)


def written(folder: Path, content: bytes | str, name: str = "file") -> Path:
    path = folder / name
    path.unlink(missing_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@example(line="plant --parameters=body.toml", kind="pipe")
@example(line=DOORS[11], kind="zero")
@given(line=st.sampled_from(DOORS), kind=st.sampled_from(hostile.KINDS))
@examples(6)
def test_what_is_no_file_at_any_door(folder: Path, line: str, kind: str) -> None:
    for name in ("file", "file.so"):
        hostile.no_file(folder / name, kind)
    check(folder, line)


@given(text=hostile.TEXTS, line=st.sampled_from(DOORS))
@examples(6)
def test_deep_and_numerous_texts(folder: Path, text: str, line: str) -> None:
    written(folder, text)
    written(folder, text, "file.toml")
    check(folder, line)
    if "disturbance=FILE" in line or "parameters=FILE" in line:
        check(folder, line, "file.toml")


@example(text=hostile.dotted(30_000, "a", "{} = 1"))
@example(text=hostile.dotted(30_000, "'a'", "x = {{ {} = 1 }}"))
@given(text=hostile.TOML)
@examples(3)
def test_deep_and_numerous_toml(folder: Path, text: str) -> None:
    written(folder, text, "file.toml")
    check(folder, "plant --parameters=FILE", "file.toml")


@example(text="a: [" + "1," * 2_000_000 + "1]\n")
@given(text=hostile.YAML)
@examples(3)
def test_description_of_a_bag(folder: Path, text: str) -> None:
    (folder / "bag").mkdir(exist_ok=True)
    written(folder / "bag", f"rosbag2_bagfile_information:\n  {text.replace(chr(10), chr(10) + '  ')}", "metadata.yaml")
    check(folder, "bag info FILE", "bag")


@example(data=hostile.nested_cells(5000, True), line=MAT_DOORS[0])
@example(data=hostile.nested_cells(5000, False), line=MAT_DOORS[-1])
@given(data=hostile.MATS, line=st.sampled_from(MAT_DOORS))
@examples(10)
def test_structure_of_a_mat_file(folder: Path, data: bytes, line: str) -> None:
    written(folder, data)
    check(folder, line)


@example(depth=1600, width=1)
@given(depth=st.integers(100, 2000), width=st.integers(0, 3))
@examples(2)
def test_groups_in_groups(folder: Path, depth: int, width: int) -> None:
    hostile.deep_hdf5(folder / "deep.h5", depth, width)
    check(folder, "analyse FILE --unit=rad --rate=100", "deep.h5")


@example(width=4, depth=6)
@given(width=st.integers(2, 5), depth=st.integers(4, 11))
@examples(2)
def test_types_in_types(folder: Path, width: int, depth: int) -> None:
    hostile.branching_bag(folder / "types.mcap", width, depth)
    check(folder, "bag topics FILE", "types.mcap")
