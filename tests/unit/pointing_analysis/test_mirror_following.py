"""Whether a mirror follows its command: against a sampled oscillator, mirrors with faults, and the verdict on a run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal

from pointing_analysis.indices.mirror_following import FollowingSettings, MirrorFollowing, not_followed
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.verdict import judge, parse

Array = np.ndarray[Any, Any]
DT, FREQUENCY, DAMPING, NOISE = 1e-3, 1569.6, 0.153, 1e-8
SETTINGS = FollowingSettings()
BLOCKS = 40
TIME = DT * np.arange(BLOCKS * SETTINGS.block)
COMMAND = 1e-4 * np.column_stack([np.sin(3.0 * TIME) + 0.1 * np.sin(142.0 * TIME), np.cos(20.0 * TIME) - 1.0])
REQUIREMENT = parse("prob(|APE| < 10 arcsec) >= 0.9 at 90 % confidence")


def oscillator(command: Array) -> Array:
    """Angles at the end of each sample of held commands, by the sampled transfer function."""
    plant = np.array([FREQUENCY**2]), np.array([1.0, 2.0 * DAMPING * FREQUENCY, FREQUENCY**2])
    num, den, _ = signal.cont2discrete(plant, DT)
    return np.asarray(signal.lfilter(np.append(num[0, 1:], 0.0), den, command, axis=0))


def behind(values: Array, samples: Array | int) -> Array:
    """Values of so many samples before."""
    return values[np.maximum(np.arange(len(values)) - samples, 0)]


def deviates(angle: Array, command: Array = COMMAND) -> Array:
    return MirrorFollowing(FREQUENCY, DAMPING, NOISE, SETTINGS, DT, 40).deviates(command, angle)


RNG = np.random.default_rng(4)
FOLLOWING = {
    "exactly": oscillator(COMMAND),
    "late, each sample by another time": behind(oscillator(COMMAND), RNG.integers(2, 5, len(TIME))),
    "at the largest lag": behind(oscillator(COMMAND), SETTINGS.lag),
    "at once": COMMAND,
    "by 15 % less": 0.85 * oscillator(COMMAND),
    "with noise": oscillator(COMMAND) + RNG.normal(0.0, 3 * NOISE, COMMAND.shape),
    "where there are samples": np.where(RNG.random((len(TIME), 1)) < 0.3, np.nan, oscillator(COMMAND)),
}
OTHERWISE = {
    "dead": lambda angle: 0.0 * angle,
    "half": lambda angle: 0.5 * angle,
    "wrong sign": lambda angle: -angle,
    "swapped": lambda angle: angle[:, ::-1],
    "held": lambda angle: np.full_like(angle, 2e-3),
    "one axis": lambda angle: angle * [1.0, 0.0],
}


@pytest.mark.parametrize("how", FOLLOWING)
def test_a_mirror_that_follows_in_all_that_is_documented_is_not_at_fault(how: str) -> None:
    assert not deviates(FOLLOWING[how]).any()


@pytest.mark.parametrize("how", OTHERWISE)
@pytest.mark.parametrize("frequency", [3.0, 20.0, 60.0, 142.0, 300.0])
def test_a_mirror_that_does_something_else_is_within_a_second(how: str, frequency: float) -> None:
    command = 1e-4 * np.column_stack([np.sin(frequency * TIME), 1.3 * np.cos(frequency * TIME + 0.4)])
    watch = MirrorFollowing(FREQUENCY, DAMPING, NOISE, SETTINGS, DT, 40)
    counts = watch.lasting(watch.deviates(command, OTHERWISE[how](oscillator(command))))
    assert counts[: round(1.0 / DT) // SETTINGS.block].max() > watch.limit


def test_the_blocks_of_one_call_are_those_of_many() -> None:
    """A run is watched block by block, its record is judged in one piece."""
    angle = np.where(TIME[:, None] < 1.0, oscillator(COMMAND), 0.0)
    watch = MirrorFollowing(FREQUENCY, DAMPING, NOISE, SETTINGS, DT, 40)
    parts = zip(np.split(COMMAND, BLOCKS), np.split(angle, BLOCKS))
    assert [bool(watch.deviates(*part)[0]) for part in parts] == deviates(angle).tolist()
    assert deviates(angle)[:20].sum() == 0 and deviates(angle)[21:].all()


@pytest.mark.parametrize("amplitude", [0.0, 1e-9])
def test_without_a_command_the_mirror_has_to_rest(amplitude: float) -> None:
    command = amplitude * np.sign(COMMAND)
    assert not deviates(RNG.normal(0.0, 3 * NOISE, COMMAND.shape), command).any()
    assert deviates(np.full_like(COMMAND, 1e-5), command).all()


def recorded(folder: Path, stuck: tuple[float, float], **parameters: Any) -> Run:
    """A run of 10 s whose mirror is at zero in a part of the time [s]; its line of sight does not tell."""
    time = DT * np.arange(10_000)
    command = 1e-4 * np.column_stack([np.sin(3.0 * time), np.cos(20.0 * time)])
    angle = behind(command, 3)
    angle[(time >= stuck[0]) & (time < stuck[1])] = 0.0
    signals = {
        "truth/los": 1e-7 * np.random.default_rng(1).standard_normal((len(time), 2)),
        "fsm/command": command,
        "fsm/strain_gauge": angle,
    }
    known = {"transient_s": 0, "mode": "realtime", "device": "my:Rig", "hold_ticks": 20, "fade_ticks": 20, **parameters}
    return Run.open(write_bag(folder, signals, parameters=known))


def test_a_run_is_not_judged_while_its_mirror_ignored_its_command(tmp_path: Path) -> None:
    run = recorded(tmp_path / "bag", (3.0, 7.0))
    ((begin, end),) = not_followed(run)
    assert begin == pytest.approx(3.0, abs=0.051) and end == pytest.approx(7.0, abs=0.051)
    verdict = judge(REQUIREMENT, [run])
    assert verdict.status == "not judged"
    assert verdict.note.startswith("the mirror did not follow its command from 3.0")
    part = Run.open(run.path, stop=2.9)
    assert judge(REQUIREMENT, [part]).status == "compliant", "the part before is as good as any"


@pytest.mark.parametrize(
    ("stuck", "known"),
    [((3.0, 3.0), {}), ((3.0, 3.1), {}), ((3.0, 7.0), {"device": ""}), ((3.0, 7.0), {"mode": "replay"})],
)
def test_a_run_is_judged_without_such_a_time_and_without_a_device(tmp_path: Path, stuck: Any, known: Any) -> None:
    run = recorded(tmp_path / "bag", stuck, **known)
    assert not_followed(run) == () and judge(REQUIREMENT, [run]).status == "compliant"


def test_a_fault_in_the_record_of_a_device_counts_from_its_time_on(tmp_path: Path) -> None:
    first = int(recorded(tmp_path / "healthy", (3.0, 3.0))["truth/los"].stamp[0])
    plant = {"device_fault": "clock requests unanswered for 140 ms", "device_fault_stamp": str(first + 9_860_000_000)}
    run = recorded(tmp_path / "bag", (3.0, 3.0), statistics=json.dumps({"plant": plant}))
    assert judge(REQUIREMENT, [run]).note.startswith("the device failed: clock requests unanswered for 140 ms")
    assert judge(REQUIREMENT, [Run.open(run.path, stop=9.8)]).status == "compliant"
