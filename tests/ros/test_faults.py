"""Faults in a running loop: processes killed, ended and stopped, rogue publishers. The plant goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from glob import glob
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bystander import Bystander, kill_a_node
from los_testbed.bags.cdr import codec_for
from los_testbed.bags.repair import repair_bag
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import FSM_COMMAND, ISOLATOR_ACCEL, PMA_COMMAND, SENSORS, TRUTH_LOS
from los_testbed.run import replay
from los_testbed.run.results import RunError
from los_testbed.run.runner import Runner
from ros_faults import diagnostics, run_with_fault
from ros_runs import (
    PLANT,
    PLANT_TOPICS,
    assert_plant_is_recorded,
    config_for,
    judged_at_pace,
    lost_samples,
    span_of,
    until,
)
from support.unjudged import judged

from pointing_analysis.read.run import Run
from pointing_analysis.read.unsent import unsent
from pointing_analysis.replay.replay import compare
from pointing_analysis.requirements.summary import summarise

MS = 1_000_000
M1_ACCEL = next(topic for topic in SENSORS if topic.name == "m1/accel")


def mirror_angle(bag):
    """Stamps, and the mirror's angles that the plant applied: its strain gauge (noise 1e-8 rad)."""
    gauge = Run.open(bag)["fsm/strain_gauge"]
    return gauge.stamp, gauge.values[:, :2]


@pytest.mark.parametrize("name", ["estimator", pytest.param("controller", marks=pytest.mark.slow)])
def test_a_killed_node_is_replaced_and_the_plant_goes_on(tmp_path, name):
    """Nothing in shared memory is left of it: a lock there that died with its holder would stop the nodes that live."""
    killed: list[Any] = []
    threads: list[Any] = []
    before = set(glob("/dev/shm/*fastrtps*"))

    def kill(runner):
        for pid in runner.processes.values():
            threads.extend(Path(path).read_text().strip() for path in glob(f"/proc/{pid}/task/*/comm"))
        killed.extend(kill_a_node(runner, name))

    # long enough for the new node to find the recorder, too
    results = run_with_fault(tmp_path, 500, kill, after=5000)
    assert sum(thread.startswith("dds.udp") for thread in threads) >= 8, "the names of its threads are known"
    assert not [thread for thread in threads if "shm" in thread]
    assert set(glob("/dev/shm/*fastrtps*")) <= before
    assert len(results.failures) == 1
    assert f"{name} ended unexpectedly (signal 9)" in results.failures[0]
    run = Run.open(results.bag)
    commands = run["fsm/command"]
    assert_plant_is_recorded(run, int(results.statistics["plant"]["ticks"]))
    stamp, angle = mirror_angle(results.bag)
    gaps = np.diff(commands.stamp)
    widest = int(np.argmax(gaps))
    assert gaps[widest] > 50 * MS, "commands stopped"
    assert commands.stamp[widest] < killed[1] and commands.stamp[widest + 1] > killed[0], "when the node was killed"
    assert commands.stamp[-1] > stamp[-1] - 2000 * MS, "and came back"
    # the new node may find the plant before it finds the recorder: only the plant knows how long it was without
    missed = int(results.statistics["plant"]["missed_ticks"])
    assert missed > 50
    within = (stamp > commands.stamp[widest]) & (stamp <= commands.stamp[widest + 1])
    at_zero = np.abs(angle[within]).max(axis=1) < 1e-7
    assert at_zero.sum() > 0.8 * min(missed, within.sum()) - 40, "without commands the mirror goes to zero and stays"


def test_without_commands_the_mirror_goes_smoothly_to_zero_and_comes_back(tmp_path):
    stopped, told_between = [], []

    def stop_for_a_while(runner):
        pid = runner.processes["controller"]
        seen = Bystander(runner.domain, hears=[TRUTH_LOS])
        try:
            told_between.append(time.time_ns())
            os.kill(pid, signal.SIGSTOP)
            time.sleep(0.3)  # what the bystander has still to read is from before
            stopped.append(seen.next(TRUTH_LOS))
            stopped.append(seen.next(TRUTH_LOS, stopped[0] + 500 * MS))
            time.sleep(2.0)  # what the plant says about it goes to the recorder
        finally:
            os.kill(pid, signal.SIGCONT)
            told_between.append(time.time_ns())
            seen.close()

    results = run_with_fault(tmp_path, 800, stop_for_a_while, after=3000)
    assert not results.failures
    run = Run.open(results.bag)
    stamp, angle = mirror_angle(results.bag)
    inside = (stamp > stopped[0] + 100 * MS) & (stamp < stopped[1])
    assert inside.sum() > 20
    if judged_at_pace(run, "the share of samples that are recorded"):
        assert inside.sum() > 350
    assert np.abs(angle[inside]).max() < 1e-7, "at zero while there are no commands"
    assert run["fsm/command"].stamp[-1] > stamp[-1] - 2000 * MS, "commands came back"
    assert np.abs(angle[-300:]).max() > 5e-5, "and are obeyed"
    # by pi/40 of 1e-4 rad a tick while fading; in normal motion 3 Hz * 1e-4 rad times the ticks that a command is held
    steps = np.abs(np.diff(angle[600:], axis=0) / (np.diff(stamp[600:]) / MS)[:, None]).max()
    assert steps < 1e-4 * (np.pi / 40 + 2 * np.pi * 3 * 1e-3 * RunConfig().hold_ticks) * 1.5
    reports = list(diagnostics(results.bag, "plant"))
    told = [time for time, level, text in reports if level == 2 and "no valid commands" in text]
    assert any(told_between[0] < time < told_between[1] for time in told), "it is said while it lasts"
    assert len(told) < len(reports), "and not always"
    assert any(time > told_between[1] and "no valid commands" not in text for time, _, text in reports), "it is over"


def test_a_stopped_recorder_does_not_touch_the_loop_and_its_losses_are_counted(tmp_path):
    def stop_for_a_while(runner):
        pid = runner.processes["recorder"]
        os.kill(pid, signal.SIGSTOP)
        time.sleep(0.5)
        os.kill(pid, signal.SIGCONT)

    results = run_with_fault(tmp_path, 500, stop_for_a_while, after=1000)
    assert not results.failures
    run = Run.open(results.bag)
    truth = run["truth/los"]
    ticks = int(results.statistics["plant"]["ticks"])
    edges = truth.lost_before + truth.lost_after  # what the plant had no time to send
    assert (truth.stamp[-1] - truth.stamp[0]) // MS + 1 + edges == ticks and edges < 100, "the recorder came back"
    missing = {name: ticks - len(run[name]) for name in run.topics if name != "camera/los"}
    missing["camera/los"] = -(-ticks // 20) - len(run["camera/los"])
    lost = sum(count - unsent(run, name) for name, count in missing.items())
    assert int(results.statistics["recorder"]["samples_lost"]) == lost, "what the plant had no time to send is not lost"
    if judged_at_pace(run, "that a stopped recorder costs the others nothing"):
        assert int(results.statistics["estimator"]["gap_ticks"]) < 250, "the others did not notice"


@pytest.mark.further
def test_a_killed_recorder_loses_at_most_what_is_not_yet_written(tmp_path):
    """It writes once a second; a busy machine may take another one."""
    done = []

    def kill(runner):
        done.append(runner.ticks_done)
        os.kill(runner.processes["recorder"], signal.SIGKILL)

        until((tmp_path / "bag-2").exists, "no second bag")

    results = run_with_fault(tmp_path, 2500, kill, after=700)
    assert "recorder ended unexpectedly (signal 9)" in results.failures[0]
    salvage = repair_bag(tmp_path / "bag", tmp_path / "saved")
    run = Run.open(tmp_path / "saved")
    second = Run.open(results.bag)
    if judged_at_pace(second, "that a recorder writes once a second"):
        assert (salvage.last_stamp - run["truth/los"].stamp[0]) // MS > done[0] - 2000
    assert results.bag.name == "bag-2"
    assert len(second["truth/los"]) > 100
    if judged_at_pace(second, "that the second bag has most of the rest of the run"):
        assert len(second["truth/los"]) > 500
    ticks = int(results.statistics["plant"]["ticks"])
    assert len(run["truth/los"]) + len(second["truth/los"]) < ticks
    assert_plant_is_recorded(second, len(span_of(second)), joined=True)
    lost = int(results.statistics["plant"].get("lost_periods", 0))  # they may be at the ends
    spanned = (span_of(second)[-1] - span_of(run)[0]) // MS + 1
    assert ticks - 100 - lost < spanned <= ticks, "the plant went on all the time"


def test_a_killed_plant_is_replaced_the_others_stay_and_nothing_recorded_is_lost(tmp_path):
    results = run_with_fault(tmp_path, 1500, lambda r: os.kill(r.processes["plant"], signal.SIGKILL), 4.0)
    assert "plant ended unexpectedly (signal 9)" in results.failures[0]
    assert str(tmp_path / "bag") in results.failures[1]
    assert len(results.failures) == 2, "estimator, controller and recorder are the same processes"
    assert results.earlier == [tmp_path / "bag"]
    assert results.bag == tmp_path / "bag-2"
    before, after = Run.open(results.earlier[0]), Run.open(results.bag)
    for run in (before, after):
        assert not run.problems
        assert not any(run[name].integrity.conflicts for name in PLANT_TOPICS)
    assert len(span_of(before)) >= 1500
    assert_plant_is_recorded(before, len(span_of(before)))
    ticks = int(results.statistics["plant"]["ticks"])
    assert_plant_is_recorded(after, ticks)
    assert 0 <= len(span_of(before)) + ticks - 4000 < 1000, "the run ends when it was to end"
    assert after["truth/los"].stamp[0] > before["truth/los"].stamp[-1]
    # all three start anew with the plant: the replay of the second part from zero gives its commands, bit by bit
    whole = not any(lost_samples(after, name) for name in (*PLANT_TOPICS, "camera/los"))
    if judged(whole, "the replay of a run after its plant was killed", "samples were lost"):
        assert compare(after, replay.drive(after, replay.controllers(after), lambda done, total: None)).identical


WRONG = ("limit", "not_finite")
UNREADABLE = "unreadable_/telescope/fsm/command"


@pytest.mark.further
def test_a_rogue_publisher_is_counted_by_reason_and_never_obeyed(tmp_path):
    """80 messages of each kind; what the rogue sends is wrong whenever it arrives."""
    fsm, pma, m1 = codec_for(FSM_COMMAND), codec_for(PMA_COMMAND), codec_for(M1_ACCEL)
    sent = {}

    def intrude(runner):
        rogue = Bystander(runner.domain, (FSM_COMMAND, PMA_COMMAND, M1_ACCEL), [ISOLATOR_ACCEL])
        try:
            cut = bytes(fsm.encode(MS, np.zeros(2)))[:32]
            # each reader finds the rogue in its own time: before that, the middleware gives it nothing
            sent["before"] = rogue.send_until_counted(FSM_COMMAND, cut, "recorder", UNREADABLE)
            sent["after"] = rogue.send_until_counted(FSM_COMMAND, cut, "plant", "rejected_fsm_size")
            rogue.send_until_counted(PMA_COMMAND, pma.encode(1, np.zeros(6)), "plant", "rejected_pma_off_grid")
            rogue.send_until_counted(M1_ACCEL, m1.encode(MS, np.zeros(6)), "estimator", "rejected_foreign")
            for _ in range(80):
                now = rogue.next(ISOLATOR_ACCEL)
                soon, past = now + 10_000 * MS, now - 500 * MS
                rogue.send(PMA_COMMAND, pma.encode(now, np.full(6, 316.0)))
                rogue.send(PMA_COMMAND, pma.encode(now, np.full(6, np.inf)))
                rogue.send(FSM_COMMAND, fsm.encode(now, np.full(2, -5.3e-2)))
                rogue.send(FSM_COMMAND, fsm.encode(now, np.full(2, np.nan)))
                rogue.send(FSM_COMMAND, fsm.encode(soon, np.full(2, 1e-3)))
                rogue.send(FSM_COMMAND, fsm.encode(past, np.full(2, 1e-3)))
                rogue.send(FSM_COMMAND, fsm.encode(now + 1, np.full(2, 1e-3)))
                rogue.send(FSM_COMMAND, bytes(fsm.encode(now, np.zeros(2)))[:32])
                rogue.send(FSM_COMMAND, b"\x00\x00" + bytes(fsm.encode(now, np.zeros(2)))[2:])
                rogue.send(M1_ACCEL, m1.encode(now + 1, np.zeros(6)))
                rogue.send(M1_ACCEL, m1.encode(soon, np.zeros(6)))
                time.sleep(0.01)  # the nodes of the loop read best effort: what they have no time for is dropped
            rogue.settle()
        finally:
            rogue.close()

    results = run_with_fault(tmp_path, 300, intrude, after=500)
    plant, estimator = results.statistics["plant"], results.statistics["estimator"]
    # the loop's readers are best effort: on a loaded machine the system may drop a message before they see it
    counts = {f"fsm_{r}": plant[f"rejected_fsm_{r}"] for r in (*WRONG, "future", "off_grid", "size", "encoding")}
    counts |= {"fsm_foreign, valid but for their age and their sender": plant["rejected_fsm_foreign"]}
    counts |= {f"pma_{r}": plant[f"rejected_pma_{r}"] for r in WRONG}
    counts |= {f"estimator_{r}": estimator[f"rejected_{r}"] for r in ("off_grid", "future")}
    for reason, count in counts.items():
        assert 0 < int(count) <= 80 + (sum(sent.values()) if reason == "fsm_size" else 0), (reason, counts)
    if judged_at_pace(Run.open(results.bag), "that nearly all wrong messages are seen"):
        assert min(map(int, counts.values())) >= 76, counts
    # the recorder's readers are reliable: nothing is missing of what was sent once it knew the rogue
    all_known = 160 + sent["after"]
    assert all_known < int(results.statistics["recorder"][UNREADABLE]) <= all_known + sent["before"]
    truth = Run.open(results.bag)["truth/los"].stamp
    lost = int(plant.get("lost_periods", 0))  # they may be at the ends
    assert int(plant["ticks"]) - 100 - lost < (truth[-1] - truth[0]) // MS + 1 <= int(plant["ticks"])
    angle = mirror_angle(results.bag)[1]
    assert np.isfinite(angle).all()
    if judged_at_pace(Run.open(results.bag), "that the mirror does not follow a rogue"):
        assert np.abs(angle).max() < 3e-4, "1e-3 was asked for by the rogue, 1e-4 by the controller"
    assert any("commands rejected" in text for _, level, text in diagnostics(results.bag, "plant") if level == 1)


FAILING_RECORDER = """
import sys
from los_testbed.bags.writer import BagWriter
from los_testbed.nodes import recorder

def fail(self, metadata=None):
    raise OSError(28, "No space left on device")

BagWriter.close = fail
sys.exit(recorder.main())
"""


def test_a_recorder_that_fails_while_it_is_stopped_gives_its_own_reason(tmp_path):
    """And not that it was waited for in vain."""
    commands = {"plant": PLANT, "recorder": [sys.executable, "-c", FAILING_RECORDER]}
    with pytest.raises(RunError, match=r"recorder: .*No space left on device.*los-testbed bag repair") as told:
        Runner(config_for(tmp_path, duration=1.0), commands=commands).run()
    assert told.value.code == 1
    repair_bag(tmp_path / "bag", tmp_path / "saved")
    assert len(Run.open(tmp_path / "saved")["truth/los"]) > 100


def end_once(name):
    return lambda runner: os.kill(runner.processes[name], signal.SIGTERM)


def until_replaced(name):
    """End the node, and wait until another one was started and works."""

    def fault(runner):
        before = runner.processes[name]
        os.kill(before, signal.SIGTERM)
        until(lambda: runner.processes[name] != before and (name, "ready") in runner._seen, f"no other {name}")

    return fault


@pytest.mark.parametrize("name", ["controller", pytest.param("estimator", marks=pytest.mark.slow)])
def test_a_follower_that_is_told_to_end_by_a_stranger_is_replaced(tmp_path, name):
    # long enough for the new node to find the recorder, too
    results = run_with_fault(tmp_path, 400, until_replaced(name), after=5000)
    told = [line for line in results.failures if not line.startswith("recorder")]  # starved, it may be replaced as well
    assert told == [f"{name} ended unexpectedly (signal 15); it was restarted"]
    run = Run.open(results.bag)
    assert run["fsm/command"].stamp[-1] > run["truth/los"].stamp[-1] - 2_000_000_000, "commands came back"


def test_a_recorder_that_is_told_to_end_by_a_stranger_records_the_rest_of_the_run(tmp_path):
    results = run_with_fault(tmp_path, 500, end_once("recorder"), 1.5)
    assert not results.failures
    assert results.bag == tmp_path / "bag"
    run = Run.open(results.bag)
    assert not run.problems
    assert_plant_is_recorded(run, int(results.statistics["plant"]["ticks"]))


def test_in_lockstep_it_ends_the_run_with_the_reason(tmp_path):
    with pytest.raises(RunError, match=r"^controller ended unexpectedly \(signal 15\)") as told:
        run_with_fault(tmp_path, 300, end_once("controller"), 60.0, mode="lockstep")
    assert told.value.code == 1
    problems = summarise(Run.open(tmp_path / "bag"), transient=0.05).problems
    assert any(text.startswith("the run failed: controller ended unexpectedly") for text in problems)


def test_a_recorder_that_is_killed_when_the_run_is_over_is_named_with_what_it_has_left(tmp_path):
    """So late that no other one can be there in time."""

    def progress(ticks):
        if ticks >= 1300 and not ended:
            ended.append(runner.processes["recorder"])
            os.kill(ended[0], signal.SIGKILL)

    ended, runner = [], None
    runner = Runner(config_for(tmp_path, duration=1.5), progress, {"plant": PLANT})
    with pytest.raises(RunError) as told:
        runner.run()
    text = str(told.value)
    assert text.startswith("recorder ended unexpectedly (signal 9)"), text
    assert text.endswith(f"{tmp_path / 'bag'} (incomplete: los-testbed bag repair {tmp_path / 'bag'})"), text
    assert "KeyboardInterrupt" not in text and "there is no bag" not in text
    assert told.value.code == 1


def test_too_little_memory_for_the_nodes_is_refused_at_once(tmp_path):
    """The middleware of a process that cannot map its stacks waits in silence."""
    command = [sys.executable, "-m", "los_testbed.cli.app", "run", "--duration=1", f"--output={tmp_path / 'bag'}"]
    limited = ["bash", "-c", 'ulimit -v 700000 && exec "$@"', "bash", *command]
    done = subprocess.run(
        limited, capture_output=True, text=True, timeout=600, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    )
    assert done.returncode == 2
    assert done.stderr.startswith("los-testbed: memory of a process (ulimit -v) must be at least"), done.stderr
    assert "got 700000" in done.stderr and "too little memory" in done.stderr
    assert not (tmp_path / "bag").exists()
