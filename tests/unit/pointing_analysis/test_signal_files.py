"""Signals of a bag in other formats and objects: every number comes back, and what is evaluated of it is the same."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.command_line import call_command

from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.dataframes import to_pandas, to_xarray
from pointing_analysis.read.los_source import open_los
from pointing_analysis.read.run import Run
from pointing_analysis.read.topic import Topic
from pointing_analysis.report.signal_files import TopicSignal, signals_of, write_signals

BAG = Path(__file__).parents[3] / "bags" / "reference"


@pytest.fixture(scope="module")
def signals() -> list[TopicSignal]:
    return signals_of(Run.open(BAG))


def matlab_5(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    content = loadmat(path, simplify_cells=True)
    return {s["topic"]: s for name, s in content.items() if not name.startswith("__")}


def matlab_7_3(path: Path) -> dict[str, Any]:
    """As MATLAB sees it: axes the other way round, texts as codes, cells as references."""
    h5py = pytest.importorskip("h5py")
    found = {}

    def text(data: Any) -> str:
        assert data.attrs["MATLAB_class"] == b"char"
        return "".join(map(chr, data[()].ravel()))

    with h5py.File(path, "r") as file:
        for name, group in file.items():
            if name == "#refs#":
                continue
            assert group.attrs["MATLAB_class"] == b"struct"
            cells = {key: [text(file[ref]) for ref in group[key][()].ravel()] for key in ("columns", "units")}
            numbers = {key: group[key][()].T for key in ("time", "stamp_ns", "values")}
            found[text(group["topic"])] = {**numbers, **cells}
    return found


@pytest.mark.parametrize(("version", "read"), [("5", matlab_5), ("7.3", matlab_7_3)])
def test_matlab_has_each_topic_as_a_structure(
    version: str, read: Any, signals: list[TopicSignal], tmp_path: Path
) -> None:
    write_signals(signals, tmp_path / "run.mat", version)
    found = read(tmp_path / "run.mat")
    assert set(found) == {s.name for s in signals}
    for s in signals:
        there = found[s.name]
        np.testing.assert_array_equal(there["values"], s.values)
        np.testing.assert_array_equal(np.ravel(there["stamp_ns"]), s.stamp)
        np.testing.assert_array_equal(np.ravel(there["time"]), s.time)
        assert tuple(there["columns"]) == s.columns and tuple(there["units"]) == s.units
    start = (tmp_path / "run.mat").read_bytes()[:128]
    assert start.startswith(b"MATLAB 5.0" if version == "5" else b"MATLAB 7.3") and start[126:] == b"IM"


@pytest.mark.parametrize(
    ("name", "version"), [("a.mat", "5"), ("a.mat", "7.3"), ("a.npz", ""), ("a.csv", ""), ("a.parquet", "")]
)
def test_the_line_of_sight_is_read_without_an_option_and_by_its_topic(
    name: str, version: str, signals: list[TopicSignal], tmp_path: Path
) -> None:
    """With the unit that the file has, also of one topic of the bag."""
    write_signals(signals, tmp_path / name, version)
    (truth,) = [s for s in signals if s.name == "truth/los"]
    write_signals([truth], tmp_path / f"one{name}", version)
    for path, options in ((name, {}), (name, {"los": "truth/los"}), (f"one{name}", {})):
        np.testing.assert_array_equal(open_los(tmp_path / path, **options)["truth/los"].values, truth.values[:, :2])


def test_numpy_has_arrays_by_topic(signals: list[TopicSignal], tmp_path: Path) -> None:
    write_signals(signals, tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as found:
        for s in signals:
            np.testing.assert_array_equal(found[s.name], s.values)
            np.testing.assert_array_equal(found[f"{s.name}.stamp_ns"], s.stamp)
            assert tuple(found[f"{s.name}.units"]) == s.units


def table_of(path: Path) -> tuple[list[str], np.ndarray[Any, Any]]:
    if path.suffix == ".CSV":
        with path.open(newline="") as file:
            heads, *rows = csv.reader(file)
        return heads, np.array([[float(cell or "nan") for cell in row] for row in rows])
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(path)
    return table.column_names, np.column_stack([column.to_numpy() for column in table.columns]).astype(float)


@pytest.mark.parametrize("suffix", [".CSV", ".parquet"])
def test_a_table_has_a_row_for_each_stamp(suffix: str, signals: list[TopicSignal], tmp_path: Path) -> None:
    """The camera has a frame in every twentieth row; a topic is what its columns are without the empty cells."""
    write_signals(signals, tmp_path / f"run{suffix}")
    heads, rows = table_of(tmp_path / f"run{suffix}")
    assert heads[0] == "time [s]" and len(rows) == len(np.unique(np.concatenate([s.stamp for s in signals])))
    for s in signals:
        columns = [heads.index(head) for head in s.heads]
        there = ~np.isnan(rows[:, columns]).all(axis=1)
        np.testing.assert_array_equal(rows[there][:, columns], s.values[~np.isnan(s.values).all(axis=1)])
        assert s.name != "camera/los" or 0 < there.sum() < len(rows) / 10


@pytest.mark.usefixtures("without_pictures")
def test_an_exported_line_of_sight_has_the_figures_of_its_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sources = [[str(BAG)]]
    for suffix in (".csv", ".mat"):
        file = str(tmp_path / f"run{suffix}")
        code, _, err = call_command(capsys, "bag", "export", str(BAG), "--topics", "truth/los", "--output", file)
        assert code == 0, err
        sources.append([file, "--los", "truth/los x [rad],truth/los y [rad]"])
    sources[2][2:] = ["truth_los.values", "--time", "truth_los.time", "--unit", "rad"]
    figures = []
    for words in sources:
        code, out, err = call_command(capsys, "analyse", *words, "--transient", "1", "--json")
        assert code == 0, err
        figures.append(json.loads(out.splitlines()[-1]))
    for name in ("ape_arcsec", "rpe_mas"):
        assert figures[0][name] == figures[1][name] == figures[2][name]


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--output", "run.xls"], [".mat, .npz, .csv, .parquet", "run.xls"]),
        (["--output", "run.mat", "--mat-version", "6"], ["--mat-version", "6"]),
        (["--output", "run.csv", "--mat-version", "5"], ["--mat-version", ".mat file", "run.csv"]),
        (["--output", "run.csv", "--topics", "truth/pos"], ["truth/pos", "truth/los"]),
        (["--output", "run.csv", "--from", "3", "--to", "2"], ["--from", "--to"]),
        (["--output", "there.csv"], ["--output", "there.csv"]),
        (["--output", "none/run.csv"], ["--output", "none"]),
    ],
)
def test_what_cannot_be_written_is_one_line(
    words: list[str], names: list[str], tmp_path: Path, monkeypatch: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.csv").write_text("mine", "utf-8")
    code, _, err = call_command(capsys, "bag", "export", str(BAG), *words)
    last = err.splitlines()[-1]
    assert code == 2 and all(name in last for name in names), err
    assert [path.name for path in tmp_path.iterdir()] == ["there.csv"]


@pytest.fixture
def topic(tmp_path: Path) -> Topic:
    values = np.random.default_rng(0).standard_normal((50, 6))
    return Run.open(write_bag(tmp_path / "bag", {"m1/accel": values}))["m1/accel"]


def test_pandas(topic: Topic) -> None:
    pytest.importorskip("pandas")
    frame = to_pandas(topic)
    assert np.array_equal(frame.to_numpy(), topic.values)
    assert list(frame.columns)[3] == "angular.x"
    assert frame.attrs["unit"] == "m/s2, rad/s2"
    assert np.array_equal(frame.index.asi8, topic.stamp)


def test_xarray(topic: Topic) -> None:
    pytest.importorskip("xarray")
    array = to_xarray(topic)
    assert float(array.sel(component="linear.y")[7]) == topic.values[7, 1]
    assert np.allclose(array["time"], 1e-3 * np.arange(50))
    assert array.attrs["units"] == topic.unit
