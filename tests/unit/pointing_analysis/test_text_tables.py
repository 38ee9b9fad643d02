"""Tables in text files: which mark is between the cells, and whether the first row has names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lftkit.errors import InputError
from pointing_analysis.read.los_source import open_los
from pointing_analysis.read.tables.text import read_text

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
