"""Contents of files that a program would trip over: one line with the file's name, before memory is taken."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.slow_cases import slow

from pointing_analysis.indices.errors import LARGEST
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.run import Run
from pointing_analysis.report.report import write_report
from pointing_analysis.requirements.summary import summarise

pytestmark = pytest.mark.usefixtures("without_pictures")

Call = Callable[..., tuple[int, str, str]]


def npy(shape: str, data: bytes = b"") -> bytes:
    """A NumPy file that declares this shape."""
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}".encode()
    head = head.ljust((len(head) + 10) // 64 * 64 + 117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data


def one_line(err: str, name: str) -> bool:
    return err.count("\n") == 1 and err.startswith(f"los-testbed: {name}: ") and "unexpected" not in err


@pytest.mark.parametrize("shape", ["(1000000000000, 2)", f"({'9' * 400}, 2)", "((((", "(3, 2)"])
@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_a_shape_that_the_file_does_not_have(call: Call, tmp_path: Path, shape: str, suffix: str) -> None:
    file = tmp_path / f"odd{suffix}"
    if suffix == ".npy":
        file.write_bytes(npy(shape))
    else:
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("xy.npy", npy(shape))
    code, out, err = call("analyse", file.name, "--unit=rad", "--rate=100")
    assert code == 2 and out == "" and one_line(err, file.name), err


@pytest.mark.further
def test_tables_of_kilobytes_that_stand_for_gigabytes(call: Call, tmp_path: Path) -> None:
    with (
        zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("xy.npy", "w", force_zip64=True) as file,
    ):
        file.write(npy("(31250000, 2)"))
        for _ in range(500):
            file.write(bytes(1_000_000))
    names = ["bomb.npz"]
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        pass
    else:
        names.append("bomb.parquet")
        rows = 20_000_000
        zeros = pyarrow.array(np.zeros(rows, np.int8)).cast(pyarrow.float32())
        parquet.write_table(pyarrow.table({"x": zeros, "y": zeros}), tmp_path / "bomb.parquet")
    for name in names:
        assert (tmp_path / name).stat().st_size < 1_000_000
        code, out, err = call("analyse", name, "--unit=rad", "--rate=1000")
        assert code == 2 and out == "" and one_line(err, name) and "must unpack to at most" in err, err


def table_with(path: Path, cell: str) -> None:
    rows = (f"{i / 100},{cell if i == 700 else 1e-8},0\n" for i in range(1000))
    path.write_text("t,x,y\n" + "".join(rows))


@pytest.mark.parametrize("cell", ["9" * 200_000, '"'])
def test_cells_that_are_no_numbers(call: Call, tmp_path: Path, cell: str) -> None:
    table_with(tmp_path / "odd.csv", cell)
    code, out, err = call("analyse", "odd.csv", "--unit=rad")
    assert code == 2 and out == "" and one_line(err, "odd.csv"), err


@pytest.mark.parametrize("value", [1e308, -np.inf, 2 * LARGEST])
def test_angles_that_are_none_are_told_with_their_time(tmp_path: Path, value: float) -> None:
    los = np.full((3000, 2), 1e-8)
    los[2234, 1] = value
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": los}))
    with pytest.raises(BagError, match=r"angles below 1e\+60 rad, got .* at 2.234 s"):
        summarise(run)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [slow(0.0), 5e-324, LARGEST / 2])
@pytest.mark.pictures
def test_a_report_of_the_smallest_and_largest_angles(tmp_path: Path, value: float) -> None:
    """Also of a line of sight that does not move: its pictures have no positive value."""
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": np.full((1500, 2), value)}))
    write_report([run], tmp_path / "report.html")
    assert 0.0 <= summarise(run).rpe_rms <= 1e-6 * value


@pytest.mark.parametrize("text", ["", "null", '{"a": ', "[" * 100_000, '{"figures": [{}]}'])
def test_files_that_a_command_goes_on_with(call: Call, tmp_path: Path, text: str) -> None:
    for folder, name in (("proofs", "bounds.json"), ("campaign", "campaign.json")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).write_text(text)
    (tmp_path / "proof.json").write_text(text)
    before = sorted(tmp_path.rglob("*"))
    for line, name in (("design certify", "proofs/bounds.json"), ("campaign --resume", "campaign")):
        code, out, err = call(*line.split(), f"--output={name.partition('/')[0]}")
        assert code == 2 and out == "" and err.count("\n") == 1 and f" {name}" in err, err
    code, out, err = call("design", "check-proof", "proof.json")
    assert code == 2 and out == "" and err.count("\n") == 1 and " proof.json: the " in err, err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("content", [b"", b"PK\3\4" + bytes(300), npy("(3,)", bytes(24))])
def test_loop_proofs_that_are_none(call: Call, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "proof.npz").write_bytes(content)
    code, out, err = call("design", "check-proof", "proof.npz")
    assert code == 2 and out == "" and err.count("\n") == 1 and " proof.npz: the " in err, err
