"""Bags of other programs, damaged, compressed or encoded otherwise: read as after a repair, or refused by name."""

from __future__ import annotations

import shutil
import struct
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from fuzz.fuzz_profile import examples
from fuzz.mutations import MUTATIONS, Mutation
from hypothesis import given
from hypothesis import strategies as st
from los_testbed.bags.check import check_bag
from los_testbed.bags.repair import repair_bag
from mcap.writer import CompressionType, Writer
from support.command_line import refused

from pointing_analysis.indices.errors import RAD_PER_ARCSEC
from pointing_analysis.read.los_source import open_los
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.requirements.summary import Summary, summarise
from pointing_analysis.requirements.verdict import parse

N, STEP = 1200, 10_000_000
pytestmark = pytest.mark.usefixtures("without_pictures")
START = 1_700_000_000_000_000_000
KIND = "my_msgs/msg/Los"
DEFINITION = b"""std_msgs/Header header
float64 az
float64 el
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""
REQUIREMENTS = (
    parse("prob(|APE| < 9 arcsec) >= 0.5 at 60 % confidence"),
    parse("prob(|APE| < 1 mas) >= 0.9 at 90 % confidence"),
)
NOT_PLAIN = (
    (2, r"PL_CDR \(.*big"),
    (3, r"PL_CDR \(.*little"),
    *((kind, "XCDR2") for kind in (6, 11)),
    (99, "an unknown encapsulation"),
)
Payload = Callable[[int, float, float], bytes]


def samples() -> np.ndarray[Any, Any]:
    return np.random.default_rng(5).standard_normal((N, 2))


def little(stamp: int, az: float, el: float, order: str = "<", kind: bytes = b"\x00\x01") -> bytes:
    """A message laid out by hand: encapsulation, stamp, frame ``fsm``, two numbers at the next multiple of eight."""
    head = struct.pack(order + "iII4s", stamp // 10**9, stamp % 10**9, 4, b"fsm\0")
    return kind + b"\0\0" + head + struct.pack(order + "dd", az, el)


def big(stamp: int, az: float, el: float) -> bytes:
    return little(stamp, az, el, ">", b"\x00\x00")


def packed(stamp: int, az: float, el: float) -> bytes:
    return zstandard.compress(little(stamp, az, el))


def write(
    path: Path,
    payload: Payload = little,
    *,
    encoding: str = "cdr",
    language: str = "ros2msg",
    definition: bytes = DEFINITION,
    compression: CompressionType = CompressionType.ZSTD,
    about: dict[str, Any] | None = None,
    numbered: bool = False,
) -> Path:
    """A rosbag2 folder as another program writes it: no numbers of the messages, some other topic beside."""
    path.mkdir(parents=True)
    name = f"{path.name}_0.mcap"
    with (path / name).open("wb") as stream:
        writer = Writer(stream, chunk_size=6000, compression=compression)
        writer.start(profile="ros2", library="another program")
        los = writer.register_channel("/los", encoding, writer.register_schema(KIND, language, definition))
        schema = writer.register_schema("a/msg/Text", "ros2msg", b"string data\n")
        text = writer.register_channel("/text", "cdr", schema)
        for i, (az, el) in enumerate(samples().tolist()):
            stamp = START + i * STEP
            writer.add_message(los, stamp, payload(stamp, az, el), stamp, i + 1 if numbered else 0)
            if i % 10 == 0:
                writer.add_message(text, stamp, b"\0\1\0\0\2\0\0\0a\0", stamp)
        writer.finish()
    table = {"relative_file_paths": [name], "compression_mode": "", "compression_format": "", **(about or {})}
    (path / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": table}))
    return path


def judged(bag: Path) -> Summary:
    run = open_los(bag, los="/los", unit="arcsec")
    return summarise(run, transient=0.0, requirements=REQUIREMENTS)


@pytest.mark.parametrize("payload", [little, big, packed])
@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_plain_form_gives_the_same(tmp_path: Path, payload: Payload, compression: CompressionType) -> None:
    bag = write(tmp_path / "bag", payload, compression=compression)
    for path in (bag, bag / "bag_0.mcap"):
        topic = open_los(path, los="/los", unit="arcsec")["truth/los"]
        assert topic.values.tolist() == (samples() * RAD_PER_ARCSEC).tolist()
        assert topic.stamp.tolist() == (START + STEP * np.arange(N)).tolist()
        assert not topic.open_end


@pytest.mark.parametrize("name", ["bag_0.mcap.zstd", "bag_0.mcap.zst"])
def test_files_compressed_as_a_whole(tmp_path: Path, name: str) -> None:
    bag = write(tmp_path / "bag", about={"relative_file_paths": [name], "compression_mode": "FILE"})
    (bag / name).write_bytes(zstandard.compress((bag / "bag_0.mcap").read_bytes()))
    (bag / "bag_0.mcap").unlink()
    assert len(open_los(bag, los="/los", unit="arcsec")["truth/los"]) == N
    assert len(open_los(bag / name, los="/los", unit="arcsec")["truth/los"]) == N


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"encoding": "json"}, "messages must be encoded as cdr, got 'json'"),
        ({"encoding": "protobuf"}, "messages must be encoded as cdr, got 'protobuf'"),
        ({"encoding": "ros1", "language": "ros1msg"}, "messages must be encoded as cdr, got 'ros1'"),
        ({"language": "jsonschema"}, "definition of my_msgs/msg/Los must be ros2msg or ros2idl, got 'jsonschema'"),
        ({"language": "ros2idl"}, "definition of my_msgs/msg/Los must be IDL, got 'std_msgs'"),
        ({"definition": b""}, "must hold the definition of my_msgs/msg/Los, got none"),
        ({"about": {"compression_mode": "FILE", "compression_format": "lz4"}}, "compression_format .* zstd, got 'lz4'"),
        *(
            ({"payload": lambda *m, kind=kind: little(*m, kind=bytes([0, kind]))}, f"must be plain CDR, got {name}")
            for kind, name in NOT_PLAIN
        ),
        ({"payload": lambda *_: b""}, "must be plain CDR, got 0 bytes"),
    ],
    ids=lambda value: value if isinstance(value, str) else "bag",
)
def test_what_is_not_read_is_refused_by_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: dict[str, Any], words: str
) -> None:
    bag = write(tmp_path / "bag", **options)
    line = refused(capsys, "analyse", bag, "--los=/los", "--unit=mas")
    with pytest.raises(BagError, match=words) as caught:
        open_los(bag, los="/los", unit="mas")
    assert str(caught.value) in line
    with pytest.raises(BagError, match=words):
        open_los(bag, los="/los.position", unit="mas")


def test_some_messages_in_another_encapsulation_are_left_out_and_counted(tmp_path: Path) -> None:
    def payload(stamp: int, *xy: float) -> bytes:
        return little(stamp, *xy, kind=b"\0\3" if stamp // STEP % 100 == 7 else b"\0\1")

    run = open_los(write(tmp_path / "bag", payload), los="/los", unit="arcsec")
    assert run["truth/los"].integrity.missing == 12
    assert any("/los: 12 messages excluded: my_msgs/msg/Los must be plain CDR, got PL_CDR" in p for p in run.problems)


def test_a_compressed_message_unpacks_within_the_limit_of_a_chunk(tmp_path: Path) -> None:
    """A few kilobytes of zeros stand for a gigabyte."""
    bomb = zstandard.compress(bytes(1 << 26))
    bag = write(tmp_path / "bag", lambda stamp, *xy: bomb if stamp == START + 1100 * STEP else packed(stamp, *xy))
    run = open_los(bag, los="/los", unit="arcsec", max_chunk=1_000_000)
    assert 1000 < len(run["truth/los"]) < N
    assert any("compressed messages cannot be unpacked, or not within the limit of 1 MB" in p for p in run.problems)
    assert run["truth/los"].integrity.missing + run["truth/los"].lost_after == N - len(run["truth/los"])


@pytest.mark.parametrize("payload", [little, packed])
def test_a_sqlite3_bag_is_refused_with_the_command_that_converts_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], payload: Payload
) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    external_bags = pytest.importorskip("support.external_bags", reason="could not import 'rosbags'")
    bag = tmp_path / "old"
    opened = rosbag2.Writer(bag, version=9, storage_plugin=rosbag2.StoragePlugin.SQLITE3)
    if payload is packed:
        opened.set_compression(rosbag2.CompressionMode.FILE, rosbag2.CompressionFormat.ZSTD)
    with opened as writer:
        kind = "geometry_msgs/msg/PointStamped"
        connection = writer.add_connection("/los", kind, typestore=external_bags.STORE)
        for i, (x, y) in enumerate(samples().tolist()):
            message = external_bags._message(kind, START + i * STEP, x, y, i)
            writer.write(connection, START + i * STEP, external_bags.STORE.serialize_cdr(message, kind))
    (file,) = (f for f in bag.iterdir() if ".db3" in f.name)
    for path in (bag, file):
        for command in (["analyse", path, "--los=/los", "--unit=mas"], ["analyse", path], ["bag", "topics", path]):
            assert "got sqlite3; to convert it: pip install rosbags; rosbags-convert" in refused(capsys, *command)
    convert = refused(capsys, "analyse", bag).split("rosbags; ")[1].split()
    tool = Path(sys.executable).parent / convert[0]
    words = [{"BAG": str(bag), "NEW": str(tmp_path / "new")}.get(word, word) for word in convert[1:]]
    subprocess.run([sys.executable, tool, *words], check=True, capture_output=True, timeout=600)
    assert (
        open_los(tmp_path / "new", los="/los", unit="arcsec")["truth/los"].values.tolist()
        == (samples() * RAD_PER_ARCSEC).tolist()
    )


@pytest.mark.parametrize(("first", "unset", "read"), [(0, 0, N), (10**9, 1, N - 1), (10**9, 3, N - 3)])
def test_a_stamp_of_zero_is_a_time_where_the_clock_began_there(
    tmp_path: Path, first: int, unset: int, read: int
) -> None:
    """A clock of a simulation begins at zero: its first sample was dropped without a word."""

    def stamped(stamp: int, az: float, el: float) -> bytes:
        tick = (stamp - START) // STEP
        return little(0 if tick < unset else first + tick * STEP, az, el)

    run = open_los(write(tmp_path / "bag", stamped), los="/los", unit="arcsec", time="header")
    assert len(run["truth/los"]) == read
    told = [text for text in run.problems if "without a stamp" in text]
    assert [text.split(": ")[1].split()[0] for text in told] == ([str(unset)] if unset else [])


# -- damage ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, bytes]]:
    """Bags of other programs by the kind of their compression, with the bytes of their files."""
    folder = tmp_path_factory.mktemp("foreign")
    found = {}
    for name, options in {
        "zstd": {},
        "plain": {"compression": CompressionType.NONE},
        "numbered": {"numbered": True},
        "packed": {"payload": packed, "compression": CompressionType.NONE},
        "big": {"payload": big},
    }.items():
        bag = write(folder / name, **options)
        found[name] = bag, (bag / f"{name}_0.mcap").read_bytes()
    return found


def damaged(bags: dict[str, tuple[Path, bytes]], kind: str, changes: Sequence[Mutation]) -> Path:
    bag, data = bags[kind]
    for change in changes:
        data = change(data)
    (bag / f"{kind}_0.mcap").write_bytes(data)
    return bag


def comparable(summary: Summary) -> str:
    """All of a summary but its texts."""
    values = {name: value for name, value in vars(summary).items() if name not in ("path", "problems", "losses")}
    return repr(values)


def check_as_after_repair(bag: Path) -> Summary | None:
    """Direct reading and reading after a repair say the same; None if the repair refuses."""
    new = bag.with_name("new")
    shutil.rmtree(new, ignore_errors=True)
    try:
        repair_bag(bag, new)
    except BagError:
        new = bag
    try:
        direct = judged(bag)
    except ValueError:
        with pytest.raises(ValueError, match=r"^[^\n]+$"):
            judged(new)
        return None
    assert comparable(direct) == comparable(judged(new))
    return direct


@pytest.mark.further
@given(
    kind=st.sampled_from(["zstd", "plain", "numbered", "packed", "big"]),
    changes=st.lists(MUTATIONS, min_size=1, max_size=3),
)
@examples(25)
def test_a_damaged_bag_is_judged_as_after_its_repair(
    bags: dict[str, tuple[Path, bytes]], kind: str, changes: list[Mutation]
) -> None:
    check_as_after_repair(damaged(bags, kind, changes))


def test_a_damaged_chunk_costs_its_own_messages_and_is_counted(bags: dict[str, tuple[Path, bytes]]) -> None:
    """Not all that comes behind it: the first place that is damaged ends nothing."""
    bag = damaged(bags, "zstd", [Mutation("flip", 0.3, 0.0, 3, b"")])
    run = open_los(bag, los="/los", unit="arcsec")
    (loss,) = (loss for loss in run.losses if loss.topic == "/los")
    assert 0 < loss.missing < 200 and loss.recovered == N - loss.missing == len(run["truth/los"])
    assert run["truth/los"].integrity.missing == loss.missing
    assert (run["truth/los"].lost_before, run["truth/los"].lost_after, run["truth/los"].open_end) == (0, 0, False)
    assert any("a chunk is damaged" in problem for problem in run.problems) and str(loss) in run.problems


@pytest.mark.parametrize(("kind", "chunk"), [("zstd", 0), ("zstd", -1), ("numbered", -1), ("plain", -1)])
def test_a_damaged_chunk_at_an_end_is_lost_before_or_after(
    bags: dict[str, tuple[Path, bytes]], kind: str, chunk: int
) -> None:
    from fuzz.mutations import records

    data = bags[kind][1]
    begin, end = [place for place in records(data) if data[place[0]] == 6][chunk]
    changed = bytearray(data)
    changed[(begin + end) // 2] ^= 0x55
    (bags[kind][0] / f"{kind}_0.mcap").write_bytes(changed)
    found = check_as_after_repair(bags[kind][0])
    topic = open_los(bags[kind][0], los="/los", unit="arcsec")["truth/los"]
    assert topic.integrity.missing == 0
    ends = (N - len(topic), 0) if chunk == 0 else (0, N - len(topic))
    assert (topic.lost_before, topic.lost_after) == ends != (0, 0)
    assert found is not None and found.samples_lost == N - len(topic)


def test_a_bag_that_was_cut_off_is_not_judged_as_whole(bags: dict[str, tuple[Path, bytes]]) -> None:
    found = check_as_after_repair(damaged(bags, "zstd", [Mutation("cut", 0.6, 0.0, 1, b"")]))
    assert found is not None and found.open_end and found.verdicts[0].status == "not enough data"
    assert any("the number of missing samples at its end is not known" in problem for problem in found.problems)


def rewritten(path: Path, content: bytes, **options: Any) -> bytes:
    """Messages of a file, written by the library of the format with other options."""
    path.mkdir(exist_ok=True)
    with (path / "m_0.mcap").open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start()
        schema = writer.register_schema(KIND, "ros2msg", DEFINITION)
        channel = writer.register_channel("/los", "cdr", schema)
        for k in range(N):
            writer.add_message(channel, START + k * STEP, content, START + k * STEP)
        writer.finish()
    return (path / "m_0.mcap").read_bytes()


def test_damage_behind_the_data_and_in_an_index_is_seen(tmp_path: Path) -> None:
    """No checksum of a message covers them; readers by index go astray where the bag was called whole."""
    from fuzz.mutations import records

    content = struct.pack("<4siII", b"\0\1\0\0", 0, 0, 1) + b"\0" * 4 + struct.pack("<dd", 1e-6, 2e-6)
    for options in ({}, {"enable_crcs": False}, {"use_summary_offsets": False, "use_statistics": False}):
        rewritten(tmp_path / "bag", content, **options)
        assert check_bag(tmp_path / "bag/m_0.mcap").code == 0, options
    data = rewritten(tmp_path / "bag", content)
    by_kind: dict[int, list[tuple[int, int]]] = {}
    for begin, end in records(data):
        by_kind.setdefault(data[begin], []).append((begin, end))
    (end_of_data,), (footer,) = by_kind[15], by_kind[2]
    rng = np.random.default_rng(0)
    for begin, end in (footer, (end_of_data[1], footer[0]), by_kind[7][0]):
        for place in rng.integers(begin, end, 20):
            changed = bytearray(data)
            changed[place] ^= 1 << int(rng.integers(8))
            (tmp_path / "bag/m_0.mcap").write_bytes(changed)
            assert check_bag(tmp_path / "bag/m_0.mcap").code, (begin, int(place))
    (tmp_path / "bag/m_0.mcap").write_bytes(data[: end_of_data[1]])
    assert check_bag(tmp_path / "bag/m_0.mcap").code == 1
