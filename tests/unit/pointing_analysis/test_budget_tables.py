"""Budgets as tables: sources there and back, results in the four steps, mistakes in one line."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli.app import main
from support.command_line import refused

from pointing_analysis.budget.file import load_budget
from pointing_analysis.budget.total import evaluate

HEAD = "source, type, unit, value, half_range, sigma, amplitude, frequency, correlation_time, rate, duration, random"
TABLE = f"""{HEAD}, transfer, text
platform / wheels, periodic, mas, , , , 9.0; 4.0, 33.0, , , , , 0.5,
platform / gyro, random, arcsec, , , 0.004, , , 0.1, , , , ,
alignment, constant, mas, , 20.0, , , , , , , , ,
thermal, drift, mas, , , , , , , 0.01; 0.02, 600, , ,
RPE, requirement, , , , , , , , , , , , prob(|RPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence
"""
TREE = """unit = "mas"
[[requirement]]
name = "RPE"
text = "prob(|RPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence"
[sources.platform.wheels]
type = "tones"
tones = [{frequency = 33.0, amplitude = [9.0, 4.0]}]
transfer = 0.5
[sources.platform.gyro]
type = "random"
sigma = 4.0
correlation_time = 0.1
[sources.alignment]
type = "constant"
half_range = 20.0
[sources.thermal]
type = "drift"
rate = [0.01, 0.02]
duration = 600
"""


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    table, tree = tmp_path / "budget.csv", tmp_path / "budget.toml"
    table.write_text(TABLE)
    tree.write_text(TREE)
    return table, tree


def test_a_table_is_the_budget_of_the_tree(files: tuple[Path, Path]) -> None:
    """Another unit in a row is converted."""
    one, two = (load_budget(file) for file in files)
    assert [s.path for s in one.sources] == [s.path for s in two.sources]
    for window in (None, 0.02):
        for a, b in zip(one.sources, two.sources):
            np.testing.assert_allclose(a.sigma(window), b.sigma(window), rtol=1e-12)
    (first,), (second,) = evaluate(one), evaluate(two)
    assert first.total == pytest.approx(second.total, rel=1e-9) and first.limit == second.limit == pytest.approx(40.0)


SETTINGS = """title = "=2026"
unit = "mas"
summation = "rss"
axes = ["u", "v"]
draws = 20_000
seed = 7
[[requirement]]
name = "APE, 1"
text = "prob(|APE| < 25 mas) >= 0.997 at 95 % confidence, mixed"
[[total]]
index = "RPE"
window = 1
factor = 3.0
[[total]]
index = "APE"
[sources.1.a]
type = "constant"
value = [3.0, 1.0]
half_range = 10.0
random = "time"
transfer = -0.25
[sources.1]
transfer = 3
[sources.b]
type = "random"
sigma = [2.0, 9.0]
correlation_time = 0.5
"""


@pytest.mark.parametrize("ending", [".csv", ".xlsx"])
def test_all_settings_go_there_and_back(tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Summation, axes, draws, seed and totals had been left out: a total that breaks its limit kept it."""
    if ending == ".xlsx":
        pytest.importorskip("openpyxl")
    tree, written = tmp_path / "tree.toml", tmp_path / f"written{ending}"
    tree.write_text(SETTINGS)
    assert main(["budget", str(tree), "--sources", str(written), "--json"]) == 0
    assert main(["budget", str(written), "--sources", str(written), "--json"]) == 0
    first, second = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert first == second and second["title"] == "=2026" and second["summation"] == "rss"
    assert [total["index"] for total in second["totals"]] == ["RPE", "APE"]
    one, two = load_budget(tree), load_budget(written)
    assert (one.axes, one.draws, one.seed, one.totals) == (two.axes, two.draws, two.seed, two.totals)
    assert one.requirements == two.requirements and [s.path for s in one.sources] == [s.path for s in two.sources]


@pytest.mark.parametrize(
    ("old", "new", "options"),
    [
        ("99.7", "99.7", ["--members", "-1"]),
        ("99.7", "99.7", ["--members", "2"]),
        ("(20 ms)", "(20 weeks)", []),
        ('"random"', '"measured"\nbag = "none"', []),
        ("0.997", "99", []),
    ],
)
def test_a_mistake_leaves_the_files_that_are_there(
    files: tuple[Path, Path], old: str, new: str, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """The table of the sources had been overwritten before the budget was checked."""
    files[1].write_text(TREE.replace(old, new))
    there = {f"--{name}": files[0].with_name(f"{name}.csv") for name in ("sources", "table", "output")}
    for path in there.values():
        path.write_text("mine")
    arguments = [text for name, path in there.items() for text in (name, str(path))]
    refused(capsys, "budget", files[1], *arguments, *options)
    assert {path.read_text() for path in there.values()} == {"mine"}


def test_results_have_the_four_steps(files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    results = files[0].with_name("results.csv")
    assert main(["budget", str(files[0]), "--table", str(results)]) == 0
    with results.open() as file:
        rows = {row["source"]: row for row in csv.DictReader(file)}
    wheels = rows["platform / wheels"]
    assert (wheels["type"], wheels["random"], wheels["unit"]) == ("tones", "time", "mas")  # AST-1
    assert float(wheels["error_sigma_x"]) == pytest.approx(0.5 * 9.0 / np.sqrt(2.0))  # AST-2
    turn = 2.0 * np.pi * 33.0 * 0.02
    part = np.sqrt(1.0 - np.sinc(turn / (2.0 * np.pi)) ** 2)
    assert float(wheels["index_sigma_x"]) == pytest.approx(0.5 * 9.0 / np.sqrt(2.0) * part, rel=1e-6)  # AST-3
    assert float(rows["alignment"]["index_sigma_x"]) == 0.0 < float(rows["alignment"]["error_sigma_x"])
    total, limit, margin = (float(rows[name]["level"]) for name in ("total, distribution", "limit", "margin"))  # AST-4
    assert limit == pytest.approx(40.0) and margin == pytest.approx(limit - total)
    assert sum(float(row["share"]) for row in rows.values() if row["share"]) == pytest.approx(1.0)


SETTING = "source,type,unit,window,factor,text,sigma\na,random,mas,,,,1\n"
CELL = "source,type,unit,half_range,sigma,text\na,constant,mas,1,,, ,\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("source,type,colour\n", "columns must be among source, .* got 'colour'"),
        ("source,type\na,random\n", "columns must have source, type and unit, got no unit"),
        ("source,type,unit,sigma\na,random,mm,1\n", "line 2: unit must be one of .* got 'mm'"),
        ("source,type,unit,sigma\na,random,mas,1;x\n", "line 2: sigma must be a number, .* got '1;x'"),
        ("source,type,unit,sigma\na,random,mas,1\na,random,mas,1\n", "line 3: source must be unique"),
        ("source,type,unit,sigma\na,random,mas,1\na / b,random,mas,1\n", "line 3: source must not be nested in"),
        ("source,type,unit,sigma\na,magic,mas,1\n", "a: type must be one of"),
        ("source,type,unit,sigma,sigma\na,random,mas,1,2\n", "columns must be unique, got 'sigma' 2 times"),
        (SETTING + "colour,setting,,,,red\n", "line 3: setting must be one of title, .*, seed, got 'colour'"),
        (SETTING + "seed,setting,,,,1.5\n", "line 3: seed must be a whole number, got '1.5'"),
        (SETTING + "seed,setting,,,,2\nseed,setting,,,,2\n", "line 4: setting must be given once, got 'seed'"),
        (SETTING + "summation,setting,,,,sum\n", "summation must be distribution or rss, got 'sum'"),
        (SETTING + "RPE,total,,1;2,3,\n", "line 3: window must be one number, got '1;2'"),
        (SETTING + "RPE,total,,,3,\n", "window must be a positive number"),
        (SETTING + "PDE,total,,1,3,\n", "total must have an index, APE or RPE"),
        (SETTING + "b,random,mas,1,,\n", "line 3: window must be empty for a source, got '1'"),
        (
            CELL + "R,requirement,,,,prob(|APE| < 40 mas) >= 0.9 at 95 % confidence, mixed\n",
            "line 3: cells must be in a column with a heading, .*'mixed' in 7; quote a text",
        ),
        (CELL + "b,constant,mas,9,5,,1.5\n", "line 3: cells must be in a column with a heading, .*got '1.5' in 7"),
        (CELL + "b,constant,mas,9,5,,,,x\n", "line 3: cells must be in a column with a heading, .*got 'x' in 9"),
    ],
)
def test_mistakes_of_tables_are_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=message) as caught:
        load_budget(tmp_path / "a.csv")
    assert "\n" not in str(caught.value)


def test_blank_cells_beyond_the_heads_are_nothing(tmp_path: Path) -> None:
    text = '"prob(|APE| < 40 mas) >= 0.9 at 95 % confidence, mixed"'
    (tmp_path / "a.csv").write_text(f"source,type,unit,sigma,text,\na,constant,mas,2,,, ,\nR,requirement,,,{text},,\n")
    assert load_budget(tmp_path / "a.csv").requirements[0].interpretation == "mixed"


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ('type = "spectrum"\nfrequency = [1, 2]\npsd = [1, 1]', "a: a table has no column for psd of a source of type"),
        (
            'type = "drift"\nrate = 1\nduration = 1\ntransfer = {numerator = [1], denominator = [1, 1]}',
            "a: transfer must be a number in a table",
        ),
        ('[sources.a."b/c"]\ntype = "random"\nsigma = 1', "source must be a text, not empty and without '/'"),
    ],
)
def test_what_no_row_can_hold_is_refused(
    tmp_path: Path, source: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.toml").write_text(f'unit = "mas"\n[[total]]\nindex = "APE"\n[sources.a]\n{source}\n')
    assert message in refused(capsys, "budget", tmp_path / "a.toml", "--sources", tmp_path / "out.csv")
    assert not (tmp_path / "out.csv").exists()


def test_a_workbook_is_the_table(files: tuple[Path, Path], tmp_path: Path) -> None:
    """Sources and results there and back; numbers are numbers in the sheet."""
    openpyxl = pytest.importorskip("openpyxl")
    book, results = tmp_path / "budget.xlsx", tmp_path / "results.xlsx"
    assert main(["budget", str(files[1]), "--sources", str(book), "--table", str(results)]) == 0
    assert main(["budget", str(book), "--table", str(tmp_path / "again.csv")]) == 0
    assert main(["budget", str(files[1]), "--table", str(tmp_path / "results.csv")]) == 0
    assert (tmp_path / "again.csv").read_text() == (tmp_path / "results.csv").read_text()
    with (tmp_path / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    heads, *lines = openpyxl.load_workbook(results).active.iter_rows(values_only=True)
    assert list(heads) == list(rows[0]) and len(lines) == len(rows)
    levels = [line[heads.index("level")] for line in lines]
    assert levels == [float(row["level"]) for row in rows]


def test_a_sheet_of_a_user_is_read(tmp_path: Path) -> None:
    """Whole numbers, empty rows and columns at the end, cells of several axes."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    rows = [
        ["source", "type", "unit", "half_range", "amplitude", "frequency", "text", None],
        ["alignment", "constant", "mas", 20, None, None, None, None],
        [None] * 8,
        ["wheels", "periodic", "mas", None, "9; 4", 33, None, None],
        ["RPE", "requirement", None, None, None, None, "prob(|RPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence", None],
        [None] * 8,
    ]
    for row in rows:
        book.active.append(row)
    book.save(tmp_path / "mine.xlsx")
    found = load_budget(tmp_path / "mine.xlsx")
    assert sorted(source.name for source in found.sources) == ["alignment", "wheels"]
