"""Files of disturbances: from the file to the source, to the run, and to its row beside the verdict."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.parts.disturbance_files import entries_of, make_sources
from scipy import io

from titop_plant.disturbances.source_kinds import RunConditions
from titop_plant.telescope.load import load_telescope

pytestmark = pytest.mark.usefixtures("without_pictures")

RUN = RunConditions((200.0, -210.0, 220.0, -230.0), 2.0, 1)
RATE, N = 2000.0, 6000
T = np.arange(N) / RATE
WRENCH = 0.1 * np.random.default_rng(1).standard_normal((N, 6))
WRENCH -= WRENCH.mean(axis=0)
INSIDE = np.array([0.0, 0.25, 0.5])


def csv(path: Path) -> None:
    header = "time (s),Fx (N),Fy (N),Fz (mN),Mx (Nm),My (Nm),Mz [Nm]"
    scaled = WRENCH * [1, 1, 1e3, 1, 1, 1]
    np.savetxt(path, np.column_stack([T, scaled]), delimiter=",", header=header, comments="", fmt="%.17g")


def mat(path: Path) -> None:
    io.savemat(path, {"t": T, "wrench": WRENCH})


def hdf5(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file.create_dataset("force", data=WRENCH[:, :3]).attrs.update({"unit": "N", "fs": RATE})
        file.create_dataset("torque", data=WRENCH[:, 3:]).attrs["unit"] = "Nm"


def parquet(path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    names = ("fx", "fy", "fz", "tx", "ty", "tz")
    parquet.write_table(pyarrow.table({"t": T, **dict(zip(names, WRENCH.T))}), path)


@pytest.mark.parametrize(("write", "name"), [(csv, "a.csv"), (mat, "a.mat"), (hdf5, "a.h5"), (parquet, "a.parquet")])
def test_a_series_is_the_same_from_every_format(tmp_path: Path, write: object, name: str) -> None:
    write(tmp_path / name)  # type: ignore[operator]
    (found,) = make_sources(entries_of([f"{tmp_path / name}@wheel_2"]), load_telescope(), RUN)
    assert (found.name, found.kind, found.place) == ("a", "series", "wheel_2")
    signal = found.signal
    assert signal.rate == RATE and np.allclose(signal.values, WRENCH, atol=1e-12)  # type: ignore[attr-defined]
    assert np.allclose(signal.tick(100, INSIDE).shape, (3, 6))
    assert found.remarks == (), "every column has its place"


WATERFALL = ";".join(f"{rpm},{f},{9 if f == 5 else 1},3" for rpm in (1, 9000) for f in range(1, 11))


@pytest.mark.parametrize(
    ("header", "rows", "remarks"),
    [
        ("t,fx,Force Z [N],temperature", "0,1,2,3;0.0005,-1,2,3", ("columns not used: Force Z [N], temperature",)),
        ("t,fx,note", "0,1,n/a;0.0005,-1,2", ("text columns ignored: note",)),
        ("speed [rpm],frequency,fx,count", WATERFALL, ("columns not used: count",)),
    ],
)
def test_what_has_no_effect_is_said(tmp_path: Path, header: str, rows: str, remarks: tuple[str, ...]) -> None:
    (tmp_path / "a.csv").write_text(f"{header}\n" + rows.replace(";", "\n") + "\n")
    entries = entries_of([f"{tmp_path / 'a.csv'}@wheel_2"])
    for _ in range(2):
        (found,) = make_sources(entries, load_telescope(), RunConditions(RUN.speeds, 0.001, 1))
        assert tuple(text for text in found.remarks if "columns" in text) == remarks


def test_an_axis_is_one_column(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,Fx (mN),fx (N)\n0,1,2\n0.0005,-1,2\n")
    with pytest.raises(ValueError, match=r"must have one column for each axis, got Fx \(mN\) and fx \(N\)"):
        make_sources(entries_of([f"{tmp_path / 'a.csv'}@wheel_2"]), load_telescope(), RUN)


def of_table(tmp_path: Path, header: str, rows: object) -> Any:
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=header, comments="")
    (found,) = make_sources(entries_of([f"{tmp_path / 'a.csv'}@wheel_1"]), load_telescope(), RUN)
    return found.signal


@pytest.mark.parametrize(
    ("header", "frequency", "density"),
    [
        ("frequency (rad/s),Tz (Nm^2/Hz)", 2 * np.pi, 1.0),
        ("frequency (kHz),Tz", 1e-3, 1.0),
        ("frequency [Hz],Tz [mNm²/Hz]", 1.0, 1e6),
    ],
)
def test_units_of_a_density(tmp_path: Path, header: str, frequency: float, density: float) -> None:
    f, p = np.array([10.0, 300.0]), np.array([1e-4, 1e-6])
    expected = of_table(tmp_path, "frequency,Tz", np.column_stack([f, p]))
    found = of_table(tmp_path, header, np.column_stack([f * frequency, p * density]))
    assert np.sqrt(np.mean(expected.values[:, 5] ** 2)) > 0.04
    np.testing.assert_allclose(found.values, expected.values, atol=1e-9)


@pytest.mark.parametrize(
    ("header", "factor"), [("order,Fx (mN s^2)", 1e-3), ("order,Fx (N/rpm^2)", (30 / np.pi) ** 2), ("order,Fx", 1.0)]
)
def test_units_of_harmonics(tmp_path: Path, header: str, factor: float) -> None:
    found = of_table(tmp_path, header, [[1.0, 1e-6]])
    assert abs(found.amplitude[0, 0]) == pytest.approx(factor * 1e-6 * 200.0**2)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("frequency (MHz),Tz", "frequency .* must be Hz, kHz or rad/s, got 'mhz'"),
        ("time (ticks),Fx", "unit of the time must be one of s, ms, us, ns, min, h, d, got 'ticks'"),
    ],
)
def test_units_of_another_quantity_are_refused(tmp_path: Path, header: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        of_table(tmp_path, header, [[1.0, 1e-6], [2.0, 1e-6]])


# -- keys: what is ignored or contradicts itself is refused, and a repeated record is said

SECOND = np.arange(1000) / 1000.0
HARMONIC = 'kind = "harmonics"\nplace = "wheel_1"\nharmonics = [{order = %s, force = [1e-7, 0.0, 0.0]}]'
PULSES = 'kind = "pulses"\nforce = [1.0, 0.0, 0.0]\nperiod = 1.0\nwidth = 0.1\n'


def waterfall(path: Path, *changed: tuple[int, str]) -> None:
    rows = [f"{rpm},{f},{0.1 if f == 20 else 0.001}" for rpm in (1000, 2000) for f in range(1, 60)]
    for index, row in changed:
        rows[index] = row
    path.write_text("\n".join(["speed (rpm),frequency (Hz),Fx", *rows]) + "\n")


def source(folder: Path, text: str, duration: float = 2.0) -> Any:
    (folder / "a.toml").write_text(f'base = "reference"\n[[disturbance]]\nname = "a"\n{text}\n')
    run = RunConditions(RUN.speeds, duration, 1)
    (found,) = make_sources(entries_of([str(folder / "a.toml")]), load_telescope(), run)
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    np.savetxt(
        tmp_path / "timed.csv", np.c_[SECOND, SECOND % 0.007], delimiter=",", header="time (s),Fx (N)", comments=""
    )
    np.savez(tmp_path / "rated.npz", wrench=np.ones((1000, 6)), fs=1000.0)
    np.savetxt(tmp_path / "h.csv", [[1.0, 1e-7]], delimiter=",", header="order,Fx", comments="")
    waterfall(tmp_path / "w.csv", (0, "1000,59,0.001"))
    waterfall(tmp_path / "nan.csv", (0, "1000,,0.001"))
    return tmp_path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('kind = "harmonics"\nharmonics = [{order = 1, force = [1.0, 0.0, 0.0]}]', "speed must be given"),
        ('kind = "series"\nfile = "timed.csv"\nkeep_mean = "false"', "keep_mean must be true or false, got 'false'"),
        (
            'kind = "series"\nfile = "timed.csv"\nrate = 500.0\nrepeat = true',
            r"rate must be that of .*timed.csv, 1000 Hz by its column time \(s\), got 500 Hz",
        ),
        (
            'kind = "series"\nfile = "rated.npz"\nrate = 500.0\nrepeat = true',
            "rate must be that of .*rated.npz, 1000 Hz by its file, got 500 Hz",
        ),
        (PULSES + "scale = [1, 1.5]", r"disturbance 'a': scale must be a number, got \[1, 1.5\]"),
        (PULSES + "first = [[2]]", r"first must be a number, got \[\[2\]\]"),
        (PULSES + "offset = [1e8, 0, 0]", r"offset\[0\] must be between -1e\+07 and 1e\+07 m, got 100000000"),
        (PULSES + "frame = [[], [0, 1]]", r"frame must be own, .*, got \[\[\], \[0, 1\]\]"),
        (PULSES + "first = 3.0\nlast = 2.0", "last must not be before first, 3 s, got 2 s"),
        (
            HARMONIC % 1 + '\nfile = "h.csv"',
            "harmonics must be in a file or in the table, got both: 'h.csv' and a list",
        ),
        (HARMONIC % '"1"', r"a.toml, disturbance 'a': harmonics\[0\].order must be a number above 0, got '1'"),
        (HARMONIC % "inf", r"harmonics\[0\].order must be a finite number above 0, got inf"),
        (
            'kind = "waterfall"\nfile = "w.csv"\nspeed = 150.0',
            "w.csv: waterfall must have one row for each frequency at each speed, got two of 1000 rpm, 59 Hz",
        ),
        ('kind = "waterfall"\nfile = "nan.csv"\nspeed = 150.0', "nan.csv: waterfall must have a row for each"),
    ],
)
def test_mistakes_and_what_would_be_ignored_are_one_line(folder: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        source(folder, text)
    assert "\n" not in str(caught.value)


def test_an_empty_name_is_refused(folder: Path) -> None:
    (folder / "a.toml").write_text(f'base = "reference"\n[[disturbance]]\nname = ""\n{PULSES}')
    with pytest.raises(ValueError, match="disturbance '': name must be a text that is not empty, got ''"):
        make_sources(entries_of([str(folder / "a.toml")]), load_telescope(), RunConditions(RUN.speeds, 2.0, 1))


def test_pulses_after_the_end_of_the_run_are_said(folder: Path) -> None:
    late = source(folder, PULSES + "first = 2.0")
    assert late.remarks == ("no pulse: the first is at 2 s, the run ends at 2 s",)
    assert not np.any([late.signal.tick(k, np.linspace(0.0, 1.0, 9)) for k in range(2000)])
    assert not source(folder, PULSES + "first = 1.9").remarks


def recorded(folder: Path, values: np.ndarray) -> Any:
    np.savetxt(
        folder / "record.csv", np.c_[SECOND, values], delimiter=",", header="time (s),Fx (N)", comments="", fmt="%.15g"
    )
    return source(folder, 'kind = "series"\nfile = "record.csv"\nrepeat = true', 10.0)


@pytest.mark.parametrize("phase", [0.0, 0.7, 0.5 * np.pi])
def test_a_record_of_whole_periods_is_repeated_as_it_is(folder: Path, phase: float) -> None:
    """Its tones keep frequency and amplitude: they are those of the sum over all of the run."""
    tone = np.sin(2 * np.pi * 31.0 * SECOND + phase) + 0.3 * np.cos(2 * np.pi * 97.0 * SECOND)
    found = recorded(folder, tone)
    assert found.remarks == ("record repeated every 1 s, as it is",)
    late = 7.3 + np.arange(50) * 1e-3
    values = [found.signal.tick(k, np.zeros(1))[0, 0] for k in range(7300, 7350)]
    exact = np.sin(2 * np.pi * 31.0 * late + phase) + 0.3 * np.cos(2 * np.pi * 97.0 * late)
    np.testing.assert_allclose(values, exact, atol=1e-5)


def test_noise_is_repeated_as_it_is_and_a_drift_is_not(folder: Path) -> None:
    noise = np.random.default_rng(1).standard_normal(SECOND.size)
    assert recorded(folder, noise - noise.mean()).remarks == ("record repeated every 1 s, as it is",)
    drift = recorded(folder, np.sin(2 * np.pi * 31.3 * SECOND) - np.sin(2 * np.pi * 31.3 * SECOND).mean())
    assert drift.remarks == ("record repeated every 0.75 s, its end faded into its beginning over 0.25 s",)
