"""What the supervisor of a device makes of its samples, and what it says at the end, with drivers of a few lines."""

import math
import re
import time

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.device_contract import (
    ASKED,
    ERROR,
    FINALIZED,
    NOT_ZERO,
    TRUTH_PORT,
    DeviceError,
    Sample,
)
from los_testbed.rig.supervisor import EVERY_TICK, Supervisor, SupervisorSettings, refused_in_words
from los_testbed.rig.wire import Kind, Reader, encode
from plain_rig import PlainRig
from support.loop_rows import COMMANDS

from pointing_analysis.command.exit_codes import ExitCode
from titop_plant.interface import CAMERA_PORT, COLUMNS, TICK_NS

CONFIG = RunConfig(device="my:Rig", start="rest")
SETTINGS = SupervisorSettings()


pytestmark = pytest.mark.usefixtures("still_clock")


def watched(device):
    supervisor = Supervisor(device, CONFIG)
    supervisor.open()
    return supervisor


DAY, YEAR = 86_400 * 10**9, 365 * 86_400 * 10**9
OLD = 3 * TICK_NS
"""Age of an old sample that is used [ns]."""


@pytest.mark.parametrize("shift", [20 * YEAR, DAY, 5 * TICK_NS, -20 * YEAR, math.inf, -math.inf, math.nan])
def test_a_sample_of_a_time_that_cannot_be_costs_itself_alone(shift):
    device = PlainRig()
    supervisor = watched(device)
    now = time.monotonic_ns()
    for port in (CAMERA_PORT, TRUTH_PORT, EVERY_TICK[0]):
        device.more = [Sample(port, now + shift, device.noise(port))]
        assert supervisor.read(now)
        assert not supervisor.frames, f"{port}: it is not used"
        device.more = [Sample(CAMERA_PORT, now, device.noise(CAMERA_PORT))]
        assert supervisor.read(now) and len(supervisor.frames) == 1, "the next one is"
    found = supervisor.statistics()
    assert [found[f"device_impossible_time_{port}"] for port in (CAMERA_PORT, TRUTH_PORT, EVERY_TICK[0])] == ["1"] * 3
    assert float(found["device_age_max_us"]) < 1e6
    said = refused_in_words(supervisor.counts)
    assert len(said) == 1 and said[0].startswith("accel_Ip, camera_los, los_controlled: 1 samples with an acquisition")


@pytest.mark.parametrize(
    ("odd", "quiet", "said"),
    [
        (EVERY_TICK[:2], (), "accel_Ip, accel_M1 not finite for 140 ms"),
        (EVERY_TICK[:1], EVERY_TICK[1:2], "accel_Ip not finite for 140 ms, accel_M1 silent for 140 ms"),
        (EVERY_TICK, (), "accel_Ip, accel_M1, accel_M2, fsm_angle not finite for 140 ms"),
        ((), EVERY_TICK, "no sample for 140 ms"),
    ],
)
def test_a_sensor_without_finite_values_and_one_without_samples_are_told_apart(odd, quiet, said):
    device = PlainRig()
    supervisor = watched(device)
    assert supervisor.read(time.monotonic_ns())

    def read(now_ns):
        found = [Sample(port, now_ns, device.noise(port) * (np.nan if port in odd else 1.0)) for port in EVERY_TICK]
        return [sample for sample in found if sample.port not in quiet]

    device.read = read  # type: ignore[method-assign]
    for _ in range(140):
        supervisor.read(time.monotonic_ns())
    with pytest.raises(DeviceError, match=f"my:Rig: {said}; "):
        supervisor.read(time.monotonic_ns())


def test_a_sensor_that_falls_silent_after_a_late_sample_is_silent():
    device = PlainRig()
    supervisor = watched(device)
    supervisor.read(time.monotonic_ns())
    late = [Sample(port, time.monotonic_ns() - 10 * TICK_NS, device.noise(port)) for port in EVERY_TICK]
    device.read = lambda now_ns: late.copy() if not supervisor.counts["absent_accel_Ip"] else []  # type: ignore[method-assign]
    for _ in range(140):
        supervisor.read(time.monotonic_ns())
    with pytest.raises(DeviceError, match="my:Rig: no sample for 140 ms; "):
        supervisor.read(time.monotonic_ns())


def without_lines(error):
    """A message without the places in the driver."""
    return re.sub(r" \(out, [^)]*\)", "", str(error))


@pytest.mark.parametrize(
    ("failing", "reading", "said"),
    [
        ((), False, None),
        (("safe",), False, f"my:Rig: {NOT_ZERO}: safe failed: OSError: cable"),
        (("write", "safe"), False, f"my:Rig: {NOT_ZERO}: write failed: OSError: cable, safe failed: OSError: cable"),
        (("close",), False, f"my:Rig: close failed: OSError: cable; {ASKED}"),
        ((), True, f"my:Rig: read failed: OSError: cable; {ASKED}"),
        (("safe",), True, f"my:Rig: read failed: OSError: cable; {NOT_ZERO}: safe failed: OSError: cable"),
    ],
)
def test_the_end_says_whether_mirror_and_forces_are_at_zero(failing, reading, said):
    device = PlainRig()

    def out(*arguments):
        raise OSError("cable")

    for name in (*failing, *(["read"] if reading else [])):
        setattr(device, name, out)
    supervisor = watched(device)
    if reading:
        with pytest.raises(DeviceError) as first:
            supervisor.read(0)
        assert without_lines(first.value) == f"device {said}", "it is said after it was tried"
        assert device.called[-1] == "close"
    assert [without_lines(text) for text in supervisor.end()] == [f"{name} failed: OSError: cable" for name in failing]
    if failing:
        with pytest.raises(DeviceError) as error:
            supervisor.finish()
        assert without_lines(error.value) == f"device {said}" and error.value.code == ExitCode.DEVICE
    else:
        supervisor.finish()
    found = supervisor.statistics()
    assert found["device_state"] == (ERROR if said else FINALIZED)
    assert all(f"{name} failed" in found["device_fault"] for name in failing)


def ticks_until_frozen(device, port, values, command=lambda k: 0.0, ticks=1000):
    """Samples of one port that are read until the device is found frozen; none where it is not."""
    supervisor = watched(device)
    wanted = np.zeros(COMMANDS)
    for k in range(ticks):
        wanted[0] = command(k)
        now = time.monotonic_ns()
        supervisor.write(wanted, now)
        device.more = [Sample(port, now, values(k))]
        try:
            supervisor.read(now)
        except DeviceError:
            return k + 1 if supervisor.fault.startswith(f"{port} frozen for") else -1
    return None


def test_a_frozen_camera_ends_the_run_and_one_without_a_star_or_with_rounded_noise_does_not():
    same, rng = np.array([1e-8, -1e-8]), np.random.default_rng(5)
    assert ticks_until_frozen(PlainRig(), CAMERA_PORT, lambda k: same) == SETTINGS.frozen_frames + 2
    dropouts = ticks_until_frozen(PlainRig(), CAMERA_PORT, lambda k: np.full(2, np.nan) if k % 2 else same)
    assert dropouts == 2 * SETTINGS.frozen_frames + 3, "frames without values are no sign of life"
    assert ticks_until_frozen(PlainRig(), CAMERA_PORT, lambda k: np.full(2, np.nan)) is None
    assert ticks_until_frozen(PlainRig(), CAMERA_PORT, lambda k: 1e-8 * np.round(rng.normal(0.0, 0.5, 2))) is None


def test_a_frozen_truth_ends_the_run_and_one_at_rest_without_noise_does_not():
    same = np.array([1e-8, 2e-8])
    moved = ticks_until_frozen(PlainRig(), TRUTH_PORT, lambda k: same, command=lambda k: 1e-6 * k)
    assert moved == pytest.approx(SETTINGS.frozen_samples, abs=3), "the mirror is moved and it sees nothing"
    assert ticks_until_frozen(PlainRig(), TRUTH_PORT, lambda k: same) is None, "nothing moves"
    assert ticks_until_frozen(PlainRig(), TRUTH_PORT, lambda k: same + 1e-8 * k, command=lambda k: 1e-6 * k) is None


def test_a_run_begins_with_counts_of_zero_and_its_own_samples():
    class Counting(PlainRig):
        runs = 0

        def begin_counts(self):
            self.runs += 1

    device = Counting()
    supervisor = watched(device)
    for _ in range(50):
        now = time.monotonic_ns()
        device.more = [Sample(EVERY_TICK[0], now - OLD, device.noise(EVERY_TICK[0])) for _ in range(3)]
        supervisor.write(np.zeros(COMMANDS), now)
        supervisor.read(now)
        supervisor.answered(now - OLD)
    device.more = [Sample(CAMERA_PORT, now + DAY, device.noise(CAMERA_PORT))]
    supervisor.read(now)
    assert supervisor.counts["surplus_accel_Ip"] > 0 and supervisor.delay.count
    assert supervisor.age.maximum_us >= OLD / 1000
    supervisor.reset()
    found = supervisor.statistics()
    assert device.runs == 1
    assert not [name for name in found if name.startswith(("device_surplus", "device_impossible", "device_delay"))]
    now = time.monotonic_ns()
    assert supervisor.read(now)
    assert supervisor.acquired_ns == now, "no sample of the run before is left"
    assert supervisor.age.maximum_us < OLD / 1000


def test_packets_of_before_the_run_that_come_late_are_in_no_count():
    key = bytes(8)
    reader = Reader(key)

    def read(number):
        return reader.read(encode(Kind.FAST, number, number, np.zeros(1), key))

    read(1), read(5), reader.read(b"")
    assert reader.lost == 3 and reader.refused["size"] == 1
    reader.begin_counts()
    assert read(3) is not None and reader.statistics() == {}
    read(8), read(7)
    assert reader.statistics() == {"packets_lost": "1", "packets_reordered": "1"}


STEP = 2.0**-30


class Beating(PlainRig):
    """Samples that come at about the deadline: two in one tick, none in the next; then one in each."""

    def __init__(self):
        super().__init__()
        self.pattern = [0, 2, 1, 0, 2, 0, 2, 1, 0, *[1] * 300]
        self.number = 0

    def read(self, now_ns):
        found = []
        for _ in range(self.pattern.pop(0)):
            self.number += 1
            for port in EVERY_TICK:
                size = COLUMNS[port].stop - COLUMNS[port].start
                found.append(Sample(port, self.number, np.full(size, STEP * self.number)))
        return found


def test_a_tick_without_a_sample_gets_the_one_that_came_with_another():
    device = Beating()
    supervisor = watched(device)
    complete = [supervisor.read(1000) for _ in range(9)]
    assert complete == [False, *[True] * 8]
    used = []
    for _ in range(300):
        assert supervisor.read(1000)
        used.append(supervisor.measurement[0])
    assert set(np.diff(used)) <= {STEP, 2 * STEP}, "in order, none twice"
    assert used[-1] == STEP * device.number, "a sample that is not needed is given up: the newest is used again"
