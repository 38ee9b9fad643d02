"""Text files of many programs: times, units, marks, encodings and separators; the samples are the same in all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy import io

from lftkit.errors import InputError
from pointing_analysis.read.los_source import open_los
from pointing_analysis.read.tables.text import read_text
from pointing_analysis.units import ANGLES, RAD_PER_MAS

N = 300
T = np.arange(N) / 100
XY = np.round(3 * np.random.default_rng(3).standard_normal((N, 2)), 4)
"""Samples [mas] at 100 Hz."""
RADIANS = XY * RAD_PER_MAS
SECONDS = [f"{t:.2f}" for t in T]
CLOCK = [f"12:00:{t:06.3f}" for t in T]


def table(
    times: Sequence[str] = SECONDS, head: str = "time,x_mas,y_mas", mark: str = ",", unit: str = "mas", end: str = ""
) -> str:
    """Text of the samples in a unit."""
    digits = "{:.4f}" if unit == "mas" else "{:.10e}"
    values = XY if unit == "mas" else RADIANS / ANGLES[unit]
    rows = [mark.join([t, *map(digits.format, xy)]) + end for t, xy in zip(times, values)]
    return "\n".join([*([head] if head else []), *rows]) + "\n"


def counted(factor: float, digits: int = 0, start: float = 0.0) -> list[str]:
    """Times with another unit."""
    return [f"{start + factor * t:.{digits}f}" for t in T]


COMMA = table().replace(",", ";").replace(".", ",")
TIMES = {
    "ms": table(counted(1e3), "time_ms,x_mas,y_mas"),
    "msec": table(counted(1e3), "Time (msec),x (mas),y (mas)"),
    "milliseconds": table(counted(1e3), "Time [milliseconds],x_mas,y_mas"),
    "time_msec": table(counted(1e3), "time_msec,x_mas,y_mas"),
    "micro sign": table(counted(1e6), "t (µs),x_mas,y_mas"),
    "usec": table(counted(1e6), "t (usec),x_mas,y_mas"),
    "ns in brackets": table([str(17 * 10**17 + 10**7 * k) for k in range(N)], "stamp [ns],x_mas,y_mas"),
    "minutes": table(counted(1 / 60, 9), "time (minutes),x_mas,y_mas"),
    "hours": table(counted(1 / 3600, 11), "time [hours],x_mas,y_mas"),
    "days": table(counted(1 / 86_400, 10, 60_000), "time (days),x_mas,y_mas"),
    "epoch": table(counted(1, 2, 1.7e9)),
    "slash": table(counted(1e3), "t/ms,x/mas,y/mas"),
    "offset of hours": table([f"2026-11-20T{clock}+01" for clock in CLOCK]),
    "UTC": table([f"2026-11-20 {clock} UTC" for clock in CLOCK]),
    "comma": table([f"2026-11-20T{clock}".replace(".", ",") for clock in CLOCK], "time;x_mas;y_mas", ";"),
    "basic": table([f"20261120T{clock.replace(':', '')}Z" for clock in CLOCK]),
    "year first": table([f"2026/11/20 {clock}" for clock in CLOCK]),
    "points": table([f"20.11.2026 {clock}" for clock in CLOCK]),
    "day of year": table([f"2026/324-{clock}" for clock in CLOCK]),
    "colons": table([f"2026:324:{clock}" for clock in CLOCK]),
    "time of day": table(CLOCK),
    "midnight": table([f"{'23:59' if t < 1 else '00:00'}:{(t + 59) % 60:06.3f}" for t in T]),
    "gps": table([f"{2392 + (t >= 1)},{(604_799 + t) % 604_800:.2f}" for t in T], "week,tow,x_mas,y_mas"),
    "LabVIEW": table(SECONDS, "X_Value\tx_mas\ty_mas\tComment", "\t", end="\t"),
}
UNITS = {
    "deg": table(head="time,x (°),y (°)", unit="deg"),
    "degrees": table(head="time,x [Degrees],y [Degrees]", unit="deg"),
    "arcmin": table(head="time,x ['],y [′]", unit="arcmin"),
    "mdeg": table(head="time,x_mdeg,y [mdeg]", unit="mdeg"),
    "double prime": table(head="time;x [″];y [as]", mark=";", unit="arcsec"),
    "µrad at the end": table(head="time,x_µrad,y_µrad", unit="urad"),
    "behind a comma": table(head="time;x, urad;y, urad", mark=";", unit="urad"),
    "in": table(head="time,x in urad,y in urad", unit="urad"),
    "blank": table(head="time,x urad,y urad", unit="urad"),
    "comment for each column": "# Units: s, urad, urad\n" + table(head="time,x,y", unit="urad"),
    "row in words": table(counted(1e3), "time,x,y\nmilliseconds,µrad,microradians", unit="urad"),
    "row in brackets": table(head="time,x,y\n[s],[urad],[urad]", unit="urad"),
    "ECSV": "# %ECSV 1.0\n# - {name: time, unit: s, datatype: float64}\n# - {name: x, unit: urad, datatype: float64}\n"
    "# - {name: y, unit: urad, datatype: float64}\n" + table(head="time x y", mark=" ", unit="urad"),
}
AROUND = {
    "decimal comma": COMMA,
    "quoted decimal comma": "\n".join(",".join(f'"{c}"' for c in row.split(";")) for row in COMMA.splitlines()),
    "old ends of lines": table().replace("\n", "\r"),
    "end of file of DOS": table() + "\x1a",
    "semicolon comments": "; made by X\n; at 12:00\n" + table(),
    "exclamation marks": "! made by X\n" + table(),
    "slashes": "// made by X\n" + table(),
    "separator named": "sep=;\n" + table(head="time;x_mas;y_mas", mark=";"),
    "mark of the order of bytes": '\ufeff"sep=,"\n' + table(),
    "title": "Test bench 5, run 7\n\n" + table(),
    "titles": "Test bench\nOperator: N. N.\nDate: 2026-11-20\nTemperature 20,5\n\n" + table(),
    "comma at the end of rows": table(end=","),
    "commas at the end of all": table(head="time,x_mas,y_mas,,,", end=",,,"),
    "tab at the end": table(head="time\tx_mas\ty_mas", mark="\t", end="\t"),
    "header repeated": table().replace("\n2.00,", "\ntime,x_mas,y_mas\n2.00,"),
    "minus sign": table().replace("-", "\N{MINUS SIGN}"),
    "Fortran": table(head="time,x_urad,y_urad", unit="urad").replace("e-0", "D-0").replace("e+0", "D+0"),
    "bars": table().replace(",", "|"),
    "no-break spaces": table().replace(",", ",\u00a0"),
    "index of pandas": table([f"{k};{t}" for k, t in enumerate(SECONDS)], ";time;x_mas;y_mas", ";"),
}


def same(path: Path, **options: object) -> bool:
    topic = open_los(path, **options)["truth/los"]  # type: ignore[arg-type]
    return len(topic) == N and abs(topic.period - 0.01) < 1e-8 and np.allclose(topic.values, RADIANS, atol=1e-12)


@pytest.mark.parametrize("text", [*TIMES.values(), *UNITS.values(), *AROUND.values()], ids=[*TIMES, *UNITS, *AROUND])
def test_the_samples_are_the_same(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.csv").write_bytes(text.encode())
    assert same(tmp_path / "a.csv")


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "cp1252", "latin-1"]
)
def test_the_encoding_changes_nothing(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "a.csv").write_bytes(("% Prüfstand\n" + table()).encode(encoding))
    assert same(tmp_path / "a.csv")


def test_columns_by_number_and_sample_numbers(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(table(head="a,b_mas,c_mas"))
    assert same(tmp_path / "a.csv", los="2,3", time="1")
    (tmp_path / "b.csv").write_text(table([str(7 + k) for k in range(N)], "sample,x_mas,y_mas"))
    assert same(tmp_path / "b.csv", rate=100.0)
    with pytest.raises(ValueError, match="rate must be given where the times are sample numbers"):
        open_los(tmp_path / "b.csv")


def test_a_unit_at_the_end_of_the_option_is_that_of_a_column_of_any_name(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(table(counted(1 / 86_400, 10, 60_000), "MJD,x_mas,y_mas"))
    assert same(tmp_path / "a.csv", time="MJD_d")


def test_one_of_several_pairs_of_a_name_is_not_chosen_by_its_length(tmp_path: Path) -> None:
    arrays = {f"{name}/los": np.ones((n, 2)) for name, n in (("camera", 9), ("mirror", 99), ("estimate", 99))}
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(ValueError, match="los must name two of the columns"):
        open_los(tmp_path / "a.npz", unit="rad", rate=10.0)


def parquet(path: Path, times: object) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    columns = {"time": times, "x_mas": XY[:, 0], "y_mas": XY[:, 1]}
    parquet.write_table(pyarrow.table(columns), path)


def hdf5(path: Path, unit: str, factor: float) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, scale in (("second", 1.0), ("first", 2.0)):
            group = file.create_group(name)
            group.attrs["unit"] = "mas"
            group["time"], group["x"], group["y"] = scale * T * factor, scale * XY[:, 0], scale * XY[:, 1]
            group["time"].attrs["units"] = unit


MS, NS = ((1 / unit * T).round().astype(f"timedelta64[{name}]") for name, unit in (("ms", 1e-3), ("ns", 1e-9)))
CELL = np.array(["mas", "mas"], object)
ARRAYS: dict[str, Callable[[Path], None]] = {
    "durations of Parquet": lambda path: parquet(path, NS),
    "durations of NumPy": lambda path: np.savez(path.open("wb"), t=MS, los=XY, unit="mas"),
    "one matrix with the time first": lambda path: io.savemat(path, {"data": np.c_[T, XY], "data_unit": "mas"}),
    "its name given": lambda path: io.savemat(path, {"d": np.c_[T, XY], "other": XY, "unit": "mas"}),
    "a unit for each column": lambda path: np.savez(path.open("wb"), t=T, los=XY, los_units=["mas", "mas"]),
    "a cell of units": lambda path: io.savemat(path, {"s": {"t": T, "los": XY, "units": CELL}}),
    "group of HDF5": lambda path: hdf5(path, "seconds since 2026-01-01", 1.0),
    "days of netCDF": lambda path: hdf5(path, "days since 2026-01-01 00:00:00", 1 / 86_400),
}
CHOSEN = {"its name given": "d"} | dict.fromkeys(("group of HDF5", "days of netCDF"), "second.x,second.y")


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_have_the_same_samples(tmp_path: Path, name: str) -> None:
    """Of two groups the times are those beside the line of sight."""
    ARRAYS[name](tmp_path / "a")
    assert same(tmp_path / "a", los=CHOSEN.get(name))


def test_what_is_skipped_is_noted(tmp_path: Path) -> None:
    notes = {"titles": "4 lines in front of the header skipped", "header repeated": "repeated in row 202"}
    for name, note in (*notes.items(), ("separator named", ""), ("mark of the order of bytes", "")):
        (tmp_path / "a.csv").write_text(AROUND[name])
        problems = open_los(tmp_path / "a.csv").problems
        assert any(note in problem for problem in problems) if note else not problems


TABLE = np.column_stack([np.arange(40) / 512, np.random.default_rng(1).standard_normal((40, 2))])


def rows(mark: str, comma: bool) -> str:
    text = "\n".join(mark.join(f"{value:.6f}" for value in row) for row in TABLE)
    return text.replace(".", ",") if comma else text


@pytest.mark.parametrize("header", [(), ("t", "x_mas", "y_mas")], ids=["no header", "header"])
@pytest.mark.parametrize(
    ("mark", "comma"),
    [(" ", True), ("  ", True), ("\t", True), (";", True), ("; ", True), (" ", False), (",", False), (", ", False)],
)
def test_every_separator_with_a_decimal_point_or_comma(
    tmp_path: Path, mark: str, comma: bool, header: tuple[str, ...]
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("\n".join([*([mark.join(header)] if header else []), rows(mark, comma)]))
    table = read_text(path)
    assert list(table.columns) == list(header or ("column_1", "column_2", "column_3"))
    np.testing.assert_allclose(np.column_stack(list(table.columns.values())), TABLE, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0 0,5 -1,25\n1 0,75 1e-3\n", [[0, 0.5, -1.25], [1, 0.75, 1e-3]]),
        ("1,5 0,5 2\n2,5 7 3\n", [[1.5, 0.5, 2], [2.5, 7, 3]]),
        ("0,1,2\n1,2,3\n", [[0, 1, 2], [1, 2, 3]]),
        ("0 ,1 ,2\n1 ,2 ,3\n", [[0, 1, 2], [1, 2, 3]]),
        ("0,,2\n1,2,3\n", [[0, np.nan, 2], [1, 2, 3]]),
    ],
)
def test_whole_numbers_between_decimal_commas(tmp_path: Path, text: str, expected: list[list[float]]) -> None:
    (tmp_path / "a.txt").write_text(text)
    np.testing.assert_allclose(np.column_stack(list(read_text(tmp_path / "a.txt").columns.values())), expected)


def test_a_first_row_with_a_date_is_a_row(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("2026-01-01 00:00:00.0,0.5,0.25\n2026-01-01 00:00:00.1,1.5,1.25\n")
    table = read_text(tmp_path / "a.csv")
    assert list(table.columns) == ["column_1", "column_2", "column_3"]
    assert table.columns["column_2"].tolist() == [0.5, 1.5]


def written(path: Path, text: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(text.encode(encoding))
    return path


def test_times_in_days_and_by_day_of_the_year_are_those_in_seconds(tmp_path: Path) -> None:
    """At 100 Hz: a day of a Julian date has 5e-10 days, 40 us, in a number of 64 bits. 1 Hz is refused as well."""
    values = [f"{0.1 * k:.3f},{-0.2 * k:.3f}" for k in range(2000)]
    days = [f"{2460000.5 + k / 8_640_000:.9f}" for k in range(2000)]
    dates = [f"2026-331T00:00:{k / 100:06.3f}Z" for k in range(2000)]
    for name, head, times in (("a", "time", days), ("b", "time (d)", days), ("c", "time", dates)):
        rows = "\n".join(f"{t},{v}" for t, v in zip(times, values))
        written(tmp_path / f"{name}.csv", f"{head},x_mas,y_mas\n{rows}\n")
    with pytest.raises(ValueError, match=r"unit of the times .* as days are: time \(d\) .*--time time_d"):
        open_los(tmp_path / "a.csv")
    seconds = "\n".join(f"{60_000 + k / 86_400:.9f},{k % 7},{k % 5}" for k in range(2000))
    with pytest.raises(ValueError, match=r"are 1.16e-05 apart, as days are"):
        open_los(written(tmp_path / "e.csv", f"time,x_mas,y_mas\n{seconds}\n"))
    found = [open_los(tmp_path / "a.csv", time="time_d"), *(open_los(tmp_path / f"{name}.csv") for name in "bc")]
    for series in found:
        assert series["truth/los"].period == pytest.approx(0.01, rel=1e-6) and len(series["truth/los"]) == 2000


def test_times_that_have_lost_their_digits_give_way_to_a_rate(tmp_path: Path) -> None:
    rows = "\n".join(f"1.73234e+09,{k},{-k}" for k in range(300))
    path = written(tmp_path / "a.csv", f"time,x_mas,y_mas\n{rows}\n")
    with pytest.raises(InputError, match=r"got 1 different ones in 300 rows of time: too few digits; --rate HERTZ"):
        open_los(path)
    for options in ({"rate": 200.0}, {"rate": 200.0, "time": "none"}):
        series = open_los(path, **options)  # type: ignore[arg-type]
        assert series["truth/los"].period == pytest.approx(0.005) and len(series["truth/los"]) == 300


def test_a_gap_between_times_without_digits_is_no_part_of_the_rate(tmp_path: Path) -> None:
    """Ten rows with each stamp, and five seconds without rows: read at a rate they were complete."""
    stamps = np.floor(np.arange(3000) / 10) / 100 + np.where(np.arange(3000) < 1500, 0.0, 5.0)
    rows = "\n".join(f"{t:.2f},{k % 7},{k % 5}" for k, t in enumerate(stamps))
    path = written(tmp_path / "a.csv", f"time,x_mas,y_mas\n{rows}\n")
    with pytest.raises(InputError, match=r"at 1000 Hz, got 5 s without rows after row 1500"):
        open_los(path, rate=1000.0)
    assert len(open_los(path, rate=1000.0, time="none")["truth/los"]) == 3000


def test_rows_between_times_without_digits_fill_the_time_at_the_rate(tmp_path: Path) -> None:
    """Of 60 000 rows 3000 were lost at random: 57 s at 1 kHz, "samples lost 0"."""
    kept = np.flatnonzero(np.random.default_rng(0).random(60_000) > 0.05)
    for name, where in (("lost", kept), ("whole", np.arange(60_000))):
        written(
            tmp_path / f"{name}.csv",
            "time,x_mas,y_mas\n" + "\n".join(f"{k // 10 / 100},{k % 7},{k % 5}" for k in where),
        )
    with pytest.raises(InputError, match=r"follow each other at 1000 Hz, got 57\d+ rows in 59\.9"):
        open_los(tmp_path / "lost.csv", rate=1000.0)
    with pytest.raises(InputError, match=r"follow each other at 2000 Hz, got 59\d+ rows in 5\d.\d+ s"):
        open_los(tmp_path / "whole.csv", rate=2000.0)
    whole = open_los(tmp_path / "whole.csv", rate=1000.0)
    assert len(whole["truth/los"]) == 60_000 and not any("no time column" in text for text in whole.problems)


def test_a_first_row_of_ones_is_no_row_of_units(tmp_path: Path) -> None:
    """Units may be left out of a row of units, but not all of them."""
    table = read_text(written(tmp_path / "a.csv", "time,x_mas,y_mas\n1,1,1\n2,3,4\n3,4,5\n"))
    assert table.columns["time"].tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(InputError, match="row 2, column y_mas must be a number, got '-'"):
        read_text(written(tmp_path / "b.csv", "time,x_mas,y_mas\n1,1,-\n2,3,4\n3,4,5\n4,5,6\n"))
    table = read_text(written(tmp_path / "c.csv", "time,x,y\n-,mas,mas\n2,3,4\n3,4,5\n"))
    assert table.columns["time"].tolist() == [2.0, 3.0] and table.units["x"] == ["mas"]


def test_columns_count_as_in_the_file(tmp_path: Path) -> None:
    """Those of text, which are left out, too."""
    rows = "\n".join(f"{0.01 * k:.2f},on,{k % 7},{k % 5},{k % 3}" for k in range(300))
    path = written(tmp_path / "a.csv", f"time,note,a_mas,b_mas,c_mas\n{rows}\n")
    one, other = open_los(path, los="3,4")["truth/los"], open_los(path, los="a_mas,b_mas")["truth/los"]
    np.testing.assert_array_equal(one.values, other.values)
    with pytest.raises(InputError, match="los must be two columns of numbers, got note"):
        open_los(path, los="2,3")


@pytest.mark.parametrize("titles", ["Jitter test seven\n", "Bench 4, run 7\nstation\n", "one\n"])
@pytest.mark.parametrize("mark", [",", ";"])
def test_titles_stand_before_a_header_with_a_row_of_units(tmp_path: Path, titles: str, mark: str) -> None:
    rows = "".join(f"{0.001 * i:.3f}{mark}{i % 7}{mark}{i % 5}\n" for i in range(100))
    (tmp_path / "a.csv").write_text(f"{titles}time{mark}los_x{mark}los_y\ns{mark}mas{mark}mas\n{rows}")
    run = open_los(tmp_path / "a.csv")
    assert (run["truth/los"].values / RAD_PER_MAS).max(axis=0).round(6).tolist() == [6.0, 4.0]
