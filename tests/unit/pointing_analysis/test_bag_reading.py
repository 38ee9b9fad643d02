"""Every kind of bag is read to the same values; every defect, loss, stall and clock step is named."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zstandard
from los_testbed.cli.app import main
from mcap.writer import Writer

from pointing_analysis.indices.synthetic import McapStorage, write_bag
from pointing_analysis.read.arrivals import Arrivals, arrivals
from pointing_analysis.read.mcap.bag_files import bag_files
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
        {"namespace": "/"},
        {"namespace": "/lab/telescope_2/"},
    ],
    ids=str,
)
def test_every_layout_and_namespace_gives_the_same_values(tmp_path: Path, signals, options) -> None:
    space, storage = options.pop("namespace", ""), McapStorage(**options)
    topics = {f"{space}{name}": values for name, values in signals.items()}
    bag = write_bag(tmp_path / "bag", topics, periods={f"{space}camera/los": 20}, storage=storage)
    run = Run.open(bag)
    check(run, signals)
    assert run.problems == ()
    check(Run.open(bag / "bag_0.mcap"), signals)


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


def written(folder: Path, topic: str, kind: str, messages: Iterable[bytes]) -> Path:
    """A folder with a file m_0.mcap of these messages."""
    folder.mkdir()
    with (folder / "m_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(kind, "ros2msg", DEFINITIONS[kind].encode())
        channel = writer.register_channel(f"/telescope/{topic}", "cdr", schema)
        for i, data in enumerate(messages):
            writer.add_message(channel, i, data, i)
        writer.finish()
    return folder


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

    los, kind = signals["truth/los"], "geometry_msgs/msg/Vector3Stamped"
    encoder = Encoder(kind, 2, "los")
    messages = (zstandard.compress(encoder.encode(10**9 + 10**6 * i, row)) for i, row in enumerate(los))
    folder = written(tmp_path / "message", "truth/los", kind, messages)
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
    rows = np.random.default_rng(2).standard_normal((60, 6))
    encoders = [Encoder(JOINT_STATE, 6, name) for name in ("pma", "abcdefg", "a_much_longer_frame_name", "abcde")]
    messages = (bytes(encoders[i % 4].encode(10**9 + 10**6 * i, row)) for i, row in enumerate(rows))
    folder = written(tmp_path / "b", "pma/command", JOINT_STATE, messages)
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


@pytest.mark.parametrize(
    ("steps", "conflicts", "message"),
    [
        (np.tile([10**6, 0], 500), 500, "two publishers"),
        (np.random.default_rng(0).integers(500_000, 1_500_000, 1000), 0, "grid"),
        (np.where(np.arange(1000) == 500, 10**15, 10**6), 0, "clock was stepped"),
    ],
    ids=["two publishers", "irregular", "a step of the clock"],
)
def test_stamps_that_are_no_grid_are_refused(tmp_path: Path, steps: np.ndarray, conflicts: int, message: str) -> None:
    los, stamps = np.random.default_rng(0).standard_normal((1000, 2)), 10**9 + np.cumsum(steps)
    topic = Run.open(write_bag(tmp_path / "bag", {"truth/los": los}, stamps={"truth/los": stamps}))["truth/los"]
    assert topic.integrity.conflicts == conflicts
    with pytest.raises(BagError, match=message):
        on_grid(topic)


def test_unknown_topic_and_empty_window(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", {"truth/los": np.zeros((5, 2))})
    with pytest.raises(BagError, match="no topic 'camera/los'"):
        Run.open(bag)["camera/los"]
    with pytest.raises(BagError, match="stop must be after start"):
        Run.open(bag, start=2, stop=1)


def test_no_link_in_the_folder_of_a_bag_is_followed(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", {"truth/los": np.ones((200, 2))})
    write_bag(tmp_path / "other", {"truth/los": np.zeros((100, 2))})
    (tmp_path / "bag" / "metadata.yaml").unlink()
    (tmp_path / "bag" / "link_1.mcap").symlink_to(next((tmp_path / "other").glob("*.mcap")))
    assert len(Run.open(tmp_path / "bag")["truth/los"]) == 200
    assert any("links" in problem and "link_1.mcap" in problem for problem in bag_files(tmp_path / "bag").problems)
    for file in (tmp_path / "bag").glob("bag*.mcap"):
        file.unlink()
    with pytest.raises(BagError, match="got links to files only"):
        bag_files(tmp_path / "bag")


MS = 1_000_000
START = 1_700_000_000_123_456_789
PERIODS = [1, 10, 100]


def times(n: int, period_ms: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Even stamps, recorded 0.2 to 3 ms later, in their order."""
    stamps = START + np.arange(n, dtype=np.int64) * period_ms * MS
    late = np.random.default_rng(seed).uniform(0.2, 3.0, n) * MS
    return np.maximum.accumulate(stamps + late.astype(np.int64)), stamps


def kinds(found: Arrivals) -> list[str]:
    return [event.kind for event in found.events]


@pytest.mark.parametrize("period", PERIODS)
def test_even_times_with_jitter_and_drifting_clocks_have_no_finding(period: int) -> None:
    for seed in range(5):
        logged, stamps = times(3000, period, seed)
        drift = (50e-6 * (stamps - stamps[0])).astype(np.int64)  # 50 ppm
        for slower in (logged, logged + drift, logged - drift):
            found = arrivals(slower, stamps)
            assert found.events == ()
            assert found.period == pytest.approx(period * 1e-3)
            assert found.lost == 0


@pytest.mark.parametrize("period", PERIODS)
def test_lost_messages_are_counted(period: int) -> None:
    """Any number, anywhere but at the ends."""
    rng = np.random.default_rng(period)
    for _ in range(20):
        logged, stamps = times(1000, period)
        gone = rng.choice(np.arange(1, 999), size=int(rng.integers(1, 60)), replace=False)
        found = arrivals(np.delete(logged, gone), np.delete(stamps, gone))
        assert found.lost == gone.size
        assert set(kinds(found)) == {"gap"}


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("lost", [0, 3])
def test_a_stall_is_no_loss_unless_messages_are_lost_in_it(period: int, lost: int) -> None:
    logged, stamps = times(3000, period)
    length = max(1000 * MS, 20 * period * MS)
    after = int(np.searchsorted(stamps, stamps[400] + length))
    late = logged.copy()
    late[400:after] = logged[after]
    gone = np.arange(405, 405 + lost)
    found = arrivals(np.delete(late, gone), np.delete(stamps, gone))
    assert found.lost == lost
    (stall,) = found.of("stall")
    assert stall.size == pytest.approx(length * 1e-9, rel=0.02)
    assert stall.at == pytest.approx(399 * period * 1e-3, abs=0.005)
    assert found.of("clock step") == ()


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("seconds", [-7.5, -0.5, 0.5, 7.5, 3600.0])
def test_a_step_of_either_clock_is_one_finding(period: int, seconds: float) -> None:
    """Forwards and backwards, of the sender and of the recorder; no message is lost and none stalls."""
    logged, stamps = times(2000, period)
    step = np.where(np.arange(2000) >= 1000, round(seconds * 1e9), 0)
    for found, sign in ((arrivals(logged, stamps + step), -1.0), (arrivals(logged + step, stamps), 1.0)):
        assert kinds(found) == ["clock step"]
        assert found.events[0].size == pytest.approx(sign * seconds, abs=0.005)
        assert found.lost == 0


def test_a_loss_at_a_clock_step_is_counted_by_the_other_clock() -> None:
    logged, stamps = times(2000, 10)
    step = np.where(np.arange(2000) >= 1000, 5_000 * MS, 0)
    gone = np.arange(1000, 1007)
    found = arrivals(np.delete(logged, gone), np.delete(stamps + step, gone))
    assert sorted(kinds(found)) == ["clock step", "gap"]
    assert found.lost == 7


def test_messages_of_a_slow_link_are_no_clock_steps() -> None:
    """Delays that scatter over four periods: alone, and with a step of the stamps that is seen through them."""
    rng = np.random.default_rng(3)
    logged, stamps = times(2000, 5)
    late = logged + rng.integers(0, 20 * MS, 2000)
    assert kinds(arrivals(late, stamps)) == []
    (step,) = arrivals(late, stamps + np.where(np.arange(2000) >= 1000, 500 * MS, 0)).events
    assert step.kind == "clock step" and step.size == pytest.approx(-0.5, abs=0.005)


def test_without_stamps_a_gap_is_only_a_gap() -> None:
    logged, _ = times(1000, 10)
    found = arrivals(np.delete(logged, np.arange(500, 560)))
    assert kinds(found) == ["gap"]
    assert found.lost is None
    assert found.events[0].size == pytest.approx(0.61, abs=0.005)
    back = np.where(np.arange(1000) >= 300, -2_000 * MS, 0)
    assert kinds(arrivals(logged + back)) == ["clock step"]


def test_verify_lists_the_times_of_a_foreign_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A bag of another program: lost messages of a stamped topic, a gap of one without, and a whole topic."""
    external_bags = pytest.importorskip("support.external_bags", reason="could not import 'rosbags'")
    n, rate = 600, 100.0
    stamps = external_bags.START + np.arange(n) * round(1e9 / rate)
    logged = stamps + 2 * MS
    logged[300:330] = logged[330]  # the recorder stalled
    topics: dict[str, Any] = {
        "/imu": ("sensor_msgs/msg/Imu", np.zeros((n, 2))),
        "/plain": ("geometry_msgs/msg/Vector3", np.zeros((n, 2))),
    }
    bag = external_bags.write_external(tmp_path / "bag", topics, rate, logged)
    assert main(["bag", "verify", str(bag), "--json"]) == 0
    shown = capsys.readouterr()
    content = json.loads(shown.out.splitlines()[-1])
    (event,) = content["times"]["/imu"]["events"]
    assert event["kind"] == "stall" and event["size"] == pytest.approx(0.3, abs=0.01)
    (event,) = content["times"]["/plain"]["events"]
    assert event["kind"] == "gap" and event["size"] == pytest.approx(0.31, abs=0.01)
    row = next(row for row in content["checks"] if row["name"] == "times of the messages")
    assert row["state"] == "irregular" and row["found"] == "1 gap, 1 stall"
    row = next(row for row in content["checks"] if row["name"] == "lost messages")
    assert row["found"] == "none; not known of 1 topic without stamps or a regular rate"  # not a loss-free bag
    assert "clock steps" in shown.err


def test_parts_of_a_file_that_changed_places_lose_nothing() -> None:
    stamps = 1_000_000 * np.arange(6000)
    order = np.r_[0:1000, 2000:3000, 1000:2000, 3000:6000]
    found = arrivals(stamps[order] + 500_000, stamps[order])
    assert found.lost == 0 and not found.events


@pytest.mark.parametrize("swapped", [1, 3, 40])
def test_messages_that_changed_places_in_the_file_are_not_missing(swapped: int) -> None:
    """Each with its stamp and its time of recording; a clock that jumped back has stamps that go on."""
    stamps = np.arange(2000) * 1_000_000
    places = np.arange(2000)
    for k in range(swapped):
        places[[100 + 20 * k, 103 + 20 * k]] = places[[103 + 20 * k, 100 + 20 * k]]
    found = arrivals((stamps + 300_000)[places], stamps[places])
    assert (found.lost, found.events) == (0, ())
    overtaken = arrivals(stamps + 300_000, stamps[places])  # and was recorded in the other order
    assert (overtaken.lost, overtaken.events) == (0, ())
    jumped = stamps + 300_000 - np.where(np.arange(2000) >= 1000, 50_000_000, 0)
    assert [event.kind for event in arrivals(jumped, stamps).events] == ["clock step"]
