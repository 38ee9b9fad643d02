"""Time in a run: a wall clock that is set, stamps on the grid of the steady clock and of acquisition, missed ticks."""

from __future__ import annotations

import json
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from los_testbed.bags.cdr import stamp_of
from los_testbed.run.runner import Runner
from mcap.reader import make_reader
from ros_faults import run_with_fault
from ros_runs import (
    PLANT,
    PLANT_TOPICS,
    assert_gaps_are_counted,
    assert_plant_is_recorded,
    config_for,
    live_nodes,
    lost_samples,
    span_of,
)
from simple_telescope import write_controllers

from pointing_analysis.read.run import Run
from pointing_analysis.read.unsent import unsent

SUPPORT = Path(__file__).parents[1] / "support"
HOUR = 3600


@pytest.fixture
def steps(tmp_path, monkeypatch):
    """File with the offset [s] of the wall clock of all processes that are started from now on."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler to build the clock with")
    library, offset = tmp_path / "clock_step.so", tmp_path / "offset"
    command = [compiler, "-shared", "-fPIC", "-O1", "-o", library, SUPPORT / "clock_step.c", "-ldl"]
    subprocess.run(command, check=True)
    offset.write_bytes(struct.pack("<q", 0))
    monkeypatch.setenv("LD_PRELOAD", str(library))
    monkeypatch.setenv("CLOCK_STEP_FILE", str(offset))
    return offset


def set_offset(file, seconds):
    with file.open("r+b") as stream:
        stream.write(struct.pack("<q", seconds))


def test_the_offset_reaches_processes(steps):
    """Otherwise the test below would prove nothing."""
    code = "import time, sys; print(time.time(), flush=True); sys.stdin.readline(); print(time.time())"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        before = float(child.stdout.readline())
        set_offset(steps, -HOUR)
        after = float(child.communicate(b"\n")[0])
    assert after - before == pytest.approx(-HOUR, abs=5)


def test_a_stepped_wall_clock_does_not_touch_the_loop(steps, tmp_path):
    config = config_for(tmp_path, duration=3.0, start_timeout=15.0)
    start_time, told = time.time(), []

    def progress(ticks):
        """A step at each word of the plant: one of them falls between a sample and its command."""
        told.append(ticks)
        set_offset(steps, 0 if ticks < 500 else HOUR if len(told) % 2 else -HOUR)

    results = Runner(config, progress, {"plant": PLANT}).run()
    assert not results.failures
    run = Run.open(results.bag)
    stamps = run["truth/los"].stamp
    assert abs(stamps[-1] / 1e9 - start_time) < HOUR / 2, "stamps go on from the start of the run"
    statistics = results.statistics
    assert_plant_is_recorded(run, 3000)
    assert_gaps_are_counted(run, "los_estimate", "estimator")
    assert_gaps_are_counted(run, "fsm/command", "controller")
    assert int(statistics["plant"]["lost_periods"]) < 1500, "an hour is not made up for"
    assert len(run["fsm/command"]) > 1500, "commands are obeyed after a step"
    assert 0 < float(statistics["plant"]["latency_max_us"]) < HOUR * 1e5, "an hour is no latency"


MS = 1_000_000
STOP_S = 0.3


@pytest.fixture(scope="module")
def stopped_twice(tmp_path_factory):
    """A run whose plant was stopped twice; the statistics and the bag."""

    def stop(runner):
        for _ in range(2):
            os.kill(runner.processes["plant"], signal.SIGSTOP)
            time.sleep(STOP_S)
            os.kill(runner.processes["plant"], signal.SIGCONT)
            time.sleep(STOP_S)

    results = run_with_fault(tmp_path_factory.mktemp("stopped"), 400, stop, duration=2.5)
    assert not results.failures
    return results, Run.open(results.bag)


def test_lost_periods_make_no_later_stamp_older(stopped_twice):
    """On the old clock the run ended 0.6 s later than its stamps say."""
    _, run = stopped_twice
    with next(run.path.glob("*.mcap")).open("rb") as stream:
        found = make_reader(stream).iter_messages(topics=["/telescope/truth/los"])
        stamp, sent = np.array([(stamp_of(message.data), message.publish_time) for _, _, message in found]).T
    slip = np.median((sent - stamp)[-200:]) - np.median((sent - stamp)[:200])
    assert abs(slip) < STOP_S / 2 * 1e9, f"stamps slipped by {slip / MS:.1f} ms"
    assert not np.any((stamp - stamp[0]) % MS)


def test_lost_periods_are_integrated_and_counted(stopped_twice):
    results, run = stopped_twice
    plant = results.statistics["plant"]
    lost = int(plant["lost_periods"])
    assert 2 * 0.8e3 * STOP_S < lost <= int(plant["missed_ticks"])
    assert int(plant["ticks"]) == round(1000 * run.parameters["duration"])
    for name in PLANT_TOPICS:
        assert lost_samples(run, name) == len(span_of(run)) - len(run[name]), name
    assert unsent(run, "truth/los") == int(plant["unsent_ticks"]) > 0
    truth = run["truth/los"]
    t, los = (truth.stamp - truth.stamp[0]) / 1e9, truth.values
    after = t > t[-1] - 0.2
    before = t < 0.4  # the disturbance is a function of the ticks that were integrated
    phase = [np.angle(np.mean((los[w, 1] + 1j * los[w, 0]) * np.exp(-6j * np.pi * t[w]))) for w in (before, after)]
    assert abs(np.angle(np.exp(1j * (phase[1] - phase[0])))) < 0.5, "3 Hz goes through 0.3 s by 5.7 rad"


TICKS = 600


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """What the plant of the user has seen."""
    folder = tmp_path_factory.mktemp("plain")
    config = config_for(folder, camera_latency=7.0, loop="fsm", priority=False)
    variables = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(config.domain)}
    command = [sys.executable, str(SUPPORT / "plain_plant.py"), str(config.domain), str(TICKS)]
    with live_nodes(config, folder, "estimator", "controller", variables=variables):
        done = subprocess.run(command, capture_output=True, text=True, env=variables, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_every_tick_gets_its_command(told):
    """Frames that are late and absent, and stamps beside the grid, made ticks incomplete before."""
    assert told["answered"] == TICKS
    assert told["reports"]["gap_ticks"] == "0"
    assert told["angle"] != 0.0, "the mirror follows the camera"


def test_frames_are_used_with_their_age_and_counted_by_name(told):
    """A frame is published 7 ticks late; DDS orders no topic before another, so it may be used some ticks later."""
    reports = told["reports"]
    assert 7.0 <= float(reports["frames_camera/los_age_max_ms"]) < 20.0, "used before the next frame is taken"
    assert int(reports["frames_camera/los_old"]) >= 24
    assert 2 <= int(reports["frames_camera/los_absent"]) <= 4
    assert not {"frames_camera/los_late", "frames_camera/los_off_phase", "frames_camera/los_early"} & set(reports)
    assert int(reports["off_grid_m1/accel"]) >= TICKS


SLOW = """
import time
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from titop_plant.telescope.load import load_telescope

class Slow(LosEstimator):
    def __init__(self):
        super().__init__(SampledSystem.from_file("k_fsm.json"), load_telescope().loop_ports.of_law("k_fsm"))
    def step(self, measurement, out):
        time.sleep(0.003)
        super().step(measurement, out)
"""


@pytest.mark.parametrize(
    ("limit", "code"), [(("--mode=realtime",), 4), pytest.param(("--max-missed=100",), 0, marks=pytest.mark.slow)]
)
def test_more_missed_ticks_than_the_limit_are_no_success(tmp_path, limit, code):
    write_controllers(tmp_path)
    (tmp_path / "slow.py").write_text(SLOW)
    command = [sys.executable, "-m", "los_testbed.cli.app", "run", "--duration=2", "--no-report", "--k-fsm=slow:Slow"]
    command += ["--domain=free", f"--output={tmp_path / 'bag'}", "--start=rest", *limit]
    variables = {**os.environ, "PYTHONPATH": str(tmp_path), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=variables, timeout=600)
    assert done.returncode == code, done.stdout + done.stderr
    if code:
        line = done.stderr.splitlines()[-1]
        assert line.startswith("los-testbed: missed ticks must be at most 0.5 % (--max-missed), got "), line
        assert line.endswith(f"the bag is whole: {tmp_path / 'bag'}")
    assert not Run.open(tmp_path / "bag").problems
