"""Laws of every kind of source: momentum, power, units, and the same force whatever the tick is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.parts.disturbance_files import entries_of, make_sources

from lftkit.arrays import FloatArray
from titop_plant.disturbances.mechanisms import mechanism_sources
from titop_plant.disturbances.signals import JointSignal, SampledSignal, Signal, SumSignal
from titop_plant.disturbances.source_kinds import RunConditions
from titop_plant.interface import DT
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.motion_profiles import MotionProfile

SECONDS = 20.0
SPEED = 200.0
RUN = RunConditions((SPEED, 210.0, 220.0, 230.0), SECONDS, 5)
T = np.arange(40_000) / 2000.0
MIDDLE, WEIGHT = np.polynomial.legendre.leggauss(6)
INSTANTS, SHARES = 0.5 * (MIDDLE + 1.0), 0.5 * WEIGHT


@dataclass(frozen=True)
class Law:
    """What a source must do, on one of its axes; its files are written with values times a factor and a prefix."""

    write: Callable[[Path, float, str], str]
    axis: int
    power: float
    """Mean square [N^2, Nm^2]."""
    impulse: float
    """Largest [Ns, Nms]; of pulses, whose momentum is meant, what they have."""
    scatter: float = 1e-3
    per_unit: float = 1.0
    """Power of the factor and of the prefix with which values grow: of a density 2."""


def table(header: str, rows: FloatArray, scaled: slice) -> Callable[[Path, float, str], str]:
    """Writer of a CSV file; `header` has {} where the prefix of the unit stands."""

    def write(folder: Path, factor: float, prefix: str) -> str:
        values = rows.copy()
        values[:, scaled] *= factor
        np.savetxt(folder / "a.csv", values, delimiter=",", header=header.format(prefix), comments="")
        return f"{folder / 'a.csv'}@wheel_1"

    return write


def toml(text: str, header: str = "", rows: FloatArray | None = None) -> Callable[[Path, float, str], str]:
    """Writer of a TOML file with, where it names one, a table ``a.csv``."""

    def write(folder: Path, factor: float, prefix: str) -> str:
        if rows is not None:
            table(header, rows, slice(1, None))(folder, factor, prefix)
        (folder / "a.toml").write_text(
            f'base = "reference"\n[[disturbance]]\nname = "a"\n{text}'.replace("FACTOR", repr(factor))
        )
        return str(folder / "a.toml")

    return write


WATERFALL = np.array(
    [[60.0 * s, f, 2.0 * (s / 30.0) ** 2 * (f == 2 * s)] for s in (30.0, 34.0) for f in np.arange(50.0, 80.0)]
)
HERE = SPEED / (2 * np.pi)
"""Speed of the wheel in turns a second, between those of the waterfall."""
LINE = 2.0 * (HERE / 30.0) ** 2

LAWS = {
    "series": Law(
        table("time (s),Fy ({}N)", np.c_[T, 3.0 * np.sin(2 * np.pi * 17.5 * T) + 1.0], slice(1, 2)),
        1,
        4.5,
        2 * 3.0 / (2 * np.pi * 17.5),
    ),
    "harmonics": Law(
        table("order,Fx ({0}N s^2/rad^2)", np.array([[1.0, 1e-4], [2.5, 4e-5]]), slice(1, 2)),
        0,
        0.5 * (4.0**2 + 1.6**2),
        2 * (4.0 / SPEED + 1.6 / (2.5 * SPEED)),
    ),
    "waterfall": Law(
        table("speed (rpm),frequency (Hz),Fz ({}N)", WATERFALL, slice(2, 3)),
        2,
        0.5 * LINE**2,
        1.05 * 2 * LINE / (2 * SPEED),  # the lines are known to bins of 1 Hz
        scatter=0.05,
    ),
    "psd": Law(
        table("frequency (Hz),Tz ({}Nm^2/Hz)", np.array([[5.0, 0.02], [205.0, 0.02]]), slice(1, 2)),
        5,
        4.0,
        # six times the rms of the integral of what is above 5 Hz
        2 * 6 * np.sqrt(0.02 / (2 * np.pi) ** 2 * (1 / 5.0 - 1 / 205.0)),
        scatter=0.05,
        per_unit=2.0,
    ),
    "cooler": Law(
        toml(
            'kind = "cooler"\nfrequency = 47.0\nlinewidth = 0.5\nfile = "a.csv"\n',
            "order,Fz ({}N)",
            np.array([[1.0, 0.8], [2.0, 0.3]]),
        ),
        2,
        0.5 * (0.8**2 + 0.3**2),
        1.3 * 2 * (0.8 + 0.15) / (2 * np.pi * 47.0),
        scatter=0.03,
    ),
    "pulses": Law(
        toml('kind = "pulses"\nforce = [FACTOR, 0.0, 0.0]\nperiod = 2.0\nwidth = 0.05\n'), 0, 0.05 / 2.0, 10 * 0.05
    ),
}


def source(law: Law, folder: Path, factor: float = 1.0, prefix: str = "") -> Signal:
    (found,) = make_sources(entries_of([law.write(folder, factor, prefix)]), load_telescope(), RUN)
    return found.signal


def record(signal: Signal, ticks: int) -> FloatArray:
    """Values at the nodes of each tick, (ticks, nodes, axes)."""
    return np.array([signal.tick(k, INSTANTS) for k in range(ticks)])


def with_tick(signal: Signal, dt: float) -> Signal:
    """The same source asked at another sampling rate."""
    if isinstance(signal, JointSignal | SumSignal):
        return type(signal)(tuple(with_tick(part, dt) for part in signal.parts))
    own: dict[str, Any] = {"_weights": {}} if isinstance(signal, SampledSignal) else {}
    return replace(signal, dt=dt, **own)  # type: ignore[type-var]


@pytest.mark.further
@pytest.mark.parametrize("kind", LAWS)
def test_momentum_and_power(tmp_path: Path, kind: str) -> None:
    """What shakes leaves no momentum behind, after any time; pulses leave theirs."""
    law = LAWS[kind]
    values = record(source(law, tmp_path), round(SECONDS / DT))[:, :, law.axis]
    assert np.square(values).mean() == pytest.approx(law.power, rel=law.scatter)
    impulse = np.cumsum(DT * values @ SHARES)
    if kind == "pulses":
        assert impulse[-1] == pytest.approx(law.impulse, rel=1e-9)
    else:
        assert np.ptp(impulse) <= law.impulse * (1.0 + 1e-6)


@pytest.mark.parametrize("kind", LAWS)
def test_the_force_does_not_depend_on_the_tick(tmp_path: Path, kind: str) -> None:
    """Two ticks of half the length have the values, of pulses the mean, of one."""
    law = LAWS[kind]
    whole = source(law, tmp_path)
    half = with_tick(whole, DT / 2)
    for k in (0, 7, 1999, 12_345):
        if kind == "pulses":
            found = 0.5 * (half.tick(2 * k, INSTANTS[:1]) + half.tick(2 * k + 1, INSTANTS[:1]))
        else:
            found = half.tick(2 * k, 2 * INSTANTS[:1])
        assert found == pytest.approx(whole.tick(k, INSTANTS[:1]), rel=1e-6, abs=1e-9)


@pytest.mark.further
@pytest.mark.parametrize("kind", [kind for kind in LAWS if kind != "pulses"])
def test_a_unit_with_a_prefix_is_the_same_force(tmp_path: Path, kind: str) -> None:
    law = LAWS[kind]
    plain = source(law, tmp_path).tick(321, INSTANTS)
    milli = source(law, tmp_path, 1e3**law.per_unit, "m").tick(321, INSTANTS)
    assert milli == pytest.approx(plain, rel=1e-9, abs=1e-15) and np.abs(plain).max() > 0


MECHANISMS = Path(__file__).parents[4] / "examples" / "spacecraft" / "moving_rotors.toml"


@cache
def mechanism(name: str) -> Signal:
    telescope = load_telescope(str(MECHANISMS))
    still = MotionProfile(np.zeros(1), np.zeros(1), np.array([RUN.speeds]))
    found = mechanism_sources(telescope, still, SECONDS, 5)
    return next(one.signal for one in found if one.name == name)


@pytest.mark.further
def test_the_broadband_of_wheels_has_its_power_and_no_momentum() -> None:
    """Radial force 1e-8 N2/Hz at 1 Hz, 1e-6 from 100 Hz on, straight on logarithmic axes: proportional to f."""
    values = record(mechanism("wheel broadband"), round(SECONDS / DT))
    power = 1e-8 / 2 * (100.0**2 - 1.0) + 1e-6 * 300.0
    for wheel in range(4):
        force = values[:, :, 6 * wheel]
        assert np.square(force).mean() == pytest.approx(power, rel=0.05)
        # the integral of S / (2 pi f)^2
        rms = np.sqrt((1e-8 * np.log(100.0) + 1e-6 * (1 / 100.0 - 1 / 400.0)) / (2 * np.pi) ** 2)
        assert np.ptp(np.cumsum(DT * force @ SHARES)) < 2 * 6 * rms


@pytest.mark.further
def test_the_torques_of_a_drive_have_their_power_and_no_momentum() -> None:
    signal = mechanism("array drive")
    assert isinstance(signal, JointSignal)
    values = record(signal, round(SECONDS / DT))
    for i, part in enumerate(signal.parts):
        rotor, fast = values[:, :, 6 * i + 4], np.abs(part.cycles * part.rate) > 2 * np.pi  # type: ignore[attr-defined]
        tones = part.amplitude[fast, 4]  # type: ignore[attr-defined]
        slow = replace(part, cycles=part.cycles[~fast], amplitude=part.amplitude[~fast])  # type: ignore[attr-defined, type-var]
        rest = rotor - record(slow, len(rotor))[:, :, 4]
        assert np.square(rest).mean() == pytest.approx(0.5 * np.square(np.abs(tones)).sum(), rel=0.02)
        bound = 2 * (np.abs(tones) / np.abs(part.cycles * part.rate)[fast]).sum()  # type: ignore[attr-defined]
        assert np.ptp(np.cumsum(DT * rest @ SHARES)) <= bound
