"""Faults in a running loop: processes killed and stopped, rogue publishers. The plant goes on."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")
from los_testbed.bag_repair import repair_bag
from los_testbed.codecs import codec_for, stamp_of
from los_testbed.nodes.raw_topics import RawPublisher, RawSubscription
from los_testbed.nodes.shell import PROFILE, TRANSPORT
from los_testbed.runner import RunError, Runner
from los_testbed.topics import FSM_COMMAND, ISOLATOR_ACCEL, M1_ACCEL, PMA_COMMAND
from rclpy.context import Context
from rclpy.node import Node
from ros_runs import PLANT, config_for

from pointing_analysis.read import Run

pytestmark = pytest.mark.ros
MS = 1_000_000


def run_with_fault(folder, at, fault, duration=4.0, **values):
    """Run, and call `fault(runner)` once in a thread when `at` ticks are done."""
    done, errors = [], []

    def act():
        try:
            fault(runner)
        except BaseException as error:
            errors.append(error)

    def progress(ticks):
        if ticks >= at and not done:
            done.append(threading.Thread(target=act))
            done[0].start()

    runner = Runner(config_for(folder, duration=duration, **values), progress, {"plant": PLANT})
    try:
        return runner.run()
    finally:
        if done:
            done[0].join()
        assert not errors, errors


def diagnostics(bag, name):
    """Levels and messages of one node, in order."""
    from diagnostic_msgs.msg import DiagnosticArray
    from mcap.reader import make_reader
    from rclpy.serialization import deserialize_message

    with next(bag.glob("*.mcap")).open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=["/diagnostics"]):
            for status in deserialize_message(message.data, DiagnosticArray).status:
                if status.name == f"telescope: {name}":
                    yield status.level[0], status.message, {v.key: v.value for v in status.values}


def mirror_angle(bag):
    """Mirror angle that the plant applied: its strain gauge (noise 1e-8 rad)."""
    return Run.open(bag)["fsm/strain_gauge"].values[:, :2]


@pytest.mark.parametrize("name", ["estimator", "controller"])
def test_a_killed_node_is_replaced_and_the_plant_goes_on(tmp_path, name):
    results = run_with_fault(tmp_path, 1000, lambda r: os.kill(r.processes[name], signal.SIGKILL), 6.0)
    assert len(results.failures) == 1
    assert f"{name} ended unexpectedly (signal 9)" in results.failures[0]
    run = Run.open(results.bag)
    assert len(run["truth/los"]) == len(run["m1/accel"]) == 6000
    commands = run["fsm/command"]
    gap = np.max(np.diff(commands.stamp)) / MS
    assert 50 < gap < 4000, "commands stopped, and came back"
    assert commands.stamp[-1] == run["truth/los"].stamp[-1]
    assert int(results.statistics["plant"]["missed_ticks"]) >= gap - 10


def test_without_commands_the_mirror_goes_smoothly_to_zero_and_comes_back(tmp_path):
    def stop_for_a_while(runner):
        pid = runner.processes["controller"]
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.5)
        os.kill(pid, signal.SIGCONT)

    results = run_with_fault(tmp_path, 1500, stop_for_a_while)
    assert not results.failures
    angle = mirror_angle(results.bag)
    assert len(angle) == 4000
    quiet = np.flatnonzero(np.all(np.abs(angle[1000:]) < 1e-7, axis=1))
    assert 350 < quiet.size < 1000, "about 475 ms at zero"
    assert np.all(np.diff(quiet) == 1), "one stretch"
    commands = Run.open(results.bag)["fsm/command"]
    assert commands.stamp[-1] == Run.open(results.bag)["truth/los"].stamp[-1], "commands came back"
    assert np.abs(angle[-500:]).max() > 5e-5, "and are obeyed"
    # the mirror turns at most by 3 Hz * 1e-4 rad in normal motion, and by pi/40 of 1e-4 rad while fading
    steps = np.abs(np.diff(angle[600:], axis=0)).max()
    assert steps < 1e-4 * (np.pi / 40) * 1.5
    levels = {level for level, _, _ in diagnostics(results.bag, "plant")}
    assert min(levels) <= 1, "the first report is from before the fault"
    assert any("no valid commands" in m for level, m, _ in diagnostics(results.bag, "plant") if level == 2)
    assert Run.open(results.bag)["truth/los"].integrity.missing == 0


def test_a_killed_recorder_loses_at_most_the_last_second(tmp_path):
    told = []

    def kill(runner):
        told.append(time.time_ns())
        os.kill(runner.processes["recorder"], signal.SIGKILL)

    results = run_with_fault(tmp_path, 2500, kill, 9.0)
    assert "recorder ended unexpectedly (signal 9)" in results.failures[0]
    salvage = repair_bag(tmp_path / "bag", tmp_path / "saved")
    run = Run.open(tmp_path / "saved")
    assert told[0] - salvage.last_stamp < 1.2e9
    for name in run.topics:
        assert run[name].integrity.missing == 0
    second = Run.open(results.bag)
    assert results.bag.name == "bag-2"
    assert len(second["truth/los"]) > 1000
    assert len(run["truth/los"]) + len(second["truth/los"]) < 9000
    assert int(results.statistics["plant"]["ticks"]) == 9000


def test_a_killed_plant_ends_the_run_and_the_bag_is_whole(tmp_path):
    with pytest.raises(RunError, match=r"plant ended unexpectedly \(signal 9\)"):
        run_with_fault(tmp_path, 1500, lambda r: os.kill(r.processes["plant"], signal.SIGKILL))
    run = Run.open(tmp_path / "bag")
    assert not run.problems
    assert len(run["truth/los"]) >= 1400


class Rogue:
    """A node that does not belong: it sends what it should not."""

    def __init__(self, domain):
        os.environ.update(
            FASTRTPS_DEFAULT_PROFILES_FILE=str(PROFILE),
            ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            FASTDDS_BUILTIN_TRANSPORTS=TRANSPORT,
        )
        self.context = Context()
        self.context.init(domain_id=domain)
        self.node = Node("rogue", context=self.context)
        self.topics = {
            t.name: RawPublisher(self.node, t.path, t.type_name) for t in (FSM_COMMAND, PMA_COMMAND, M1_ACCEL)
        }
        self.sensor = RawSubscription(self.node, ISOLATOR_ACCEL.path, ISOLATOR_ACCEL.type_name)
        time.sleep(1.0)

    def tick(self):
        """Stamp of the newest sample; its command is not there yet."""
        while self.sensor.take() is not None:
            pass
        while (taken := self.sensor.take()) is None:
            time.sleep(5e-5)
        return stamp_of(taken[0])

    def send(self, topic, data):
        self.topics[topic.name].publish(data)

    def close(self):
        self.node.destroy_node()
        self.context.shutdown()


def test_a_rogue_publisher_is_counted_by_reason_and_never_obeyed(tmp_path):
    def intrude(runner):
        rogue = Rogue(runner.domain)
        try:
            fsm, pma, m1 = codec_for(FSM_COMMAND), codec_for(PMA_COMMAND), codec_for(M1_ACCEL)
            for _ in range(200):
                now = rogue.tick()
                soon, past = now + 20 * MS, now - 500 * MS
                rogue.send(PMA_COMMAND, pma.encode(now, np.full(6, 316.0)))
                rogue.send(PMA_COMMAND, pma.encode(now, np.full(6, np.inf)))
                rogue.send(FSM_COMMAND, fsm.encode(soon, np.full(2, 1e-3)))
                rogue.send(FSM_COMMAND, fsm.encode(past, np.full(2, 1e-3)))
                rogue.send(FSM_COMMAND, fsm.encode(now + 1, np.full(2, 1e-3)))
                rogue.send(FSM_COMMAND, fsm.encode(now, np.full(2, np.nan)))
                rogue.send(FSM_COMMAND, bytes(fsm.encode(now, np.zeros(2)))[:32])
                rogue.send(FSM_COMMAND, b"\x00\x00" + bytes(fsm.encode(now, np.zeros(2)))[2:])
                rogue.send(M1_ACCEL, m1.encode(now, np.full(6, np.nan)))
                rogue.send(M1_ACCEL, m1.encode(now + 10_000 * MS, np.zeros(6)))
                time.sleep(0.004)
        finally:
            rogue.close()

    results = run_with_fault(tmp_path, 300, intrude, 6.0)
    plant, estimator = results.statistics["plant"], results.statistics["estimator"]
    for reason in ("future", "late", "off_grid", "size", "encoding"):
        assert int(plant.get(f"rejected_fsm_{reason}", 0)) >= 150, (reason, plant)
    # those that come before the controller's; later ones are duplicates before they are anything else
    assert int(plant.get("rejected_pma_limit", 0)) > 0
    assert int(plant.get("rejected_pma_not_finite", 0)) > 0
    assert int(estimator.get("rejected_future", 0)) >= 150
    assert int(plant["ticks"]) == 6000
    assert int(results.statistics["recorder"]["unreadable_/telescope/fsm/command"]) >= 300
    angle = mirror_angle(results.bag)
    assert np.isfinite(angle).all()
    assert np.abs(angle).max() < 3e-4, "1e-3 was asked for by the rogue, 1e-4 by the controller"
    warned = [m for level, m, _ in diagnostics(results.bag, "plant") if level == 1]
    assert any("commands rejected" in m for m in warned)


def test_dropped_camera_frames_do_not_stop_the_estimator(tmp_path):
    results = run_with_fault(tmp_path, 10**9, lambda r: None, 2.0, camera_dropout=0.5)
    run = Run.open(results.bag)
    assert 20 < run["camera/los"].integrity.nan < 80
    assert len(run["los_estimate"]) == 2000
    assert np.isfinite(run["los_estimate"].values).all()
    assert results.statistics["estimator"]["gap_ticks"] == "0"


def test_a_recorder_that_cannot_write_says_why(tmp_path):
    (tmp_path / "file").write_text("")
    config = config_for(tmp_path)
    from dataclasses import replace

    with pytest.raises((ValueError, RunError), match="is not a folder"):
        Runner(replace(config, output=str(tmp_path / "file" / "bag")), commands={"plant": PLANT}).run()


def test_a_full_disk_ends_the_run_with_the_reason_and_what_was_written_is_kept(tmp_path):
    small = tmp_path / "small"
    small.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=700k", "tmpfs", str(small)], capture_output=True)
    if mounted.returncode:
        pytest.skip("mounting a small file system is not permitted")
    try:
        with pytest.raises(RunError, match=r"recorder: .*No space left"):
            run_with_fault(tmp_path, 10**9, lambda r: None, 20.0, output=str(small / "bag"))
        salvage = repair_bag(small / "bag", tmp_path / "saved")
    finally:
        subprocess.run(["umount", "-l", str(small)], check=True)
    run = Run.open(tmp_path / "saved")
    assert salvage.chunks >= 1
    assert len(run["truth/los"]) > 300
    assert run["truth/los"].integrity.missing == 0


def test_busy_processors_do_not_stop_the_loop(tmp_path):
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 2)]
    try:
        results = run_with_fault(tmp_path, 10**9, lambda r: None, 4.0)
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()
    if results.warnings:
        pytest.skip(f"real time is not permitted here: {results.warnings}")
    assert int(results.statistics["plant"]["missed_ticks"]) <= 40  # 1 %; a tenth of what it is without priorities
    assert results.statistics["recorder"]["samples_lost"] == "0"
