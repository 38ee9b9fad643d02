"""Check of a rig by test motions: each mistake of its wiring is found and named, without ROS and without real time."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from los_testbed.cli.app import main
from los_testbed.cli.device import _table
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.device_contract import DeviceError, Sample
from los_testbed.rig import motions
from los_testbed.rig.check import DeviceCheckRow, faults, judge
from los_testbed.rig.motions import model_response, peaks_of, record
from los_testbed.rig.supervisor import Supervisor, SupervisorSettings
from los_testbed.rig.wiring import Wiring

from pointing_analysis.command.exit_codes import ExitCode
from titop_plant.interface import CAMERA, COLUMNS, FORCES, MEASURED, MIRROR, TICK_NS

PEAKS = peaks_of((5.3e-3, 31.6))


class Static:
    """A telescope of gains alone: forces move accelerometers, the mirror camera and gauges."""

    def __init__(self, noise=1e-5):
        rng = np.random.default_rng(3)
        self.gains = np.zeros((22, 8))
        self.gains[:18, FORCES] = 1e-2 * rng.standard_normal((18, 6))
        self.gains[CAMERA, MIRROR] = 0.1 * np.eye(2)
        self.gains[20:22, MIRROR] = np.eye(2)
        self.sigma = noise * np.concatenate([np.full(18, 1.0), np.full(4, 1e-3)])
        self.reset()

    def reset(self):
        self.rng, self.tick, self.noise = np.random.default_rng(5), 0, 1.0

    def change(self, name, value):
        if name == "noise":
            self.noise = value

    def step(self, command, measurement, truth):
        measurement[:] = self.gains @ command + self.noise * self.sigma * self.rng.standard_normal(22)
        if self.tick % 10:
            measurement[CAMERA] = np.nan
        self.tick += 1


class Bench:
    """A rig with a wiring on a clock of its own, which is also the clock of the check: every other tick, for speed."""

    def __init__(self, wrong="", noise=1e-5, loss=0.0):
        self.plant, self.wiring = Static(noise), Wiring(wrong)
        self.rng, self.loss = np.random.default_rng(8), loss
        self.command, self.measurement = np.zeros(8), np.zeros(22)
        self.now, self.greatest, self.calls = 1_000, np.zeros(8), []

    def begin(self, first):
        self.first = first

    def wait(self):
        self.now += 2 * TICK_NS

    def open(self, config):
        self.calls.append("open")

    def read(self, now_ns):
        self.plant.step(self.wiring.command(self.command), self.measurement, np.zeros(2))
        seen = self.wiring.measurement(self.measurement)
        if self.rng.random() < self.loss:
            return []
        return [Sample(p, now_ns, seen[COLUMNS[p]].copy()) for p in MEASURED if np.isfinite(seen[COLUMNS[p]]).all()]

    def write(self, command, now_ns):
        self.command = command
        self.greatest = np.maximum(self.greatest, np.abs(command))

    def safe(self):
        self.calls.append("safe")

    def close(self):
        self.calls.append("close")


@pytest.fixture(scope="module")
def model():
    return model_response(Static(), PEAKS)


def checked(model, bench):
    supervisor = Supervisor(bench, RunConfig(device="my:Rig", start="rest"), SupervisorSettings(call=60.0))
    supervisor.open()
    rows = judge(record(supervisor, PEAKS, bench, lambda: bench.now), model)
    supervisor.end()
    return rows


@pytest.mark.further
def test_a_rig_as_the_model_has_no_fault_also_with_lost_samples(model):
    bench = Bench(loss=0.02)
    rows = checked(model, bench)
    assert faults(rows) == ()
    assert len(rows) == 30 and np.allclose([row.gain for row in rows], 1.0, atol=0.03)
    assert max(abs(row.delay_ms) for row in rows) <= 1.0
    assert (bench.greatest <= PEAKS).all() and (bench.greatest > 0.5 * PEAKS).all()
    assert not bench.command.any() and bench.calls == ["open", "safe", "close"], "at zero afterwards"


@pytest.mark.parametrize(
    ("wrong", "lines"),
    [
        (
            "camera_los=delay,accel_Ip=swapped,accel_M2=dead",
            (
                "accel_Ip[0, 1]: swapped: sees like value 1, 0",
                "accel_M2: dead: no response",
                "camera_los: values 40 ms older than their stamps",
            ),
        ),
        (
            "camera_los=sign,pma_force=swapped",
            ("camera_los: wrong sign", "pma_force[0, 1]: swapped: moves like value 1, 0"),
        ),
        (
            "fsm_command=swapped,pma_force=delay",
            ("fsm_command: swapped: moves like value 1, 0", "pma_force: 40 ms late, by all sensors"),
        ),
        ("fsm_command=dead,pma_force=dead", ("fsm_command: dead: moves nothing", "pma_force: dead: moves nothing")),
    ],
)
def test_each_mistake_is_one_line(model, wrong, lines):
    said = [re.sub("(39|41) ms", "40 ms", line) for line in faults(checked(model, Bench(wrong)))]
    assert said == [*lines], "20 ticks of 2 ms are 40 ms"


class NoisyM1(Bench):
    def read(self, now_ns):
        samples = super().read(now_ns)
        for sample in samples:
            if sample.port == "accel_M1":
                sample.values[:] += 20.0 * self.rng.standard_normal(sample.values.shape)
        return samples


def test_dead_forces_are_found_beside_a_sensor_whose_noise_hides_them(model):
    """The other accelerometers show it; they were called dead instead, and the forces good."""
    said = faults(checked(model, NoisyM1("pma_force=dead")))
    assert len(said) == 2 and "pma_force: dead: moves nothing" in said
    assert any(line.startswith("accel_M1: noise ") and line.endswith("times the model's") for line in said)


def test_commands_that_no_sensor_shows_are_not_judged(model):
    said = faults(checked(model, Bench(noise=30.0)))
    assert "pma_force: not judged: no sensor responds above its noise" in said


def test_motions_that_the_noise_hides_are_not_judged(model):
    said = faults(checked(model, Bench(noise=1.0)))
    assert any("not judged: without motion" in line for line in said)


@pytest.mark.further
def test_of_a_camera_that_fits_no_motion_no_gain_is_printed(model):
    """Times of acquisition that jump from frame to frame: what it sees is no motion of any actuator."""
    bench = Bench()
    read, rng = bench.read, np.random.default_rng(2)

    def jumping(now_ns):
        shifts = {"camera_los": int(rng.integers(0, 150) * TICK_NS)}
        return [Sample(s.port, s.acquired_ns - shifts.get(s.port, 0), s.values) for s in read(now_ns)]

    bench.read, bench.now = jumping, 10**9  # type: ignore[method-assign]
    rows = [row for row in checked(model, bench) if row.part == "camera_los"]
    assert all(row.fault.startswith("matches no actuator: ") for row in rows)
    assert all(np.isnan(row.gain) and np.isnan(row.delay_ms) for row in rows)
    (line, _) = _table(tuple(rows)).markdown().splitlines()[2:]
    assert line.startswith("| camera_los[0] |  |  | ")


def test_samples_that_are_not_finite_are_not_called_few_or_none(model):
    bench = Bench()
    read, odd = bench.read, ["accel_M1"]

    def half(now_ns):
        return [Sample(s.port, now_ns, s.values * (np.nan if s.port in odd else 1.0)) for s in read(now_ns)]

    bench.read = half  # type: ignore[method-assign]
    assert "accel_M1: too few samples: 0, 4500 not finite" in faults(checked(model, bench))
    bench, odd[:] = Bench(), MEASURED
    read = bench.read
    bench.read = lambda now: [one for one in half(now) if one.port != "camera_los"]  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match="accel_Ip, accel_M1, accel_M2, fsm_angle not finite, no other sample for"):
        checked(model, bench)


def test_samples_in_another_unit_are_called_beyond_range(model):
    """A camera in mas was "too few samples: 0", gauges in urad "matches no actuator"."""
    bench = Bench()
    read, scales = bench.read, {"camera_los": 648e6 / np.pi, "fsm_angle": 1e6}

    def scaled(now_ns):
        return [Sample(s.port, now_ns, s.values * scales.get(s.port, 1.0)) for s in read(now_ns)]

    bench.read = scaled  # type: ignore[method-assign]
    found = {line.partition(":")[0].partition("[")[0]: line for line in faults(checked(model, bench))}
    for port in scales:
        assert "beyond range: " in found[port] and found[port].endswith("which are not used (other unit?)")


@pytest.fixture
def bench(monkeypatch, model):
    """The command with a rig without real time and the model of it."""
    made = Bench("fsm_angle=sign")
    monkeypatch.setattr("los_testbed.parts.device_contract.make", lambda config, setting: made)
    monkeypatch.setattr(motions, "model_response", lambda plant, peaks: model)
    monkeypatch.setattr(motions, "record", lambda sup, peaks: record(sup, peaks, made, lambda: made.now))
    return made


@pytest.mark.further
def test_the_command_ends_with_a_table_json_and_code(bench, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    with pytest.raises(SystemExit) as stop:
        main(["device", "check", "my:Rig", "--json"])
    assert stop.value.code == ExitCode.FAILED
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert not found["passed"] and found["faults"] == ["fsm_angle: wrong sign"]
    assert len(found["rows"]) == 30 and found["rows"][20]["gain"] == pytest.approx(-1.0, abs=0.02)
    rows = [line.split() for line in err.splitlines() if line.startswith("│")]
    assert ["fsm_angle[0]", "-1"] in [row[1:4:2] for row in rows] and err.splitlines()[-1] == "fsm_angle: wrong sign"
    bench.wiring = Wiring("")
    assert main(["device", "check", "my:Rig"]) == 0
    assert "no fault: directions, gains, delays and noise agree with the model" in capsys.readouterr().out


def test_values_of_which_only_the_noise_was_compared_are_told(bench, capsys, monkeypatch):
    """The model says that no motion moves them."""
    rows = [DeviceCheckRow("camera_los", j, gain, 1.0, 1e-8, 1e-8, 5.0, "") for j, gain in enumerate((np.nan, 1.0))]
    monkeypatch.setattr("los_testbed.rig.check.judge", lambda *_: tuple(rows))
    monkeypatch.setattr(motions, "record", lambda *_: SimpleNamespace(longest_pause_ms=0.0))
    monkeypatch.setenv("COLUMNS", "160")
    assert main(["device", "check", "my:Rig"]) == 0
    text = capsys.readouterr().out
    assert "pass (noise only)" in text.split("camera_los[0]")[1].split("\n")[0]
    assert "agree with the model; of 1 value only the noise was compared" in text
