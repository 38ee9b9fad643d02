"""Files of other programs: format by content, units and rates from the file, contradictions in it, missing samples."""

from __future__ import annotations

import builtins
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli.app import main
from scipy import io

from lftkit.errors import InputError
from pointing_analysis.indices.errors import performance_error
from pointing_analysis.read.los_source import open_los
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.series import series
from pointing_analysis.read.tables.los_table import read_table
from pointing_analysis.read.time_grid import time_grid
from pointing_analysis.requirements.summary import summarise
from pointing_analysis.requirements.verdict import parse
from pointing_analysis.units import ANGLES, RAD_PER_MAS

pytestmark = pytest.mark.usefixtures("without_pictures")
N, RATE = 6000, 512.0
T = np.arange(N) / RATE
LOS = 0.3 * np.random.default_rng(5).standard_normal((N, 2)) + 2.0 * np.sin(2 * np.pi * 9.7 * T)[:, None]


def mat5(path: Path) -> None:
    io.savemat(path, {"t": T, "los": LOS, "los_unit": "urad", "temperature": np.zeros(7)})


def mat5_structure(path: Path) -> None:
    io.savemat(
        path, {"run": {"time": T[:, None], "los": LOS.T, "unit": "µrad"}, "note": "a bench"}, do_compression=True
    )


def mat5_rate(path: Path) -> None:
    io.savemat(path, {"fs": RATE, "los": LOS, "unit": "microrad"})


def mat73(path: Path) -> None:
    """The layout that MATLAB writes: user block, transposed arrays, texts as numbers."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in (("t", T[None]), ("los", LOS.T)):
            file.create_dataset(name, data=array).attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("los_unit", data=np.array([[ord(c)] for c in "urad"], np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_dataset("#refs#/a", data=np.zeros((N, 2)))
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")


def hdf5(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file["bench/t"] = T
        file.create_dataset("bench/los", data=LOS, compression="gzip").attrs["units"] = "microrad"


def hdf5_rate(path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        dataset = file.create_dataset("los", data=LOS)
        dataset.attrs.update({"unit": "urad", "sampling_rate": RATE})


def csv_header(path: Path) -> None:
    rows = "\n".join(f"{t!r};{x!r};{y!r}" for t, (x, y) in zip(T.tolist(), LOS.tolist()))
    path.write_text(f"Time [s];LOS_X (urad);LOS_Y (urad)\n{rows}\n")


def csv_two_units(path: Path) -> None:
    rows = "\n".join(f"{t!r},{1e-3 * x!r},{y!r}" for t, (x, y) in zip(T.tolist(), LOS.tolist()))
    path.write_text(f"t,los_x [mrad],los_y_urad\n{rows}\n", "utf-16")


def parquet(path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    fields = [pyarrow.field("t", pyarrow.float64())]
    fields += [pyarrow.field(name, pyarrow.float64(), metadata={"unit": "urad"}) for name in ("x", "y")]
    parquet.write_table(pyarrow.table([T, LOS[:, 0], LOS[:, 1]], schema=pyarrow.schema(fields)), path)


def npz(path: Path) -> None:
    np.savez(path.with_suffix(".npz"), t=T, los=LOS, unit="urad")
    shutil.move(path.with_suffix(".npz"), path)


WRITERS = (mat5, mat5_structure, mat5_rate, mat73, hdf5, hdf5_rate, csv_header, csv_two_units, parquet, npz)


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_the_content_says_format_unit_and_times(tmp_path: Path, write: Callable[[Path], None]) -> None:
    path = tmp_path / "measured.dat"
    write(path)
    topic = open_los(path)["truth/los"]
    assert np.allclose(topic.values, LOS * 1e-6, rtol=1e-12, atol=0.0)
    assert topic.period == 1 / RATE and not topic.integrity.missing
    with pytest.raises(ValueError, match=r"unit must be .*rad.*, stated in the file for .*, got 'arcsec'"):
        open_los(path, unit="arcsec")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.bin", bytes(range(200, 256)) * 20, "file must be one of bag .*CSV.*Parquet.*MATLAB.*HDF5.*NumPy"),
        ("a.mat", b"MATLAB 5.0 MAT-file" + bytes(600), "file must be a MATLAB file"),
        ("a.h5", b"\x89HDF\r\n\x1a\n" + bytes(600), "file must be HDF5"),
        ("a.csv", b"x,y\n\xff\xfe\x00,1\n", "table must be text, got invalid start byte"),
    ],
)
def test_what_is_not_read_is_one_line(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        open_los(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_hdf5_reads_nothing_outside_of_the_file(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    (tmp_path / "secret").write_bytes(np.arange(200.0).tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = file["y"] = np.arange(100.0)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["linked"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/x")
        file.create_dataset("los", (100, 2), "f8", external=[(str(tmp_path / "secret"), 0, 1600)])
    with pytest.raises(ValueError, match=r"must hold arrays .* in another file, which is not read"):
        open_los(tmp_path / "a.h5", unit="mas")


@pytest.mark.parametrize(("seconds", "gap"), [(60, 103), pytest.param(3600, 1, marks=pytest.mark.slow)])
def test_times_of_six_decimals_at_512_hz(tmp_path: Path, seconds: int, gap: int) -> None:
    n = seconds * 512
    kept = np.delete(np.arange(n), np.arange(9000, 9000 + gap))
    values = 0.1 * np.random.default_rng(2).standard_normal((n, 2))
    rows = "\n".join(f"{i / 512:.6f},{values[i, 0]:.6f},{values[i, 1]:.6f}" for i in kept.tolist())
    (tmp_path / "a.csv").write_text(f"t,x,y\n{rows}\n")
    run = open_los(tmp_path / "a.csv", unit="mas")
    assert run.parameters["sampling_rate_hz"] == 512.0 and run["truth/los"].integrity.missing == gap
    found = summarise(run)
    assert found.ticks == n and found.samples_lost == gap and found.transient == 5.0
    assert not any("shorter" in problem for problem in found.problems)
    assert found.sampling.startswith("512 Hz from the times, rounded to 1 us")


@pytest.mark.parametrize("rate", [300.7, 999.9, 48.3, 1000.0, 2000.0])
@pytest.mark.parametrize("decimals", [4, 6, 9])
def test_any_rate_is_found_from_rounded_times(rate: float, decimals: int) -> None:
    rng = np.random.default_rng(int(rate))
    kept = np.sort(rng.choice(40_000, 39_500, replace=False))
    times = np.round(kept / rate + 12.3, decimals)
    grid = time_grid(times)
    assert grid is not None and grid.fits
    assert np.array_equal(grid.place, kept - kept[0])
    assert abs(1 / grid.period / rate - 1) < 1e-6


@pytest.mark.parametrize("order", ["newest first", "any"])
def test_the_order_of_the_rows_does_not_count(tmp_path: Path, order: str) -> None:
    n = 9000
    there = np.delete(np.arange(n), slice(3000, 3003))
    rows = there[::-1] if order == "newest first" else np.random.default_rng(3).permutation(there)
    values = 0.1 * np.random.default_rng(2).standard_normal((n, 2))
    text = [f"{i / 512:.6f},{values[i, 0]:.6f},{values[i, 1]:.6f}" for i in rows.tolist()]
    (tmp_path / "a.csv").write_text("t,x,y\n" + "\n".join(text) + "\n")
    asked = parse("prob(rms RPE(31.25 ms) < 1 mas) >= 0.9 at 90 % confidence")
    run = open_los(tmp_path / "a.csv", unit="mas")
    found = summarise(run, requirements=[asked])
    assert found.sampling.startswith("512 Hz from the times, rounded to 1 us")
    assert found.ticks == n and found.samples_lost == 3 and found.verdicts[0].status == "compliant"
    expected = values.round(6) * RAD_PER_MAS
    expected[3000:3003] = np.nan
    np.testing.assert_array_equal(run["truth/los"].values, expected[there])


def test_jitter_beyond_rounding_is_no_grid() -> None:
    times = np.arange(5000) / 512 + 2e-4 * np.random.default_rng(1).standard_normal(5000)
    grid = time_grid(times)
    assert grid is not None and not grid.fits and grid.jitter == pytest.approx(2e-4, rel=0.05)


@pytest.mark.parametrize("change", [0.0, 0.01])
def test_times_rounded_to_half_of_the_period_have_the_rate_of_their_record(change: float) -> None:
    """1 ms at 512 Hz: the mean of the intervals of 2 ms alone is another rate, for which --rate 512 was refused."""
    rates = np.where(np.arange(30_720) < 15_360, 512.0, 512.0 * (1.0 + change))
    times, xy = np.round(np.append(0.0, np.cumsum(1.0 / rates[:-1])), 3), np.zeros((30_720, 2))
    mean = 30_719 / times[-1]
    grid = time_grid(times)
    assert grid is not None and not grid.fits and 1.0 / grid.period == pytest.approx(mean, rel=2e-5)
    with pytest.raises(BagError, match=rf"on a grid of {1e3 / mean:.4g}\d* ms \({mean:.6g} Hz\)"):
        performance_error(series(times, xy, unit="mas"), 0.0)
    if change:
        with pytest.raises(InputError, match=rf"rate must match the samples, {mean:.6g}\d* Hz by their times"):
            series(times, xy, unit="mas", rate=512.0)
    else:
        assert len(series(times, xy, unit="mas", rate=512.0)["truth/los"]) == 30_720


@pytest.mark.parametrize("decimals", [4, 6, 9])
def test_the_change_of_a_rate_is_said_as_it_is(decimals: int) -> None:
    """Rounding and jitter were deducted from it: 0.7 % for 1 % with four decimals."""
    rate = 512.0 * (1.0 + 0.01 * np.linspace(-0.5, 0.5, 60_000))
    grid = time_grid(np.round(np.append(0.0, np.cumsum(1.0 / rate[:-1])), decimals))
    assert grid is not None and grid.drift == pytest.approx(0.01, rel=0.03)


@pytest.mark.parametrize("jitter", [0.0, 3e-7, 5e-6])
def test_a_record_is_as_long_as_its_times_whatever_their_jitter(jitter: float) -> None:
    """The period was the most frequent interval or the median: 30.009 s of 30 s, and a grid of 0.999887 ms."""
    rng = np.random.default_rng(1)
    times = np.arange(30_000) / 1000.0 + jitter * rng.standard_normal(30_000)
    found = summarise(series(times, rng.standard_normal((30_000, 2)), unit="mas"), transient=0.0)
    assert found.duration == pytest.approx(30.0, abs=1e-6) and found.sampling.startswith("1000 Hz from the times")
    far = series(times + 3e-5 * rng.standard_normal(30_000), np.zeros((30_000, 2)), unit="mas")
    with pytest.raises(BagError, match=r"stamps must be on a grid of (1|1\.00000\d*|0\.99999\d*) ms"):
        performance_error(far, 0.0)


@pytest.mark.parametrize("rate", [300.0, 512.0, 333.3, 44_100.0])
def test_rounding_is_no_jitter(rate: float) -> None:
    """Of whole nanoseconds, of a clock that drifts, too."""
    times = np.arange(30_000) / rate
    for since in (times, times * (1.0 + 1e-5 * times / times[-1])):
        stamps = np.floor(since * 1e9).astype(np.int64) + 1_700_000_000_123_456_789
        grid = time_grid((stamps - stamps[0]) / 1e9)
        assert grid is not None and "jitter" not in str(grid) and "rounded" not in str(grid)


def test_blank_cells_are_missing_samples_everywhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [f"{i / 1000:.3f},{i % 7},1" if not 6000 <= i < 6100 else f"{i / 1000:.3f},," for i in range(20_000)]
    (tmp_path / "a.csv").write_text("t,x [mas],y [mas]\n" + "\n".join(rows) + "\n,,\n")
    (tmp_path / "m.toml").write_text('[[requirement]]\ntext = "prob(|APE| < 1 arcsec) >= 0.9 at 90 % confidence"\n')
    run = open_los(tmp_path / "a.csv")
    found = summarise(run, requirements=[parse("prob(|APE| < 1 arcsec) >= 0.9 at 90 % confidence")])
    assert found.samples_lost == 100 and found.verdicts[0].missing == 100
    empty = ("1 empty rows skipped", "x [mas], y [mas]: 100 samples without a value: missing")
    assert found.problems == (*empty, "y has the same value in all samples")
    assert main(["analyse", str(tmp_path / "a.csv"), "--requirements", str(tmp_path / "m.toml"), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["samples_lost"] == 100
    lost = next(line for line in err.splitlines() if "samples lost" in line)
    assert "100" in lost and "not met" in lost


def table(path: Path, text: str, rows: int = 400, step: float = 0.001, scale: float = 1.0) -> Path:
    """A text file of times and two columns below a first line."""
    noise = scale * np.random.default_rng(1).standard_normal((rows, 2))
    np.savetxt(path, np.c_[step * np.arange(rows), noise], delimiter=",", header=text, comments="")
    return path


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("# time,los_x_mas,los_y_mas", "mas"),
        ("# a comment\n# t (s), x (urad), y (urad)", "urad"),
        ("# t x_deg y_deg", "deg"),
        ("% time [s];los_x [arcmin];los_y [arcmin]", "arcmin"),
        ("# error of the night\n# unit: mas", "mas"),
        ("#Units = degrees\ntime,x,y", "deg"),
    ],
)
def test_units_behind_a_comment_mark_count(tmp_path: Path, header: str, unit: str) -> None:
    """`np.savetxt(header=...)` writes names behind ``#``: with another unit all values were 206 times too large."""
    file = table(tmp_path / "a.csv", header)
    run = open_los(file)
    assert run.parameters["unit_of_the_samples"] == unit
    assert run["truth/los"].values.std() == pytest.approx(ANGLES[unit], rel=0.1)
    other = "rad" if unit != "rad" else "mas"
    with pytest.raises(ValueError, match=f"unit must be {unit}, stated in the file for .*, got '{other}'"):
        open_los(file, unit=other)
    assert open_los(file, unit=unit)["truth/los"].values.tolist() == run["truth/los"].values.tolist()


def test_times_that_may_be_milliseconds_need_their_unit(tmp_path: Path) -> None:
    """0, 1, 2, ... under ``time`` were seconds, whatever the rate of the instrument."""
    file = table(tmp_path / "a.csv", "time,x_mas,y_mas", step=1.0)
    with pytest.raises(ValueError, match=r"unit .* must be known where they are 1 apart: time \(s\).*--time time_ms"):
        open_los(file)
    for option, rate in (("time_ms", 1000.0), ("time_s", 1.0), ("time_us", 1e6)):
        assert 1 / open_los(file, time=option)["truth/los"].period == pytest.approx(rate)
    assert 1 / open_los(file, rate=1.0)["truth/los"].period == pytest.approx(1.0)
    with pytest.raises(ValueError, match="rate must match the samples"):
        open_los(file, rate=1000.0)
    named = table(tmp_path / "b.csv", "time_ms,x_mas,y_mas", step=1.0)
    assert 1 / open_los(named)["truth/los"].period == pytest.approx(1000.0)
    with pytest.raises(ValueError, match="time must be in ms, stated in the file for time_ms, got 'time_s'"):
        open_los(named, time="time_s")
    for header, seconds in (("time_min", 60.0), ("t (h)", 3600.0), ("time_d", 86_400.0), ("seconds", 1.0)):
        slow = table(tmp_path / "c.csv", f"{header},x_mas,y_mas", step=1.0, rows=100)
        assert open_los(slow)["truth/los"].period == pytest.approx(seconds)


@pytest.mark.parametrize(("unit", "turn"), [("deg", 360.0), ("rad", 2 * np.pi), ("arcsec", 1_296_000.0)])
def test_a_wrap_at_a_full_turn_is_refused(tmp_path: Path, unit: str, turn: float) -> None:
    """A direction about zero from 0 to 360 degrees has an RPE of half a turn."""
    noise = 1e-5 * turn * np.random.default_rng(1).standard_normal((400, 2))
    for wrapped in (noise % turn, (noise + turn / 2) % turn - turn / 2):
        rows = np.c_[0.001 * np.arange(400), wrapped]
        np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="t,x,y", comments="")
        if np.ptp(wrapped) > turn / 2:
            with pytest.raises(ValueError, match=r"without a wrap, got a step of a full turn after sample \d+: write"):
                open_los(tmp_path / "a.csv", unit=unit)
        else:
            assert len(open_los(tmp_path / "a.csv", unit=unit)["truth/los"]) == 400


COUNT = 4000


def noise(n: int = COUNT) -> np.ndarray[Any, Any]:
    return np.random.default_rng(5).standard_normal((n, 2))


@pytest.mark.parametrize(
    ("arrays", "options", "message"),
    [
        ({"los_mas": noise(), "los_mas_unit": "arcsec", "fs": 1000.0}, {}, "must be one, got arcsec and mas"),
        ({"los_mas": noise(), "fs": 1000.0, "dt": 0.002}, {}, "must be one, got 500 and 1000 Hz"),
        ({"los_mas": noise(), "fs": 1000.0, "dt": 0.002}, {"rate": 500.0}, "must be one, got 500 and 1000 Hz"),
        ({"los_mas": noise(), "fs": 1000.0, "Ts": 0.001}, {"rate": 999.0}, "must be 1000 Hz, stated in the file"),
    ],
    ids=["units", "rates", "rates, one of them given", "given and stated"],
)
def test_two_units_or_rates_of_the_samples_are_refused(
    tmp_path: Path, arrays: dict[str, Any], options: dict[str, Any], message: str
) -> None:
    np.savez(tmp_path / "los.npz", **arrays)
    with pytest.raises(ValueError, match=message):
        open_los(tmp_path / "los.npz", **options)


def test_the_unit_in_the_name_of_an_array_counts(tmp_path: Path) -> None:
    np.savez(tmp_path / "los.npz", los_mas=noise(), fs=1000.0)
    found = open_los(tmp_path / "los.npz", unit=None)
    assert found.parameters["unit_of_the_samples"] == "mas"


def test_two_units_of_a_dataset(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "los.h5", "w") as file:
        file["los"] = noise()
        file["los"].attrs.update({"unit": "mas", "units": "arcsec", "fs": 1000.0})
    with pytest.raises(ValueError, match=r"must be one, got mas and arcsec|must be one, got arcsec and mas"):
        open_los(tmp_path / "los.h5", unit=None)


def test_the_rate_of_another_dataset_is_not_that_of_the_line_of_sight(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "los.h5", "w") as file:
        file["a"], file["los"], file["z"] = noise(77), noise(), noise(88)
        for name, rate in (("a", 50.0), ("los", 1000.0), ("z", 4000.0)):
            file[name].attrs["fs"] = rate
    found = open_los(tmp_path / "los.h5", unit="mas", los="los")
    assert found.parameters["sampling_rate_hz"] == pytest.approx(1000.0)


def test_times_decide_over_the_rate_of_the_file_and_it_is_said(tmp_path: Path) -> None:
    np.savez(tmp_path / "los.npz", t=np.arange(COUNT) / 1000, los=noise(), fs=500.0)
    found = open_los(tmp_path / "los.npz", unit="mas")
    assert found.parameters["sampling_rate_hz"] == pytest.approx(1000.0)
    assert any("the file states 500 Hz" in problem for problem in found.problems)


@pytest.mark.parametrize("rate", [995.0, 999.5, 1000.2, 1005.0])
@pytest.mark.parametrize("jitter", [0.0, 5e-5])
def test_a_rate_that_the_times_contradict_is_refused(rate: float, jitter: float) -> None:
    """Before, samples that fell on the same tick were left out and counted as none lost."""
    t = np.arange(COUNT) / 1000 + jitter * np.random.default_rng(6).standard_normal(COUNT)
    with pytest.raises(ValueError, match=r"rate must match the samples, \S+ Hz by their times"):
        series(t, noise(), unit="mas", rate=rate)


def test_a_rate_within_half_a_sample_of_the_times_loses_none() -> None:
    found = series(np.arange(COUNT) / 1000, noise(), unit="mas", rate=1000.1)
    assert len(found.topic) == COUNT and not found.losses and np.all(np.diff(found.topic.stamp) > 0)


def test_two_units_in_the_name_of_the_time(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"unit of time_ms \(s\) must be one, got s and ms"):
        open_los(table(tmp_path / "los.csv", "time_ms (s),x,y"), unit="mas")


def test_packed_values_are_unpacked(tmp_path: Path) -> None:
    """By the conventions of netCDF: value = stored * scale_factor + add_offset; _FillValue is no value."""
    h5py = pytest.importorskip("h5py")
    stored = (100 * noise()).round().astype(np.int16)
    stored[7] = -32768
    with h5py.File(tmp_path / "los.h5", "w") as file:
        file["los"] = stored
        file["los"].attrs.update({"units": "mas", "fs": 1000.0, "scale_factor": 0.01, "add_offset": 3.0})
        file["los"].attrs["_FillValue"] = np.int16(-32768)
    values = open_los(tmp_path / "los.h5", unit=None)["truth/los"].values / RAD_PER_MAS
    assert np.isnan(values[7]).all()
    np.testing.assert_allclose(np.delete(values, 7, 0), np.delete(0.01 * stored + 3.0, 7, 0), rtol=1e-12)


def test_whole_stamps_of_such_a_file_keep_their_digits(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "los.h5", "w") as file:
        file["time_ns"] = 1_700_000_000_123_456_789 + 10**6 * np.arange(COUNT)
        file["time_ns"].attrs["_FillValue"] = np.int64(-1)
        file["los"] = noise()
    stamps = open_los(tmp_path / "los.h5", unit="mas", los="los")["truth/los"].stamp
    assert (np.diff(stamps) == 10**6).all()


def test_a_package_that_cannot_be_loaded_is_not_one_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit of memory shows so: the advice to install the package would be false."""
    (tmp_path / "x.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    real = builtins.__import__

    def fail(name: str, *arguments: Any, **keywords: Any) -> Any:
        if name == "h5py":
            raise ImportError("h5py.so: failed to map segment from shared object")
        return real(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", fail)
    with pytest.raises(ImportError, match="failed to map segment"):
        read_table(tmp_path / "x.h5")


@pytest.mark.parametrize("ppm", [10.0, 50.0, 800.0])
def test_a_clock_that_drifts_loses_no_sample(ppm: float) -> None:
    """Its samples were counted along one line: up to a third of them missing, or on the place of another one."""
    t = np.arange(60_000) / 1000.0
    grid = time_grid(np.round(t * (1.0 + 0.5e-6 * ppm * t / t[-1]), 7))
    assert grid is not None and grid.fits
    assert (grid.place == np.arange(60_000)).all()
    assert grid.period == pytest.approx(1e-3 * (1.0 + 0.5e-6 * ppm), rel=1e-7)
    assert grid.drift == pytest.approx(1e-6 * ppm, abs=1.2e-5)  # the times have seven digits


def test_a_gap_in_the_times_of_a_drifting_clock_is_counted() -> None:
    t = np.arange(60_000) / 1000.0
    times = np.delete(np.round(t * (1.0 + 1e-4 * t / t[-1]), 7), np.arange(20_000, 20_750))
    grid = time_grid(times)
    assert grid is not None and grid.fits and int(grid.place[-1]) + 1 - times.size == 750


def test_a_rate_that_changes_more_than_a_clock_does_is_refused() -> None:
    times = np.cumsum(np.where(np.arange(60_000) < 30_000, 1e-3, 1.01e-3))
    with pytest.raises(
        InputError, match=r"one sampling rate, got one that changes by (0\.99|1) %, 995\.025 Hz on average"
    ):
        series(times, np.zeros((60_000, 2)), unit="mas")


@pytest.mark.parametrize("names", ["los_x,los_y", "error_x,error_y"])
def test_columns_of_the_line_of_sight_come_before_others_of_two_axes(tmp_path: Path, names: str) -> None:
    rows = "".join(f"{0.001 * i:.3f},{i % 5},{i % 3},{i % 7},{i % 2}\n" for i in range(200))
    (tmp_path / "a.csv").write_text(f"time,x,y,{names}\n{rows}")
    values = open_los(tmp_path / "a.csv", unit="mas")["truth/los"].values / RAD_PER_MAS
    assert values.max(axis=0).round(6).tolist() == [6.0, 1.0]
