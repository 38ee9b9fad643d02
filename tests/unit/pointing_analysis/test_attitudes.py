"""Quaternions as line of sight: the angles of an axis of the body about its mean, by rotations of scipy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pointing_analysis.read.attitude import line_of_sight, turned_about
from pointing_analysis.read.external_bag import candidates
from pointing_analysis.read.los_source import open_los
from pointing_analysis.read.messages.transforms import transforms

external_bags = pytest.importorskip("support.external_bags", reason="could not import 'rosbags'")
RATE = 200.0
AXES = {"x": np.eye(3)[0], "y": np.eye(3)[1], "z": np.eye(3)[2]}


def motion(n: int = 400, size: float = 1e-5) -> np.ndarray:
    """Rotation vectors [rad] without mean."""
    turns = size * np.random.default_rng(4).standard_normal((n, 3))
    return np.asarray(turns - turns.mean(axis=0))


def attitudes(turns: np.ndarray, seed: int = 7) -> np.ndarray:
    """Quaternions of a random attitude turned in the body, with a random sign."""
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], size=(len(turns), 1))
    return np.asarray(signs * (Rotation.random(random_state=seed) * Rotation.from_rotvec(turns)).as_quat())


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("seed", range(2))
def test_small_turns_are_their_components_across_the_axis(axis: str, seed: int) -> None:
    """To the second order of the angles; the sign of a quaternion and the attitude do not count."""
    turns = motion()
    first, second = ("xyz".index(one) for one in turned_about(axis))
    found = line_of_sight(attitudes(turns, seed), axis)
    np.testing.assert_allclose(found, turns[:, [first, second]], atol=10 * np.abs(turns).max() ** 2)


@pytest.mark.parametrize("axis", AXES)
def test_directions_are_those_of_the_rotated_axis(axis: str) -> None:
    """Large angles and any roll: by the directions of scipy's matrices, relative to the mean by scipy."""
    rng = np.random.default_rng(11)
    rotations = Rotation.random(random_state=1) * Rotation.from_rotvec(0.1 * rng.standard_normal((300, 3)))
    found = line_of_sight(rotations.as_quat(), axis)
    d = (rotations.mean().inv() * rotations).apply(AXES[axis])
    k, (first, second) = "xyz".index(axis), ("xyz".index(one) for one in turned_about(axis))
    np.testing.assert_allclose(np.tan(found[:, 0]), -d[:, second] / d[:, k], atol=1e-9)
    np.testing.assert_allclose(np.tan(found[:, 1]), d[:, first] / d[:, k], atol=1e-9)


def test_roll_about_the_line_of_sight_does_not_move_it() -> None:
    roll = np.zeros((50, 3))
    roll[:, 2] = np.linspace(-1.0, 1.0, 50)
    assert np.abs(line_of_sight(attitudes(roll), "z")).max() < 1e-12
    with pytest.raises(ValueError, match=r"within 0.5 rad of its mean attitude, got 1 rad"):
        line_of_sight(attitudes(roll), "x")


KINDS = {
    "sensor_msgs/msg/Imu": "orientation",
    "geometry_msgs/msg/PoseStamped": "pose.orientation",
    "geometry_msgs/msg/TransformStamped": "transform.rotation",
    "geometry_msgs/msg/Quaternion": "",
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_offers_each_axis_with_its_unit(tmp_path: Path, kind: str) -> None:
    turns = motion()
    bag = external_bags.write_external(tmp_path / "bag", {"/a": (kind, attitudes(turns))}, RATE)
    field = ".".join(filter(None, ("/a", KINDS[kind])))
    found = {one.name: (one.components, one.unit) for one in candidates(bag)}
    assert found == {
        f"{field}.x": (("about y", "about z"), "rad"),
        f"{field}.y": (("about z", "about x"), "rad"),
        f"{field}.z": (("about x", "about y"), "rad"),
    }
    run = open_los(bag, los=f"{field}.z", rate=RATE)
    np.testing.assert_allclose(run["truth/los"].values, turns[:, :2], atol=1e-9)
    assert any("from the mean attitude: a constant error is not seen" in problem for problem in run.problems)
    with pytest.raises(ValueError, match=f"must name a field, {field}.x or {field}.y or {field}.z, got"):
        open_los(bag, los="/a")
    with pytest.raises(ValueError, match=f"unit must be rad for {field}.z, got 'mas'"):
        open_los(bag, los=f"{field}.z", unit="mas")


def transform_messages(path: Path, frames: dict[str, np.ndarray]) -> Path:
    """A bag of /tf: each message has the transforms of all frames, in changing order, at stamps of their own."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    types, kind = external_bags.STORE.types, "tf2_msgs/msg/TFMessage"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/tf", kind, typestore=external_bags.STORE)
        for i in range(max(len(rows) for rows in frames.values())):
            stamp = external_bags.START + i * round(1e9 / RATE)
            sent = [
                external_bags._attitude("geometry_msgs/msg/TransformStamped", stamp, rows[i].tolist())
                for rows in frames.values()
                if i < len(rows)
            ]
            for message, name in zip(sent, frames):
                object.__setattr__(message, "child_frame_id", name)
            data = external_bags.STORE.serialize_cdr(types[kind](sent[:: 1 if i % 2 else -1]), kind)
            writer.write(connection, stamp, data)
    return path


def test_each_child_frame_of_tf_is_a_line_of_sight(tmp_path: Path) -> None:
    turns = {"camera": motion(), "a_longer_name": 3.0 * motion(), "short": motion(100)}
    frames = {name: attitudes(turned, k) for k, (name, turned) in enumerate(turns.items())}
    bag = transform_messages(tmp_path / "bag", frames)
    assert {one.name for one in candidates(bag)} == {
        f"/tf[{name}].rotation.{axis}" for name in frames for axis in "xyz"
    }
    for name, turned in turns.items():
        run = open_los(bag, los=f"/tf[{name}].rotation.z", rate=RATE)
        np.testing.assert_allclose(run["truth/los"].values, (turned - turned.mean(axis=0))[:, :2], atol=1e-8)
    with pytest.raises(ValueError, match=r"los must be one of /tf\[a_longer_name\].rotation.x .*got '/tf'"):
        open_los(bag, los="/tf")


@pytest.mark.parametrize("cut", [3, 7, 11, 40, 100, -1])
def test_a_truncated_transform_is_an_error(tmp_path: Path, cut: int) -> None:
    turn = external_bags._attitude("geometry_msgs/msg/TransformStamped", external_bags.START, [0.0, 0.0, 0.6, 0.8])
    kind = "tf2_msgs/msg/TFMessage"
    whole = bytes(external_bags.STORE.serialize_cdr(external_bags.STORE.types[kind]([turn, turn]), kind))
    assert [(child, rotation) for child, _, rotation in transforms(whole)] == 2 * [("camera", (0.0, 0.0, 0.6, 0.8))]
    with pytest.raises(ValueError, match=r"truncated|plain CDR"):
        transforms(whole[:cut])
    with pytest.raises(ValueError, match="truncated"):
        transforms(whole[:4] + b"\xff" * 4 + whole[8:])


def test_messages_without_an_attitude_are_excluded_and_counted(tmp_path: Path) -> None:
    """Drivers send zeros, REP 145 asks for them; NaN is no attitude, either."""
    turns = motion(100)
    sent = attitudes(turns)
    sent[40:43] = 0.0
    sent[60] = np.nan
    bag = external_bags.write_external(tmp_path / "bag", {"/imu": ("sensor_msgs/msg/Imu", sent)}, RATE)
    run = open_los(bag, los="/imu.orientation.y", rate=RATE)
    assert len(run["truth/los"]) == 96
    assert any("4 messages excluded: a quaternion must have norm 1" in problem for problem in run.problems)


@pytest.mark.parametrize("names", [("q1", "q2", "q3", "q4"), ("att_a", "att_b", "att_c", "att_d")])
def test_parts_of_a_quaternion_in_a_table_are_no_angles(tmp_path: Path, names: tuple[str, ...]) -> None:
    """Whatever its columns are called, and though its sign flips: twice its vector part is the rotation."""
    rng = np.random.default_rng(1)
    q = np.array([0.41, -0.57, 0.67, -0.22]) + 0.05 * rng.standard_normal((200, 4))
    q *= np.where(rng.random(200) < 0.3, -1.0, 1.0)[:, None] / np.sqrt(np.square(q).sum(axis=1))[:, None]
    file = tmp_path / "star_tracker.csv"
    table = np.column_stack([0.1 * np.arange(200), q])
    np.savetxt(file, table, delimiter=",", header=",".join(("time_s", *names)), comments="", fmt="%.12f")
    with pytest.raises(ValueError, match=f"los must be two angles, got {names[0]} and {names[1]} of the unit quat"):
        open_los(file, los=f"{names[0]},{names[1]}", unit="rad", time="time_s")
    flags = np.column_stack([table[:, 0], 1e-6 * q[:, :2], np.ones(200), np.zeros(200)])
    header = "time_s,x_rad,y_rad,valid,mode"
    np.savetxt(file, flags, delimiter=",", header=header, comments="", fmt="%.12g")
    assert len(open_los(file, los="x,y")["truth/los"]) == 200
