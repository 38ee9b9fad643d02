"""Files that are no ordinary files, and bags of which nothing or too much is left: one line, and nothing replaced."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from fuzz.mutations import messages, records
from los_testbed.bags.repair import repair_bag

from lftkit.support.atomic_output import write_text
from pointing_analysis.read.mcap.records import OP_CHUNK, OP_DATA_END, OP_FOOTER
from pointing_analysis.read.run import Run

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
    (bag.parent / "body.toml").write_text('[payload]\nmodal_data = "pipe"\n')
    (bag.parent / "source.toml").write_text('[[disturbance]]\nname = "x"\nkind = "series"\nfile = "pipe"\n')
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
