"""The wall clock is set during a run: nothing may happen to the loop."""

import shutil
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from los_testbed.run.runner import Runner
from ros_runs import PLANT, assert_gaps_are_counted, assert_plant_is_recorded, config_for

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.ros
SOURCE = Path(__file__).parents[1] / "support" / "clock_step.c"
HOUR = 3600


@pytest.fixture
def steps(tmp_path, monkeypatch):
    """File with the offset [s] of the wall clock of all processes that are started from now on."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler to build the clock with")
    library, offset = tmp_path / "clock_step.so", tmp_path / "offset"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(SOURCE), "-ldl"], check=True)
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
