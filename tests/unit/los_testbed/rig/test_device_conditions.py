"""What must not last on a device, how it ends, and what is said of mirror and forces, with drivers of a few lines."""

import time
from dataclasses import replace

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.device_contract import ASKED, CONFIRMED, NOT_ZERO, DeviceError, RigReport, Sample
from los_testbed.parts.run_parts import RunParts
from los_testbed.rig.supervisor import EVERY_TICK, Supervisor, SupervisorSettings
from plain_rig import PlainRig
from support.loop_rows import COMMANDS

from titop_plant.interface import CAMERA_PORT, GAUGE_PORT, TICK_NS

pytestmark = pytest.mark.usefixtures("still_clock")
SETTINGS = SupervisorSettings()
CONFIG = RunConfig(device="my:Rig", start="rest")
LIMIT = CONFIG.hold_ticks + CONFIG.fade_ticks + SETTINGS.following.patience
FRAME = RunParts(CONFIG).ports.ticks["camera_los"]


class Reporting(PlainRig):
    """A rig that says of itself what `report` returns, with whatever a test puts in place of a method."""

    def __init__(self):
        super().__init__()
        self.tick, self.commands, self.asked = 0, [], False

    def read(self, now_ns):
        self.tick += 1
        if self.tick % FRAME == 0:
            self.more.append(Sample(CAMERA_PORT, now_ns, self.noise(CAMERA_PORT)))
        return super().read(now_ns)

    def write(self, command, now_ns):
        super().write(command, now_ns)
        self.commands.append(command.copy())

    def safe(self):
        super().safe()
        self.asked = True

    def report(self):
        return RigReport(time.monotonic_ns(), safe=self.asked)


def fly(device, ticks=2000, command=None, settings=SETTINGS):
    """Ticks of a loop; the number of the tick that ended it, and its error, or None."""
    supervisor = Supervisor(device, CONFIG, settings)
    supervisor.open()
    wanted = np.zeros(COMMANDS)
    for k in range(ticks):
        time.sleep(1e-3)
        wanted[:2] = 1e-4 * np.sin(0.05 * k) if command is None else command(k)
        try:
            supervisor.write(wanted, time.monotonic_ns())
            supervisor.read(time.monotonic_ns())
        except DeviceError as error:
            return k + 1, str(error)
    supervisor.finish()
    return ticks, None


def reports(first, last, **said):
    """Make a rig that says more of itself from a tick to another one."""

    def make(device):
        usual = device.report
        device.report = lambda: replace(usual(), **said) if first <= device.tick < last else usual()

    return make


def samples(first, last, **changes):
    """Make a rig whose samples are others from a tick to another one: ports, and what becomes of a sample."""

    def make(device):
        usual = device.read

        def read(now_ns):
            came = usual(now_ns)
            if not first <= device.tick < last:
                return came
            return [changes[s.port](s) if s.port in changes else s for s in came if changes.get(s.port) is not ABSENT]

        device.read = read

    return make


ABSENT = object()
LATE = lambda sample: replace(sample, acquired_ns=sample.acquired_ns - 5 * TICK_NS)  # noqa: E731
FAR = lambda sample: replace(sample, values=sample.values + 1e3)  # noqa: E731
STUCK = lambda sample: replace(sample, values=0.0 * sample.values)  # noqa: E731


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (lambda first, last: reports(first, last, safe=True), "rig in its safe state while commanded for 140 ms"),
        (lambda first, last: reports(first, last, unanswered=True), "clock requests unanswered for 140 ms"),
        (lambda first, last: reports(first, last, limited=True), "commands limited by the rig for 140 ms"),
        (
            lambda first, last: samples(first, last, **{GAUGE_PORT: STUCK}),
            "mirror not following its command for 140 ms",
        ),
        (
            lambda first, last: samples(first, last, **dict.fromkeys(EVERY_TICK, LATE)),
            "accel_Ip, accel_M1, accel_M2, fsm_angle late for 140 ms",
        ),
        (lambda first, last: samples(first, last, accel_M1=FAR), "accel_M1 beyond range for 140 ms"),
        (lambda first, last: samples(first, last, fsm_angle=FAR), "fsm_angle beyond range for 140 ms"),
    ],
)
def test_what_lasts_for_longer_than_hold_fade_and_patience_is_a_fault(fault, said):
    device = Reporting()
    fault(300, 10_000)(device)
    tick, error = fly(device)
    assert said in error
    assert 299 + LIMIT < tick <= 300 + LIMIT + SETTINGS.following.block
    short = Reporting()
    fault(300, 300 + LIMIT - SETTINGS.following.block)(short)
    assert fly(short)[1] is None, "as long as it may last"


def test_frames_beyond_the_range_of_the_camera_are_not_used_and_end_the_run():
    device = Reporting()
    samples(300, 10_000, **{CAMERA_PORT: FAR})(device)
    tick, error = fly(device)
    assert "camera_los beyond range for 500 ms" in error
    assert tick == pytest.approx(300 + SETTINGS.frozen_frames * FRAME, abs=FRAME)


@pytest.mark.parametrize("wave", [lambda k: 1.0, lambda k: np.sign(np.sin(0.06 * k)) * (abs(np.sin(0.06 * k)) > 0.3)])
def test_a_command_that_stays_at_its_limit_ends_the_run(wave):
    """Also one that swings from one limit to the other; one that meets it now and then does not."""
    tick, error = fly(Reporting(), command=lambda k: 5.3e-3 * wave(k))
    assert "command at its limit for 1000 ms" in error and tick == pytest.approx(1000, abs=30)
    assert fly(Reporting(), command=lambda k: 5.3e-3 * np.clip(1.05 * np.sin(0.03 * k), -1.0, 1.0))[1] is None


@pytest.mark.parametrize("given", [None, 3, "samples", [None], [Sample("nothing", 0, np.zeros(2))]])
def test_a_driver_that_returns_no_samples_is_at_fault(given):
    device = Reporting()
    usual = device.read
    device.read = lambda now_ns: given if device.tick > 50 and not device.asked else usual(now_ns)  # type: ignore[method-assign]
    assert "read must " in fly(device)[1]


def test_a_call_that_does_not_return_is_interrupted_and_mirror_and_forces_are_asked_to_go_to_zero():
    device = Reporting()
    usual = device.read

    def read(now_ns):
        try:
            while device.tick == 100 and not device.asked:
                pass
        except Exception:
            pass
        return usual(now_ns)

    device.read = read  # type: ignore[method-assign]
    tick, error = fly(device, settings=replace(SETTINGS, call=0.05))
    assert tick == 101 and "read failed: TimeoutError: it did not return within 0.05 s" in error
    assert error.endswith(CONFIRMED) and device.called[-1] == "close"


@pytest.mark.parametrize("port", [CAMERA_PORT, "accel_M2"])
def test_a_sensor_without_a_first_sample_refuses_the_start(port):
    device = Reporting()
    samples(0, 10_000, **{port: ABSENT})(device)
    supervisor = Supervisor(device, CONFIG)
    supervisor.open()
    with pytest.raises(DeviceError, match=f"before the run, got none of {port} within 1.04 s"):
        supervisor.await_first()
    healthy = Supervisor(Reporting(), CONFIG)
    healthy.open()
    healthy.await_first()
    assert healthy.fault == ""


def test_the_last_command_fades_to_zero():
    device = Reporting()
    reports(300, 10_000, safe=True)(device)
    fly(device, command=lambda k: 1e-3)
    course = np.array([command[0] for command in device.commands[-CONFIG.fade_ticks - 1 :]])
    assert course[0] == 1e-3 and course[-1] == 0.0 and (np.diff(course) < 0).all()
    assert np.abs(np.diff(course)).max() < 1e-3 * np.pi / 2 / CONFIG.fade_ticks * 1.01, "a raised cosine"


def out(*arguments):
    raise OSError("cable")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, CONFIRMED),
        ({"report": lambda: RigReport(0, safe=True)}, ASKED),
        ({"report": lambda: None}, ASKED),
        ({"report": lambda: RigReport(time.monotonic_ns(), safe=False)}, ASKED),
        ({"at": lambda port: 1e-3 if port == GAUGE_PORT else 0.0}, ASKED),
        ({"report": None}, ASKED),
        ({"read": out}, ASKED),
        ({"write": out}, CONFIRMED),
        ({"report": None, "safe": out}, NOT_ZERO),
        ({"safe": out}, NOT_ZERO),
    ],
)
def test_at_zero_is_said_only_where_report_and_gauges_of_the_rig_say_it(change, said):
    """An old report, a flag beside gauges that see an angle, a driver that reports nothing, a dead line: no such."""
    device = Reporting()
    supervisor = Supervisor(device, CONFIG)
    supervisor.open()
    for _ in range(50):
        time.sleep(1e-3)
        supervisor.write(np.full(COMMANDS, 1e-4), time.monotonic_ns())
        supervisor.read(time.monotonic_ns())
    for name, method in change.items():
        setattr(device, name, method)
    supervisor.end()
    assert supervisor.zero == said and supervisor.statistics()["device_zero"] == said
    if (said == CONFIRMED and not change) or change == {"report": None}:
        supervisor.finish()
        return
    with pytest.raises(DeviceError, match=said) as told:
        supervisor.finish()
    failed = "write" in change or "safe" in change
    assert failed or "after safe() the rig must report that it is safe" in str(told.value)
