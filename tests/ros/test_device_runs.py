"""Runs with the emulator of a rig in the place of the telescope, by the command line and over UDP."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from los_testbed.exit_codes import ExitCode
from ros_runs import private_domain
from simple_telescope import write_controllers

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.ros
SUPPORT = Path(__file__).parents[1] / "support"
DRIVER = "los_testbed.device.udp:UdpRig"


def fly(folder, duration, *options):
    """A run with an emulator; the finished command, what the emulator said, and the bag."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    physics = json.dumps({"plant": "simple_telescope:SimpleTelescope", "device_address": address})
    variables = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    emulator = subprocess.Popen(
        [sys.executable, "-m", "los_testbed.device.emulator", "--priority", "--config", physics, *options],
        stdout=subprocess.PIPE,
        text=True,
        cwd=SUPPORT,
        env=variables,
    )
    files = write_controllers(folder)
    command = [sys.executable, "-m", "los_testbed.cli.app", "run", f"--device={DRIVER}", f"--duration={duration}"]
    command += [f"--set=device_address={address}", "--camera-latency=7", f"--domain={private_domain()}", "--no-report"]
    command += [f"--k-fsm={files['k_fsm']}", f"--k-pma={files['k_pma']}", "--max-missed=100"]
    try:
        assert json.loads(emulator.stdout.readline()) == {"event": "ready"}
        done = subprocess.run(
            [*command, f"--output={folder / 'bag'}"], capture_output=True, text=True, env=variables, timeout=500
        )
    finally:
        emulator.terminate()
        said = [json.loads(line) for line in emulator.communicate()[0].splitlines()]
    return done, said, folder / "bag"


def test_a_rig_without_truth_is_flown_and_the_verdict_is_on_its_camera(tmp_path):
    done, said, bag = fly(tmp_path, 3, "--no-truth", "--loss=0.01")
    assert done.returncode == ExitCode.FINISHED, done.stdout + done.stderr
    assert "the device gives no true line of sight: the verdicts are on the camera's" in done.stdout
    run = Run.open(bag)
    plant = run.parameters["statistics"]["plant"]
    assert plant["ticks"] == "3000" and plant["device_state"] in ("active", "finalized")
    assert abs(float(plant["device_clock_offset_ms"])) > 0 and float(plant["device_clock_way_us"]) > 0
    assert len(run["los_estimate"]) > 300 and len(run["camera/los"]) > 30
    events = [event["event"] for event in said]
    assert events[:2] == ["opened", "active"] and events[-1] == "closed"
    assert said[-1]["applied"] == 0.0


def test_a_rig_that_freezes_ends_the_run_with_a_whole_bag_and_an_exit_code(tmp_path):
    done, said, bag = fly(tmp_path, 20, "--fault=frozen", "--fault-at=0.8")
    assert done.returncode == ExitCode.DEVICE, done.stdout + done.stderr
    line = done.stderr.splitlines()[-1]
    assert f"device {DRIVER}: " in line and "frozen for 200 samples; mirror and forces were brought to zero" in line
    assert [event for event in said if event["event"] == "closed"][-1]["applied"] == 0.0
    run = Run.open(bag)
    assert not run.problems and len(run["fsm/command"]) > 100
    assert "frozen" in run.parameters["statistics"]["plant"]["device_fault"]
