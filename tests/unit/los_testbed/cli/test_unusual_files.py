"""Files that are no ordinary files or have odd contents: one line, before memory is taken, and nothing replaced."""

from __future__ import annotations

import os
import struct
import zipfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzz.mutations import messages, records
from los_testbed.bags.repair import repair_bag
from support.slow_cases import slow

from lftkit.support.atomic_output import write_text
from pointing_analysis.indices.errors import LARGEST
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.mcap.records import OP_CHUNK, OP_DATA_END, OP_FOOTER, BagError
from pointing_analysis.read.run import Run
from pointing_analysis.report.report import write_report
from pointing_analysis.requirements.summary import summarise

Call = Callable[..., tuple[int, str, str]]


INPUTS = [
    "analyse pipe.mcap",
    "analyse pipe.csv --unit=rad --rate=100",
    "analyse pipe.mcap --los=/x --unit=rad",
    "bag repair pipe.mcap",
    "bag info pipe.mcap",
    "bag verify bag --public-key=pipe.mcap",
    "budget pipe",
    "report bag --requirements=pipe",
    "replay bag --k-fsm=pipe",
    "run --mode=inprocess --config=pipe",
    "run --mode=inprocess --parameters=pipe",
    "run --mode=inprocess --cases=pipe --case=x",
    "plant --parameters=body.toml",
    "run --mode=inprocess --disturbance=pipe",
    "run --mode=inprocess --disturbance=source.toml",
    "run --live --live-tls-cert=pipe --live-tls-key=pipe",
    "bag sign bag --key=pipe",
    "bag repair loop",
    "analyse loop",
]


@pytest.mark.parametrize("line", INPUTS)
def test_a_pipe_or_a_circle_of_links_as_input_is_told_and_not_waited_for(call: Call, bag: Path, line: str) -> None:
    for name in ("pipe", "pipe.mcap", "pipe.csv", "pipe.npy", "pipe.so"):
        os.mkfifo(bag.parent / name)
    (bag.parent / "body.toml").write_text('base = "reference"\n[payload]\nmodal_data = "pipe"\n')
    (bag.parent / "source.toml").write_text(
        'base = "reference"\n[[disturbance]]\nname = "x"\nkind = "series"\nfile = "pipe"\n'
    )
    (bag.parent / "loop").symlink_to(bag.parent / "loop")
    before = sorted(bag.parent.rglob("*"))
    code, out, err = call(*line.split())
    assert code == 2 and out == "", err
    assert err.startswith("los-testbed: ") and err.count("\n") == 1
    assert "pipe" in err or "loop" in err
    assert sorted(bag.parent.rglob("*")) == before


@pytest.mark.parametrize(
    "line", ["analyse bag --output=pipe", "report bag --output=pipe", "bag repair bag --output=pipe"]
)
def test_a_pipe_or_a_device_is_never_replaced_by_an_output(call: Call, bag: Path, line: str) -> None:
    """A pipe stands for /dev/null, which an administrator's command would have replaced for the whole machine."""
    os.mkfifo(bag.parent / "pipe")
    code, out, err = call(*line.split())
    assert code == 2 and out == "" and err.count("\n") == 1
    assert (bag.parent / "pipe").is_fifo()
    with pytest.raises(ValueError, match="ordinary file"):
        write_text(bag.parent / "pipe", "text")
    assert (bag.parent / "pipe").is_fifo() and sorted(p.name for p in bag.parent.iterdir()) == ["bag", "pipe"]


@pytest.mark.parametrize("op", [OP_DATA_END, OP_FOOTER])
def test_an_end_of_the_data_in_front_of_the_data_ends_nothing(bag: Path, op: int) -> None:
    file = bag / "bag_0.mcap"
    data = file.read_bytes()
    found = records(data)
    (head, behind), (begin, end) = found[0], next(place for place in found if data[place[0]] == op)
    file.write_bytes(data[:head] + data[begin:end] + data[behind:begin] + data[head:behind] + data[end:])
    result = repair_bag(bag, bag.parent / "new")
    assert messages((bag.parent / "new" / "new_0.mcap").read_bytes()) == messages(data)
    assert not result.losses and any("precedes data" in problem for problem in result.problems)
    assert len(Run.open(bag)["truth/los"]) == 3000


def test_without_a_header_a_chunk_that_stands_twice_does_not_hide_the_loss_of_another(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    data = file.read_bytes()
    found = records(data)
    first, second = [place for place in found if data[place[0]] == OP_CHUNK][:2]
    middle = (first[0] + first[1]) // 2
    damaged = data[:middle] + bytes(2000) + data[middle + 2000 :]
    (header, behind), (begin, end) = found[0], second
    file.write_bytes(damaged[:header] + damaged[behind:end] + damaged[begin:end] + damaged[end:])
    result = repair_bag(bag, bag.parent / "new")
    left = messages((bag.parent / "new" / "new_0.mcap").read_bytes())
    missing = Counter(topic for topic, _ in messages(data).keys() - left.keys())
    assert missing["/telescope/pma/command"] == 1000
    assert {loss.topic: loss.missing for loss in result.losses} == missing
    assert [loss.missing for loss in Run.open(bag).losses] == [loss.missing for loss in result.losses]


pytestmark = pytest.mark.usefixtures("without_pictures")


def npy(shape: str, data: bytes = b"") -> bytes:
    """A NumPy file that declares this shape."""
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}}}".encode()
    head = head.ljust((len(head) + 10) // 64 * 64 + 117) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data


def names_file(err: str, name: str) -> bool:
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
    assert code == 2 and out == "" and names_file(err, file.name), err


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
        assert code == 2 and out == "" and names_file(err, name) and "must unpack to at most" in err, err


def table_with(path: Path, cell: str) -> None:
    rows = (f"{i / 100},{cell if i == 700 else 1e-8},0\n" for i in range(1000))
    path.write_text("t,x,y\n" + "".join(rows))


@pytest.mark.parametrize("cell", ["9" * 200_000, '"'])
def test_cells_that_are_no_numbers(call: Call, tmp_path: Path, cell: str) -> None:
    table_with(tmp_path / "odd.csv", cell)
    code, out, err = call("analyse", "odd.csv", "--unit=rad")
    assert code == 2 and out == "" and names_file(err, "odd.csv"), err


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
