"""Runs with the emulator of a rig in the place of the telescope, by the command line and over UDP."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from los_testbed.api import analyse
from los_testbed.parts.device_contract import ASKED, CONFIRMED, NOT_ZERO
from los_testbed.run.results import RunError
from los_testbed.run.runner import Runner
from ros_faults import when_running
from ros_runs import config_for, private_domain
from simple_telescope import write_controllers

from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.read.run import Run

SUPPORT = Path(__file__).parents[1] / "support"
VARIABLES = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
DRIVER = "los_testbed.rig.udp:UdpRig"


@contextmanager
def emulator(*options):
    """An emulator that is ready, and the address to reach it at."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    physics = json.dumps({"plant": "simple_telescope:SimpleTelescope", "device_address": address})
    process = subprocess.Popen(
        [sys.executable, "-m", "los_testbed.rig.emulator", "--priority", "--config", physics, *options],
        stdout=subprocess.PIPE,
        text=True,
        cwd=SUPPORT,
        env=VARIABLES,
    )
    try:
        assert json.loads(process.stdout.readline()) == {"event": "ready"}
        yield process, address
    finally:
        process.terminate()
        process.wait(20)


def command_of(folder, device, duration, *options):
    """Command line of a run with a device and laws of a few states."""
    files = write_controllers(folder)
    command = [sys.executable, "-m", "los_testbed.cli.app", "run", f"--device={device}", f"--duration={duration}"]
    command += ["--camera-latency=7", f"--domain={private_domain()}", "--no-report", "--max-missed=100"]
    command += ["--hold-ticks=1000", "--fade-ticks=1000"]  # the emulator may get no processor for a while
    return [*command, f"--k-fsm={files['k_fsm']}", f"--k-pma={files['k_pma']}", f"--output={folder / 'bag'}", *options]


def finished(command, folder):
    """The finished command; drivers in the folder are found."""
    variables = {**VARIABLES, "PYTHONPATH": os.pathsep.join((str(folder), os.environ.get("PYTHONPATH", "")))}
    return subprocess.run(command, capture_output=True, text=True, env=variables, timeout=500)


def fly(folder, duration, *options):
    """A run with an emulator; the finished command, what the emulator said, and the bag."""
    with emulator(*options) as (process, address):
        done = finished(command_of(folder, DRIVER, duration, f"--set=device_address={address}"), folder)
    return done, [json.loads(line) for line in process.communicate()[0].splitlines()], folder / "bag"


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


def test_a_tick_whose_samples_were_lost_is_not_missed_by_the_loop(tmp_path):
    """Each of them is followed by one that holds its command for want of anything to answer, and by nothing else."""
    done, _, bag = fly(tmp_path, 2, "--loss=0.2")
    assert done.returncode == ExitCode.FINISHED, done.stdout + done.stderr
    plant = Run.open(bag).parameters["statistics"]["plant"]
    assert plant["held_without_samples"] == plant["device_absent_accel_Ip"] and int(plant["held_without_samples"]) > 100
    assert int(plant["missed_ticks"]) + int(plant["held_without_samples"]) <= 2001


def test_a_rig_that_freezes_ends_the_run_with_a_whole_bag_and_an_exit_code(tmp_path):
    done, said, bag = fly(tmp_path, 20, "--fault=frozen", "--fault-at=0.8")
    assert done.returncode == ExitCode.DEVICE, done.stdout + done.stderr
    line = done.stderr.splitlines()[-1]
    assert f"device {DRIVER}: " in line
    # the rig says that it is at zero; its gauges may be frozen elsewhere
    assert re.search(f"frozen for 200 ms; ({ASKED}|{CONFIRMED})", line)
    assert [event for event in said if event["event"] == "closed"][-1]["applied"] == 0.0
    run = Run.open(bag)
    assert not run.problems and len(run["fsm/command"]) > 100
    assert "frozen" in run.parameters["statistics"]["plant"]["device_fault"]


def test_a_rig_that_waits_for_the_start_of_its_run_has_lost_nothing_when_it_begins(tmp_path):
    with emulator("--drift-ppm=500") as (process, address):
        words = command_of(tmp_path, DRIVER, 1, f"--set=device_address={address}", "--wait-for-start")
        run = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=VARIABLES)
        try:
            assert json.loads(process.stdout.readline())["event"] == "opened"
            time.sleep(12.0)  # a drift of 6 ms, and packets for ten buffers
            start = [sys.executable, "-m", "los_testbed.cli.app", "control", "start", f"--domain={private_domain()}"]
            subprocess.run(start, check=True, timeout=600, env=VARIABLES)
            out = run.communicate(timeout=200)[0]
        finally:
            run.kill()
    assert run.returncode == ExitCode.FINISHED, out
    plant = Run.open(tmp_path / "bag").parameters["statistics"]["plant"]
    assert "device_clock_jumps" not in plant and "device_packets_lost" not in plant
    assert float(plant["device_clock_drift_ppm"]) > 300, "the clock was followed all the time"


@pytest.mark.parametrize(
    ("fault", "said"),
    [("deaf", "clock requests unanswered"), ("stuck", "mirror not following its command for 2100 ms")],
)
def test_a_rig_that_ignores_its_commands_ends_the_run_and_is_not_judged_later(tmp_path, fault, said):
    done, _, bag = fly(tmp_path, 60, f"--fault={fault}", "--fault-at=1")
    assert done.returncode == ExitCode.DEVICE, done.stdout + done.stderr
    line = done.stderr.splitlines()[-1]
    assert said in line and CONFIRMED in line, "the rig answers that it is at zero"
    result = analyse(bag)
    note = result.requirements[0]["note"]
    assert result.verdict == "not judged" and (said in note or note.startswith("the mirror did not follow its command"))


def test_nothing_is_confirmed_over_a_dead_line(tmp_path):
    done, _, _ = fly(tmp_path, 20, "--fault=silent", "--fault-at=0.8")
    assert done.returncode == ExitCode.DEVICE, done.stdout + done.stderr
    assert f"no sample for 2100 ms; {ASKED}" in done.stderr.splitlines()[-1]


def device_config(folder, monkeypatch, name, **values):
    """Configuration of a run with a rig of tests/support/plain_rig.py, and the file of its openings."""
    monkeypatch.chdir(SUPPORT)
    opened = folder / "opened"
    return config_for(folder, device=f"plain_rig:{name}", device_address=str(opened), duration=30.0, **values), opened


@pytest.mark.parametrize(
    ("name", "said", "zero"),
    [
        ("Dying", "plant ended unexpectedly (exit code 7)", NOT_ZERO),
        ("Returning", "read must return a sequence of samples, got None", ASKED),
        ("Hanging", "read failed: TimeoutError: it did not return within 0.5 s", ASKED),
        ("Late", "accel_Ip, accel_M1, accel_M2, fsm_angle late for 140 ms", ASKED),
        ("WithoutFrames", "each sensor must send samples before the run, got none of camera_los", ASKED),
        pytest.param("HangingForGood", "plant has not responded for 5 s", NOT_ZERO, marks=pytest.mark.slow),
    ],
)
def test_a_driver_at_fault_ends_the_run_once_and_the_message_says_where_the_mirror_is(
    tmp_path, monkeypatch, name, said, zero
):
    config, opened = device_config(tmp_path, monkeypatch, name, hang_timeout=5.0)
    with pytest.raises(RunError) as told:
        Runner(config).run()
    assert told.value.code == ExitCode.DEVICE
    assert said in str(told.value) and zero in str(told.value)
    assert opened.read_text() == "opened\n", "it is not opened again"


def test_on_a_device_a_law_that_dies_is_not_started_again(tmp_path, monkeypatch):
    config, opened = device_config(tmp_path, monkeypatch, "FaultyRig")
    killed = []

    def kill(runner):
        killed.append(runner.processes["estimator"])
        os.kill(killed[0], signal.SIGKILL)

    results = when_running(config, kill, 500)
    assert results.failures == ["estimator_controller ended unexpectedly (signal 9): the run was ended"]
    assert int(results.statistics["plant"]["ticks"]) < config.ticks and results.bag is not None
    assert results.statistics["plant"]["device_zero"] == ASKED and opened.read_text() == "opened\n"
