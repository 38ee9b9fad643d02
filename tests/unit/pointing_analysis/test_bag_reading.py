"""Every kind of bag is read to the same values; every defect is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from mcap.writer import Writer

from pointing_analysis.indices.synthetic import McapStorage, write_bag
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.messages.cdr import Encoder
from pointing_analysis.read.messages.message_types import DEFINITIONS, JOINT_STATE
from pointing_analysis.read.run import Run
from pointing_analysis.read.topic import on_grid

N = 1600


@pytest.fixture(scope="module")
def signals() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    found = {k: rng.standard_normal((N, 6)) for k in ("isolator/accel", "m1/accel", "m2/accel", "pma/command")}
    found |= {k: rng.standard_normal((N, 2)) for k in ("fsm/strain_gauge", "los_estimate", "fsm/command", "truth/los")}
    camera = rng.standard_normal((N // 20, 2))
    camera[7] = np.nan
    found["camera/los"] = camera
    return found


def check(run: Run, signals: dict[str, np.ndarray]) -> None:
    assert set(run.topics) == set(signals)
    for name, values in signals.items():
        assert np.array_equal(run[name].values[:, : values.shape[1]], values, equal_nan=True), name
        assert np.ptp(np.diff(run[name].stamp)) == 0


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": "lz4"},
        {"compression": "none"},
        {"index": False},
        {"chunks": False},
        {"chunks": False, "index": False},
        {"chunk_size": 20_000},
    ],
    ids=str,
)
def test_every_layout_of_the_file_gives_the_same_values(tmp_path: Path, signals, options) -> None:
    bag = write_bag(tmp_path / "bag", signals, periods={"camera/los": 20}, storage=McapStorage(**options))
    run = Run.open(bag)
    check(run, signals)
    assert run.problems == ()
    check(Run.open(bag / "bag_0.mcap"), signals)


@pytest.mark.parametrize("namespace", ["", "/lab/telescope_2"])
def test_every_namespace_gives_the_same_values(tmp_path: Path, signals, namespace: str) -> None:
    absolute = {f"{namespace}/{name}": values for name, values in signals.items()}
    run = Run.open(write_bag(tmp_path / "bag", absolute, periods={f"{namespace}/camera/los": 20}))
    check(run, signals)
    assert run.problems == ()


def test_equal_to_rosbags(tmp_path: Path, signals) -> None:
    reader = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    bag = write_bag(tmp_path / "bag", signals, periods={"camera/los": 20})
    store, run = get_typestore(Stores.ROS2_JAZZY), Run.open(bag)
    efforts, stamps = [], []
    with reader.Reader(bag) as opened:
        chosen = [c for c in opened.connections if c.topic == "/telescope/pma/command"]
        for connection, _, raw in opened.messages(connections=chosen):
            message = store.deserialize_cdr(raw, connection.msgtype)
            efforts.append(message.effort)
            stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
    assert np.array_equal(run["pma/command"].values, efforts)
    assert np.array_equal(run["pma/command"].stamp, stamps)


def test_split_recording_is_one_run(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    los = rng.standard_normal((2000, 2))
    folder = tmp_path / "split"
    folder.mkdir()
    files = []
    for i in (0, 1):
        part = write_bag(tmp_path / f"part{i}", {"truth/los": los[1000 * i : 1000 * i + 1000]}, start=10**9 * (i + 1))
        files.append(f"split_{i}.mcap")
        (part / f"part{i}_0.mcap").rename(folder / files[i])
    check(Run.open(folder), {"truth/los": los})  # by name order: no metadata.yaml
    assert "metadata.yaml" in Run.open(folder).problems[0]
    info = {"rosbag2_bagfile_information": {"relative_file_paths": files}}
    (folder / "metadata.yaml").write_text(yaml.safe_dump(info))
    check(Run.open(folder), {"truth/los": los})
    assert Run.open(folder).problems == ()
    (folder / files[1]).unlink()
    assert "split_1.mcap" in Run.open(folder).problems[0]


def test_file_wise_and_message_wise_compression(tmp_path: Path, signals) -> None:
    bag = write_bag(tmp_path / "bag", signals, periods={"camera/los": 20})
    raw = (bag / "bag_0.mcap").read_bytes()
    (bag / "bag_0.mcap").unlink()
    (bag / "bag_0.mcap.zstd").write_bytes(zstandard.compress(raw))
    text = (bag / "metadata.yaml").read_text().replace("bag_0.mcap", "bag_0.mcap.zstd")
    (bag / "metadata.yaml").write_text(text)
    check(Run.open(bag), signals)

    los = signals["truth/los"]
    folder = tmp_path / "message"
    folder.mkdir()
    with (folder / "m_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        kind = "geometry_msgs/msg/Vector3Stamped"
        schema = writer.register_schema(kind, "ros2msg", DEFINITIONS[kind].encode())
        channel = writer.register_channel("/telescope/truth/los", "cdr", schema)
        for i, row in enumerate(los):
            data = zstandard.compress(Encoder(kind, 2, "los").encode(10**9 + 10**6 * i, row))
            writer.add_message(channel, i, data, i)
        writer.finish()
    info = {"relative_file_paths": ["m_0.mcap"], "compression_mode": "MESSAGE", "compression_format": "zstd"}
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": info}))
    check(Run.open(folder), {"truth/los": los})


@pytest.mark.parametrize(
    ("options", "share"), [({"chunk_size": 200_000}, 0.3), ({"chunks": False}, 0.6), ({"compression": "none"}, 0.95)]
)
def test_cut_off_file_gives_what_is_there_and_says_so(tmp_path: Path, signals, options, share) -> None:
    bag = write_bag(tmp_path / "bag", signals, periods={"camera/los": 20}, storage=McapStorage(**options))
    file = bag / "bag_0.mcap"
    raw = file.read_bytes()
    file.write_bytes(raw[: int(share * len(raw))])
    run = Run.open(bag)
    got = run["truth/los"]
    assert 0.5 * share * N < len(got) <= N
    assert np.array_equal(got.values[:, :2], signals["truth/los"][: len(got)])
    assert any("truncated" in problem for problem in run.problems)


def test_gaps_duplicates_and_disorder_are_counted(tmp_path: Path) -> None:
    los = np.arange(200.0).reshape(100, 2)
    start, ms = 10**12, 10**6
    stamps = start + ms * np.arange(100)
    stamps[50:] += 5 * ms  # five samples missing
    stamps[[10, 11]] = stamps[[11, 10]]
    stamps[70] = stamps[69]
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": los}, stamps={"truth/los": stamps}))
    topic, state = run["truth/los"], run["truth/los"].integrity
    assert (state.messages, len(topic)) == (100, 99)
    assert (state.out_of_order, state.duplicates, state.conflicts) == (1, 1, 1)
    assert state.missing == 6  # five, and the one whose stamp was overwritten
    assert state.gaps[0] == (pytest.approx(0.049), 5)
    assert np.all(np.diff(topic.stamp) > 0)
    assert topic.values[10, 0] == 22.0  # sorted by stamp: rows 10 and 11 changed places


def test_messages_before_the_run_begins_are_left_out(tmp_path: Path) -> None:
    """A plant that waits sends stamp zero; a recorder that was there already has them in the bag."""
    los = np.random.default_rng(0).standard_normal((500, 2))
    stamps = np.append(np.zeros(100, np.int64), 10**15 + 10**6 * np.arange(400))
    topic = Run.open(write_bag(tmp_path / "bag", {"truth/los": los}, stamps={"truth/los": stamps}))["truth/los"]
    assert (len(topic), topic.integrity.unstamped, topic.integrity.messages) == (400, 100, 500)
    assert (topic.integrity.missing, topic.integrity.conflicts) == (0, 0)
    assert np.array_equal(on_grid(topic)[0][:, :2], los[100:])


def test_changing_frame_names_do_not_disturb(tmp_path: Path) -> None:
    """Frame names of other and of equal total length: the layout of the first message does not fit all of them."""
    kind = JOINT_STATE
    folder = tmp_path / "b"
    folder.mkdir()
    rows = np.random.default_rng(2).standard_normal((60, 6))
    with (folder / "b_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(kind, "ros2msg", DEFINITIONS[kind].encode())
        channel = writer.register_channel("/telescope/pma/command", "cdr", schema)
        for i, row in enumerate(rows):
            frame = ["pma", "abcdefg", "a_much_longer_frame_name", "abcde"][i % 4]
            writer.add_message(channel, i, bytes(Encoder(kind, 6, frame).encode(10**9 + 10**6 * i, row)), i)
        writer.finish()
    assert np.array_equal(Run.open(folder)["pma/command"].values, rows)


def test_part_of_a_run(tmp_path: Path, signals) -> None:
    bag = write_bag(tmp_path / "bag", signals, periods={"camera/los": 20})
    small = write_bag(tmp_path / "small", signals, periods={"camera/los": 20}, storage=McapStorage(chunk_size=20_000))
    packed = tmp_path / "packed.mcap.zstd"
    packed.write_bytes(zstandard.compress((small / "small_0.mcap").read_bytes()))
    for path in (bag, small, packed):
        run = Run.open(path, start=1.0, stop=1.5)
        assert np.array_equal(run["truth/los"].values[:, :2], signals["truth/los"][1000:1500])
        assert set(run.topics) == set(signals)
        assert run.problems == ()


def test_a_part_behind_a_chunk_that_is_left_out_is_whole() -> None:
    """The first chunk, read for the origin, is outside; what lies between it and the part is not lost."""
    run = Run.open(Path(__file__).parents[3] / "bags/reference", start=2.5, stop=3.5)
    assert run.problems == () and len(run["truth/los"]) == 1000


def test_memory_limit(tmp_path: Path, signals) -> None:
    bag = write_bag(tmp_path / "bag", signals, periods={"camera/los": 20})
    need = Run.open(bag)["m1/accel"].nbytes
    run = Run.open(bag, memory_limit=need + 1000)  # topic by topic
    check(run, signals)
    small = Run.open(bag, memory_limit=need // 4)
    with pytest.raises(BagError, match="start= and stop="):
        small["truth/los"]
    part = Run.open(bag, memory_limit=need // 4, stop=0.1)
    assert len(part["truth/los"]) == 100


# -- bad input ---------------------------------------------------------------------------------------------------


def test_two_plants_in_one_bag(tmp_path: Path) -> None:
    los = np.random.default_rng(0).standard_normal((100, 2))
    a = write_bag(tmp_path / "a", {"/one/truth/los": los})
    b = write_bag(tmp_path / "b", {"/two/truth/los": 2 * los})
    (b / "b_0.mcap").rename(a / "b_0.mcap")
    (a / "metadata.yaml").unlink()
    with pytest.raises(BagError, match=r"must hold one plant, got \['/one', '/two'\]"):
        Run.open(a)
    assert np.array_equal(Run.open(a, namespace="/two")["truth/los"].values[:, :2], 2 * los)
    with pytest.raises(BagError, match="namespace must be one of"):
        Run.open(a, namespace="/three")


def test_two_publishers_on_one_topic(tmp_path: Path) -> None:
    los = np.random.default_rng(0).standard_normal((200, 2))
    stamps = 10**9 + 10**6 * np.repeat(np.arange(100), 2)
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": los}, stamps={"truth/los": stamps}))
    assert run["truth/los"].integrity.conflicts == 100
    with pytest.raises(BagError, match="two publishers"):
        on_grid(run["truth/los"])


def test_irregular_stamps_and_clock_jump(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    stamps = 10**9 + np.cumsum(rng.integers(500_000, 1_500_000, 1000))
    run = Run.open(write_bag(tmp_path / "a", {"truth/los": np.zeros((1000, 2))}, stamps={"truth/los": stamps}))
    with pytest.raises(BagError, match="grid"):
        on_grid(run["truth/los"])
    stamps = 10**9 + 10**6 * np.arange(1000)
    stamps[500:] += 10**15
    run = Run.open(write_bag(tmp_path / "b", {"truth/los": np.zeros((1000, 2))}, stamps={"truth/los": stamps}))
    with pytest.raises(BagError, match="clock was stepped"):
        on_grid(run["truth/los"])


def test_unknown_topic_and_empty_window(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", {"truth/los": np.zeros((5, 2))})
    with pytest.raises(BagError, match="no topic 'camera/los'"):
        Run.open(bag)["camera/los"]
    with pytest.raises(BagError, match="stop must be after start"):
        Run.open(bag, start=2, stop=1)
