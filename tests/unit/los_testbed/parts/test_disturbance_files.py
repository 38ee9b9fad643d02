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
        ("frequency (Hz),Tz (Nm/rtHz)", r"Tz \(Nm/rtHz\) must be Nm\^2/Hz or .*, got 'nm/rthz'"),
        ("frequency (MHz),Tz", "frequency .* must be Hz, kHz or rad/s, got 'mhz'"),
        ("order,Fx (N)", r"must be N s\^2/rad\^2 or .* \(squared = false for N\), got 'N'"),
        ("time (ticks),Fx", "unit of the time must be one of s, ms, us, ns, min, h, d, got 'ticks'"),
        ("time (s),Fx (Nm)", r"unit of Fx \(Nm\) must be N or mN, got 'Nm'"),
        ("time,Fx (N)", r"unit of the times must be known where they are 1 apart"),
    ],
)
def test_units_of_another_quantity_are_refused(tmp_path: Path, header: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        of_table(tmp_path, header, [[1.0, 1e-6], [2.0, 1e-6]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            'name = "a"\nkind = "wind"',
            "kind must be one of series, harmonics, waterfall, psd, cooler, pulses, got 'wind'",
        ),
        ('name = "a"\nkind = "cooler"\nfrequncy = 45.0', "keys must be among .*frequency.*, got frequncy"),
        ('name = "a"\nkind = "cooler"\nfrequency = -1.0\nharmonics = [{order = 1}]', "frequency must be .* got -1.0"),
        ('name = "a"\nkind = "pulses"\nplace = "moon"\nperiod = 1.0\nwidth = 0.1', "place must be one of bus, wheels"),
        ('name = "a"\nkind = "harmonics"\nharmonics = [{order = 1}]', "speed must be given"),
        ('name = "a"\nkind = "series"\nfile = "none.csv"', "none.csv: no such file"),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.toml").write_text(f"[[disturbance]]\n{text}\n")
    with pytest.raises(ValueError, match=message) as caught:
        make_sources(entries_of([str(tmp_path / "a.toml")]), load_telescope(), RUN)
    assert "\n" not in str(caught.value)
