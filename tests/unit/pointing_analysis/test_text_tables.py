"""Tables in text files: which mark is between the cells, and whether the first row has names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pointing_analysis.read.tables.table import TableError
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


@pytest.mark.parametrize("first", ["0,000 0,012 --", "0,000 0,012,0,013", "0.1,-,0.2"])
def test_a_first_row_of_digits_that_are_no_numbers_is_refused(tmp_path: Path, first: str) -> None:
    (tmp_path / "a.csv").write_text(f"{first}\n1,2,3\n")
    with pytest.raises(TableError, match="first row must be names or numbers, got '0") as caught:
        read_text(tmp_path / "a.csv")
    assert "\n" not in str(caught.value)
