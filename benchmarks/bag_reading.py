"""Reading a bag into arrays: pointing_analysis against rosbags and mcap-ros2-support, on the same bag in the same run.

    python benchmarks/bag_reading.py [BAG] [--seconds 10] [--json]

Without a bag a synthetic one is written: the nine topics of the testbed at 1 kHz. Each reader delivers the same thing:
stamps and values of every topic as arrays. ``--json`` prints one object in place of the table:
``{"ratio_rosbags", "ratio_mcap_ros2", "equal"}`` (times of the other reader over ours).
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lftkit.arrays import FloatArray
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.messages.message_types import COLUMNS
from pointing_analysis.read.run import Run

Arrays = dict[str, tuple[NDArray[np.int64], FloatArray]]


def synthetic(folder: Path, seconds: float) -> Path:
    """A bag with the topics and rates of the testbed."""
    rng = np.random.default_rng(0)
    n = round(1000 * seconds)
    signals = {k: rng.standard_normal((n, 6)) for k in ("isolator/accel", "m1/accel", "m2/accel", "pma/command")}
    signals |= {
        k: rng.standard_normal((n, 2)) for k in ("fsm/strain_gauge", "los_estimate", "fsm/command", "truth/los")
    }
    signals["camera/los"] = rng.standard_normal((n // 20, 2))
    return write_bag(folder / "bag", signals, periods={"camera/los": 20})


def ours(bag: Path) -> Arrays:
    """pointing_analysis."""
    run = Run.open(bag)
    return {f"{run.namespace}/{name}": (run[name].stamp, run[name].values) for name in run.topics}


def _row(kind: str, m: Any) -> list[float]:
    if kind == "Vector3Stamped":
        return [m.vector.x, m.vector.y, m.vector.z]
    if kind == "AccelStamped":
        a = m.accel
        return [a.linear.x, a.linear.y, a.linear.z, a.angular.x, a.angular.y, a.angular.z]
    return list(m.effort)


def _arrays(rows: dict[str, tuple[list[int], list[list[float]]]]) -> Arrays:
    return {k: (np.array(s, dtype=np.int64), np.array(v)) for k, (s, v) in rows.items()}


def rosbags(bag: Path) -> Arrays:
    """rosbags, with the type store it recommends for ROS 2 Jazzy."""
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    rows: dict[str, tuple[list[int], list[list[float]]]] = {}
    with Reader(bag) as reader:
        chosen = [c for c in reader.connections if c.msgtype in COLUMNS]
        for connection, _, raw in reader.messages(connections=chosen):
            message: Any = store.deserialize_cdr(raw, connection.msgtype)
            stamps, values = rows.setdefault(connection.topic, ([], []))
            stamp = message.header.stamp
            stamps.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
            values.append(_row(connection.msgtype.rsplit("/", 1)[1], message))
    return _arrays(rows)


def mcap_ros2(bag: Path) -> Arrays:
    """mcap-ros2-support."""
    from mcap_ros2.reader import read_ros2_messages

    rows: dict[str, tuple[list[int], list[list[float]]]] = {}
    for file in sorted(bag.glob("*.mcap")) if bag.is_dir() else [bag]:
        for item in read_ros2_messages(str(file)):
            if item.schema.name not in COLUMNS:
                continue
            stamps, values = rows.setdefault(item.channel.topic, ([], []))
            stamp = item.ros_msg.header.stamp
            stamps.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
            values.append(_row(item.schema.name.rsplit("/", 1)[1], item.ros_msg))
    return _arrays(rows)


def timed(read: Callable[[Path], Arrays], bag: Path, repeats: int) -> tuple[float, Arrays]:
    """Shortest time of several readings [s] (what is longer was spent waiting for the machine), and what was read."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        result = read(bag)
        times.append(time.perf_counter() - start)
    return min(times), result


def equal(a: Arrays, b: Arrays) -> bool:
    """Whether two readers delivered the same stamps and values, bit by bit (NaN equal to NaN)."""
    return a.keys() == b.keys() and all(
        np.array_equal(a[k][0], b[k][0]) and np.array_equal(a[k][1], b[k][1], equal_nan=True) for k in a
    )


def main() -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", nargs="?", type=Path)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of the synthetic bag")
    parser.add_argument("--rounds", type=int, default=3, help="how often each reader reads the bag")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bag = arguments.bag or synthetic(Path(folder), arguments.seconds)
        ours(bag), rosbags(bag)  # imports and caches, outside the timing
        # In turns, so that a busy machine disturbs all of them alike.
        own_time = rosbags_time = mcap_time = float("inf")
        for _ in range(arguments.rounds):
            seconds, own = timed(ours, bag, 3)
            own_time = min(own_time, seconds)
            seconds, first = timed(rosbags, bag, 1)
            rosbags_time = min(rosbags_time, seconds)
            seconds, second = timed(mcap_ros2, bag, 1)
            mcap_time = min(mcap_time, seconds)
    same = equal(own, first) and equal(own, second)
    messages = sum(len(stamps) for stamps, _ in own.values())
    if arguments.json:
        ratios = {"ratio_rosbags": rosbags_time / own_time, "ratio_mcap_ros2": mcap_time / own_time}
        print(json.dumps({**{k: round(v, 2) for k, v in ratios.items()}, "equal": same}))
        return
    for name, seconds in (("pointing_analysis", own_time), ("rosbags", rosbags_time), ("mcap-ros2-support", mcap_time)):
        print(f"{name:20s} {seconds:8.3f} s  {1e6 * seconds / messages:7.2f} us/message  x {seconds / own_time:.1f}")
    print(f"{messages} messages, values {'equal' if same else 'DIFFERENT'}")


if __name__ == "__main__":
    main()
