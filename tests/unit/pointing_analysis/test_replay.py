"""The replay is the recording again, bit by bit, or says where it is not; missing ticks are stepped over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pointing_analysis.arrays import FloatArray
from pointing_analysis.indices.errors import knowledge_error_of
from pointing_analysis.indices.metrics import radial
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.replay import replay
from pointing_analysis.replay.gap_stepping import FILLS, GAP_LIMITS, HOLD, LINE, GapStepper

N, FRAME = 2000, 20
START, MS = 1_700_000_000 * 10**9, 10**6
MEASUREMENT = {
    "isolator/accel": slice(0, 6),
    "m1/accel": slice(6, 12),
    "m2/accel": slice(12, 18),
    "camera/los": slice(18, 20),
    "fsm/strain_gauge": slice(20, 22),
}
COMMAND = {"fsm/command": slice(0, 2), "pma/command": slice(2, 8)}
LAYOUT = replay.LoopLayout(MEASUREMENT, ("camera/los",), tuple(MEASUREMENT), ("isolator/accel",), COMMAND)


class Observer:
    """First-order observer with memory that holds the last camera frame."""

    def __init__(self, pole: float = 0.99) -> None:
        self.pole = pole
        self.reset()

    def reset(self) -> None:
        self.x: FloatArray = np.zeros(2)
        self.camera: FloatArray = np.zeros(2)

    def step(self, measurement: np.ndarray, out: np.ndarray) -> None:
        frame = measurement[18:20]
        if np.isfinite(frame).all():
            self.camera = frame - 0.1 * measurement[20:22]
        drive = measurement[0:2] + 0.3 * measurement[6:8] - 0.7 * measurement[12:14]
        self.x = self.pole * self.x + (1 - self.pole) * self.camera + 1e-3 * drive
        out[:] = self.x


class Law:
    """Mirror law and a filtered force."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self.f: FloatArray = np.zeros(6)

    def step(self, los_estimate: np.ndarray, accel_Ip: np.ndarray, out: np.ndarray) -> None:
        self.f = 0.9 * self.f + accel_Ip / 3
        out[:2] = -los_estimate / 0.1
        out[2:] = self.f


def record(path: Path, missed: tuple[int, ...] = (), drop: tuple[int, ...] = ()) -> Path:
    """Record a loop of the two cores the way the nodes run it: ticks in `missed` are not seen by them at all."""
    rng = np.random.default_rng(0)
    y = rng.standard_normal((N, 22))
    frames = np.arange(N) % FRAME == 0
    y[~frames, 18:20] = np.nan
    for tick in drop:
        y[tick, 18:20] = np.nan
    observer, law = Observer(), Law()
    estimate, command, held = np.zeros((N, 2)), np.zeros((N, 8)), np.zeros(22)
    held[18:20] = np.nan
    out, u = np.zeros(2), np.zeros(8)
    gap, done = 0, np.array([i not in missed for i in range(N)])
    last = np.zeros(8)
    for i in range(N):
        if not done[i]:
            gap += 1
            continue
        for _ in range(gap if gap <= 50 else 0):
            observer.step(held, out)
            law.step(last[:2], last[2:], u)
        gap = 0
        observer.step(y[i], out)
        law.step(out, y[i, :6], u)
        estimate[i], command[i] = out, u
        held[:18], held[20:] = y[i, :18], y[i, 20:]
        last[:2], last[2:] = out, y[i, :6]
    stamps = START + MS * np.arange(N)
    signals = {name: y[:, columns] for name, columns in MEASUREMENT.items()}
    signals["camera/los"] = y[frames, 18:20]
    signals["los_estimate"] = estimate[done]
    signals |= {name: command[done][:, columns] for name, columns in COMMAND.items()}
    signals["truth/los"] = 1e-6 * rng.standard_normal((N, 2))
    given = dict.fromkeys(MEASUREMENT, stamps)
    given |= {"camera/los": stamps[frames], "truth/los": stamps}
    given |= dict.fromkeys(("los_estimate", *COMMAND), stamps[done])
    return write_bag(path, signals, stamps=given, start=START)


@pytest.mark.parametrize(
    ("missed", "drop"),
    [((), ()), ((), (40, 60)), ((500,), ()), (tuple(range(700, 703)), (40,)), (tuple(range(300, 380)), ())],
    ids=["clean", "dropped frames", "a missed tick", "missed ticks", "a long stall"],
)
def test_replay_is_the_recording_bit_by_bit(tmp_path: Path, missed, drop) -> None:
    run = Run.open(record(tmp_path / "bag", missed, drop))
    replayed = replay.replay(run, Observer(), Law(), LAYOUT)
    comparison = replay.compare(run, replayed)
    assert comparison.identical, str(comparison)
    assert {d.topic for d in comparison.differences} == {"los_estimate", "fsm/command", "pma/command"}
    assert f"on {N - len(missed)} ticks" in str(comparison)


def test_one_bit_is_noticed(tmp_path: Path) -> None:
    run = Run.open(record(tmp_path / "bag"))
    replayed = replay.replay(run, Observer(), Law(), LAYOUT)
    changed = replayed.estimate.copy()
    changed[1234, 1] = np.nextafter(changed[1234, 1], np.inf)
    altered = replay.Replayed(replayed.stamp, changed, replayed.command_stamp, replayed.command, LAYOUT)
    comparison = replay.compare(run, altered)
    assert not comparison.identical
    wrong = next(d for d in comparison.differences if d.topic == "los_estimate")
    assert (wrong.different, wrong.first) == (1, pytest.approx(1.234))
    assert "1 of 2000 ticks differ" in str(comparison)


def test_another_observer_differs_and_has_its_own_knowledge_error(tmp_path: Path) -> None:
    run = Run.open(record(tmp_path / "bag"))
    other = replay.replay(run, Observer(pole=0.5), Law(), LAYOUT)
    comparison = replay.compare(run, other)
    assert [d.topic for d in comparison.differences if d.identical] == ["pma/command"]
    own = replay.replay(run, Observer(), Law(), LAYOUT)
    errors = [knowledge_error_of(run, r.stamp, r.estimate, transient=0.2).values for r in (own, other)]
    with pytest.raises(
        ValueError, match="an estimate and an angle of the mirror must have stamps of truth/los, got none"
    ):
        knowledge_error_of(run, own.stamp + 10**12, own.estimate)
    rms = [np.sqrt(np.nanmean(radial(e) ** 2)) for e in errors]
    assert rms[1] > 1.5 * rms[0]


def test_bag_that_lacks_a_sensor_sample_is_not_identical(tmp_path: Path) -> None:
    bag = record(tmp_path / "whole")
    whole = Run.open(bag)
    signals = {name: np.array(whole[name].values) for name in whole.topics}
    stamps = {name: np.array(whole[name].stamp) for name in whole.topics}
    signals["m1/accel"] = np.delete(signals["m1/accel"], 800, axis=0)
    stamps["m1/accel"] = np.delete(stamps["m1/accel"], 800)
    run = Run.open(write_bag(tmp_path / "less", signals, stamps=stamps))
    comparison = replay.compare(run, replay.replay(run, Observer(), Law(), LAYOUT))
    assert not comparison.identical
    assert comparison.incomplete == 1


def test_sensors_alone_are_enough_to_drive_the_cores(tmp_path: Path) -> None:
    whole = Run.open(record(tmp_path / "whole"))
    names = [*MEASUREMENT]
    signals = {name: whole[name].values for name in names}
    stamps = {name: whole[name].stamp for name in names}
    run = Run.open(write_bag(tmp_path / "sensors", signals, stamps=stamps))
    replayed = replay.replay(run, Observer(), Law(), LAYOUT)
    assert np.array_equal(replayed.estimate, whole["los_estimate"].values[:, :2])
    assert "neither estimates nor commands" in str(replay.compare(run, replayed))


class Recorder:
    def __init__(self) -> None:
        self.samples: list[np.ndarray] = []

    def step(self, sample: np.ndarray, out: np.ndarray) -> None:
        self.samples.append(sample.copy())
        out[0] = len(self.samples)


@pytest.mark.parametrize("gap", [0, 1, GAP_LIMITS[LINE] + 1, GAP_LIMITS[HOLD], GAP_LIMITS[HOLD] + 1, 10**6])
@pytest.mark.parametrize("fill", FILLS)
def test_a_gap_costs_as_many_steps_up_to_the_limit(fill: str, gap: int) -> None:
    """Of lines half a period of the fast tones; what is beyond the limit is left out."""
    core, out, steps = Recorder(), np.zeros(1), gap + 1 if gap <= GAP_LIMITS[fill] else 1
    stepper = GapStepper(core.step, 3, slice(1, 2), fill)
    stepper(np.array([1.0, 2.0, 3.0]), 0, out)
    stepper(np.array([4.0, 5.0, 6.0]), gap, out)
    assert out[0] == len(core.samples) == 1 + steps
    assert core.samples[0].tolist() == [1.0, 2.0, 3.0]
    assert core.samples[-1].tolist() == [4.0, 5.0, 6.0]
    for held in core.samples[1:-1] if fill == HOLD else []:
        np.testing.assert_array_equal(held, [1.0, np.nan, 3.0])


@pytest.mark.parametrize("gap", [1, 2, 7, GAP_LIMITS[LINE]])
def test_a_line_is_met_exactly_and_a_bend_no_worse_than_by_a_held_sample(gap: int) -> None:
    """Of a ramp no missing sample is wrong; the error of a tone is at most its bend, (w dt (gap + 1))^2 / 8."""
    ticks, frequency = np.arange(gap + 2), 0.3 / (gap + 1)
    for truth, bound in ((2.0 - 0.5 * ticks, 1e-12), (np.sin(frequency * ticks + 0.7), 0.3**2 / 8)):
        worst = {}
        for fill in FILLS:
            core, out = Recorder(), np.zeros(1)
            stepper = GapStepper(core.step, 1, fill=fill)
            stepper(truth[:1], 0, out)
            stepper(truth[-1:], gap, out)
            worst[fill] = np.abs(np.ravel(core.samples) - truth).max()
        assert worst[LINE] <= bound < worst[HOLD]


def test_where_the_line_is_not_finite_the_sample_before_is_held() -> None:
    core, out = Recorder(), np.zeros(1)
    stepper = GapStepper(core.step, 4, slice(0, 1))
    stepper(np.array([1.0, 2.0, -1.7e308, np.nan]), 0, out)
    stepper(np.array([5.0, np.nan, 1.7e308, 3.0]), 1, out)
    np.testing.assert_array_equal(core.samples[1], [np.nan, 2.0, -1.7e308, np.nan])
