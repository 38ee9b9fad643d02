"""The emulator of a rig under the reference driver and its supervisor, without ROS: faults on both sides."""

import json
import os
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.device_contract import ACTIVE, ERROR, FINALIZED, DeviceError
from los_testbed.rig.emulator import Mirror, RigSettings
from los_testbed.rig.serial import SerialRig
from los_testbed.rig.supervisor import Supervisor
from los_testbed.rig.udp import UdpRig
from los_testbed.rig.wire import Kind, encode
from support.loop_rows import COMMANDS

from pointing_analysis.command.exit_codes import ExitCode

SUPPORT = Path(__file__).parents[3] / "support"
PLANT = "simple_telescope:SimpleTelescope"


class Rig:
    """An emulator, as a process, and the configuration to reach it with."""

    def __init__(self, *options):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            address = f"127.0.0.1:{free.getsockname()[1]}"
        self.config = RunConfig(device="rig", device_address=address, start="rest")
        physics = json.dumps({"plant": PLANT, "device_address": address})
        command = [sys.executable, "-m", "los_testbed.rig.emulator", "--config", physics, *options]
        variables = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=SUPPORT, env=variables)
        ready = self.next()
        assert ready["event"] == "ready"
        if "address" in ready:
            self.config = replace(self.config, device_address=ready["address"])

    def next(self):
        return json.loads(self.process.stdout.readline())

    def until(self, event):
        while (found := self.next())["event"] != event:
            pass
        return found

    def close(self):
        self.process.terminate()
        self.process.wait(20)
        self.process.stdout.close()


@pytest.fixture
def rig(request):
    made = Rig(*getattr(request, "param", ()))
    yield made
    made.close()


def patient(config):
    """The configuration with seconds of patience: on a busy machine the rig's process stands still for a while."""
    return replace(config, hold_ticks=1000, fade_ticks=1000)


def fly(supervisor, ticks, angle=1e-4):
    """Ticks of a loop that drives the mirror to an angle; how many were complete, and the last frames."""
    command, complete, frames = np.zeros(COMMANDS), 0, []
    command[0] = angle
    for _ in range(ticks):
        time.sleep(1e-3)
        supervisor.write(command, time.monotonic_ns())
        complete += supervisor.read(time.monotonic_ns())
        frames += supervisor.frames
    return complete, frames


def fly_until(supervisor, done, limit=60.0):
    """Ticks until a condition on the number of complete ones holds, however long the rig got no processor.

    How many were complete, and the last frames.
    """
    complete, frames, latest = 0, [], time.monotonic() + limit
    while not done(complete):
        assert time.monotonic() < latest, supervisor.statistics()
        found = fly(supervisor, 50)
        complete += found[0]
        frames += found[1]
    return complete, frames


@pytest.mark.parametrize("rig", [("--loss=0.02", "--reorder=0.02", "--watchdog=5000")], indirect=True)
def test_a_rig_flies_with_lost_and_reordered_packets_and_its_clock_is_known(rig):
    supervisor = Supervisor(UdpRig(), patient(rig.config))
    supervisor.open()

    def enough(complete):
        found = supervisor.statistics()
        return (
            complete > 100
            and int(found.get("device_packets_lost", 0)) > 5
            and int(found.get("device_packets_reordered", 0)) > 0
        )

    _, frames = fly_until(supervisor, enough)
    assert supervisor.state == ACTIVE and frames
    assert supervisor.measurement[20] == pytest.approx(1e-4, abs=1e-5), "the strain gauge sees the angle"
    ages = [time.monotonic_ns() - sample.acquired_ns for sample in frames[-1:]]
    assert 0 < ages[0] < 5e9, "times of acquisition are on the clock of this host"
    supervisor.end()
    assert supervisor.state == FINALIZED, supervisor.statistics()
    assert rig.until("safe")["why"] == "asked"
    assert rig.until("closed")["applied"] == 0.0


@pytest.mark.parametrize("rig", [("--serial=pty", "--loss=0.02", "--watchdog=5000")], indirect=True)
def test_a_rig_flies_over_a_serial_line_with_bytes_of_others_on_it(rig):
    driver = SerialRig()
    supervisor = Supervisor(driver, patient(rig.config))
    supervisor.open()
    fly_until(supervisor, lambda complete: complete > 20)
    with open(rig.config.device_address, "wb", buffering=0) as noise:
        noise.write(b"LOSR" + bytes(range(256)))
    _, frames = fly_until(supervisor, lambda complete: complete > 100)
    assert supervisor.state == ACTIVE and frames
    assert supervisor.measurement[20] == pytest.approx(1e-4, abs=1e-5), "the strain gauge sees the angle"
    assert float(supervisor.statistics()["device_clock_way_us"]) > 0 and driver.clock.jumps == 0
    supervisor.end()
    assert rig.until("closed")["applied"] == 0.0


def test_without_commands_the_rig_goes_safe_by_itself_and_a_stray_packet_moves_nothing(rig):
    driver = UdpRig()
    supervisor = Supervisor(driver, rig.config)
    supervisor.open()
    fly(supervisor, 50)
    host, port = rig.config.device_address.split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for key in (bytes(8), driver.key):  # the second even knows the key, and is another sender
            stranger.sendto(encode(Kind.COMMAND, 10**6, 0, np.full(COMMANDS, 1.0), key), (host, int(port)))
    found = rig.until("safe")
    assert found["why"] == "watchdog" and found["after_ms"] >= 50
    assert found["before"] <= 1.1e-4, "not the 5.3e-3 rad of a saturated mirror"
    supervisor.end()


@pytest.mark.parametrize(
    ("rig", "text"),
    [
        (("--fault=silent", "--fault-at=0.2"), "no sample for 2100 ms"),
        (("--fault=frozen", "--fault-at=0.2"), "frozen for 200 ms"),
        pytest.param(
            ("--fault=not_finite", "--fault-at=0.2"), "accel_Ip not finite for 2100 ms", marks=pytest.mark.slow
        ),
        pytest.param(("--fault=corrupt", "--fault-at=0.2"), "no sample for 2100 ms", marks=pytest.mark.slow),
        pytest.param(("--fault=brown_out", "--fault-at=0.2"), "no sample for 2100 ms", marks=pytest.mark.slow),
    ],
    indirect=["rig"],
)
def test_a_fault_of_the_rig_ends_the_run_with_mirror_and_forces_at_zero(rig, text):
    supervisor = Supervisor(UdpRig(), patient(rig.config))
    supervisor.open()
    with pytest.raises(DeviceError, match=text) as error:
        fly(supervisor, 5000)
    assert error.value.code == ExitCode.DEVICE
    assert supervisor.state == ERROR
    supervisor.end()
    assert rig.until("safe")["before"] <= 1.1e-4
    assert text in supervisor.statistics()["device_fault"]


@pytest.mark.parametrize("rig", [("--fault=outage", "--fault-at=0.2")], indirect=True)
def test_an_outage_of_the_line_brings_the_rig_to_zero_and_it_flies_again(rig):
    supervisor = Supervisor(UdpRig(), patient(rig.config))
    supervisor.open()
    fly_until(supervisor, lambda _: supervisor.counts["absent_accel_Ip"] > 60 and supervisor.frames)
    assert supervisor.state == ACTIVE
    found = rig.until("safe")
    assert found["why"] == "watchdog" and found["after_ms"] >= 50 and found["before"] <= 1.1e-4
    assert rig.next()["event"] == "active", "commands move it again"
    supervisor.end()


OPENED_AND_KILLED = """
import os, sys
from los_testbed.config.run_config import RunConfig
from los_testbed.rig.udp import UdpRig
UdpRig().open(RunConfig(device="rig", device_address=sys.argv[1], start="rest"))
os._exit(1)
"""


@pytest.mark.further
def test_a_rig_is_free_again_when_its_host_died_before_its_first_command(rig):
    subprocess.run([sys.executable, "-c", OPENED_AND_KILLED, rig.config.device_address], check=False, timeout=600)
    assert rig.next()["event"] == "opened"
    supervisor = Supervisor(UdpRig(), rig.config)
    supervisor.open()
    assert rig.next()["event"] == "opened", "by another host, within the time of an opening"
    supervisor.end()


def test_the_rig_has_limits_of_its_own_and_a_resonance():
    mirror = Mirror(5e-3, RigSettings(rate=1.0, resonance=100.0, damping=0.1))
    step = np.array([1e-4, 0.0])
    path = np.array([mirror.step(step)[0] for _ in range(400)])
    assert path.max() > 1.3e-4, "it swings beyond a step"
    assert path[-1] == pytest.approx(1e-4, rel=1e-3), "a steady command gives its angle"
    swing = np.diff(np.flatnonzero(np.diff(np.sign(path - 1e-4)) != 0)).mean()
    assert 500 / swing == pytest.approx(100.0, rel=0.05), "at its resonance"
    assert not mirror.limited
    slow = np.abs([mirror.step(np.array([1.0, 0.0]))[0] for _ in range(20)])
    assert mirror.limited and slow.max() <= 5e-3
    assert slow[0] < 2e-3, "no more than 1 mrad in a tick, and its swing"
    mirror.stop()
    assert not mirror.step(np.zeros(2)).any()
