"""Keys of sources of disturbance: what is ignored or contradicts itself is refused, and a repeated record is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.parts.disturbance_files import entries_of, make_sources

from titop_plant.disturbances.source_kinds import RunConditions
from titop_plant.telescope.load import load_telescope

RUN = RunConditions((200.0, -210.0, 220.0, -230.0), 2.0, 1)
T = np.arange(1000) / 1000.0
HARMONIC = 'kind = "harmonics"\nplace = "wheel_1"\nharmonics = [{order = %s, force = [1e-7, 0.0, 0.0]}]'
PULSES = 'kind = "pulses"\nforce = [1.0, 0.0, 0.0]\nperiod = 1.0\nwidth = 0.1\n'


def waterfall(path: Path, *changed: tuple[int, str]) -> None:
    rows = [f"{rpm},{f},{0.1 if f == 20 else 0.001}" for rpm in (1000, 2000) for f in range(1, 60)]
    for index, row in changed:
        rows[index] = row
    path.write_text("\n".join(["speed (rpm),frequency (Hz),Fx", *rows]) + "\n")


def source(folder: Path, text: str, duration: float = 2.0) -> Any:
    (folder / "a.toml").write_text(f'[[disturbance]]\nname = "a"\n{text}\n')
    run = RunConditions(RUN.speeds, duration, 1)
    (found,) = make_sources(entries_of([str(folder / "a.toml")]), load_telescope(), run)
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    np.savetxt(tmp_path / "timed.csv", np.c_[T, T % 0.007], delimiter=",", header="time (s),Fx (N)", comments="")
    np.savez(tmp_path / "rated.npz", wrench=np.ones((1000, 6)), fs=1000.0)
    np.savetxt(tmp_path / "h.csv", [[1.0, 1e-7]], delimiter=",", header="order,Fx", comments="")
    waterfall(tmp_path / "w.csv", (0, "1000,59,0.001"))
    waterfall(tmp_path / "nan.csv", (0, "1000,,0.001"))
    return tmp_path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('kind = "series"\nfile = "timed.csv"\nkeep_mean = "false"', "keep_mean must be true or false, got 'false'"),
        ('kind = "series"\nfile = "timed.csv"\nrepeat = "no"', "repeat must be true or false, got 'no'"),
        ('kind = "series"\nfile = "timed.csv"\nrepeat = 1', "repeat must be true or false, got 1"),
        (HARMONIC % 1 + "\nsquared = 0", "squared must be true or false, got 0"),
        (
            'kind = "series"\nfile = "timed.csv"\nrate = 500.0\nrepeat = true',
            r"rate must be that of .*timed.csv, 1000 Hz by its column time \(s\), got 500 Hz",
        ),
        (
            'kind = "series"\nfile = "rated.npz"\nrate = 500.0\nrepeat = true',
            "rate must be that of .*rated.npz, 1000 Hz by its file, got 500 Hz",
        ),
        (PULSES + "first = 3.0\nlast = 2.0", "last must not be before first, 3 s, got 2 s"),
        (
            HARMONIC % 1 + '\nfile = "h.csv"',
            "harmonics must be in a file or in the table, got both: 'h.csv' and a list",
        ),
        (
            'kind = "cooler"\nfrequency = 40.0\nfile = "h.csv"\nharmonics = [{order = 1, force = [1.0, 0.0, 0.0]}]',
            "harmonics must be in a file or in the table, got both",
        ),
        *(
            (HARMONIC % order, rf"a.toml, disturbance 'a': order of a harmonic must be a number above 0, got {shown}")
            for order, shown in (
                ("[1, 2]", r"\[1, 2\]"),
                ('"abc"', "'abc'"),
                ('"1"', "'1'"),
                ("true", "True"),
                ("inf", "inf"),
                ("-1", "-1"),
            )
        ),
        (
            'kind = "waterfall"\nfile = "w.csv"\nspeed = 150.0',
            "w.csv: waterfall must have one row for each frequency at each speed, got two of 1000 rpm, 59 Hz",
        ),
        ('kind = "waterfall"\nfile = "nan.csv"\nspeed = 150.0', "nan.csv: waterfall must have a row for each"),
    ],
)
def test_what_would_be_ignored_is_one_line(folder: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        source(folder, text)
    assert "\n" not in str(caught.value)


def recorded(folder: Path, values: np.ndarray) -> Any:
    np.savetxt(
        folder / "record.csv", np.c_[T, values], delimiter=",", header="time (s),Fx (N)", comments="", fmt="%.15g"
    )
    return source(folder, 'kind = "series"\nfile = "record.csv"\nrepeat = true', 10.0)


@pytest.mark.parametrize("phase", [0.0, 0.7, 0.5 * np.pi])
def test_a_record_of_whole_periods_is_repeated_as_it_is(folder: Path, phase: float) -> None:
    """Its tones keep frequency and amplitude: they are those of the sum over all of the run."""
    tone = np.sin(2 * np.pi * 31.0 * T + phase) + 0.3 * np.cos(2 * np.pi * 97.0 * T)
    found = recorded(folder, tone)
    assert found.remarks == ("record repeated every 1 s, as it is",)
    late = 7.3 + np.arange(50) * 1e-3
    values = [found.signal.tick(k, np.zeros(1))[0, 0] for k in range(7300, 7350)]
    exact = np.sin(2 * np.pi * 31.0 * late + phase) + 0.3 * np.cos(2 * np.pi * 97.0 * late)
    np.testing.assert_allclose(values, exact, atol=1e-5)


def test_noise_is_repeated_as_it_is_and_a_drift_is_not(folder: Path) -> None:
    noise = np.random.default_rng(1).standard_normal(T.size)
    assert recorded(folder, noise - noise.mean()).remarks == ("record repeated every 1 s, as it is",)
    drift = recorded(folder, np.sin(2 * np.pi * 31.3 * T) - np.sin(2 * np.pi * 31.3 * T).mean())
    assert drift.remarks == ("record repeated every 0.75 s, its end faded into its beginning over 0.25 s",)
