"""Files of disturbances: from the file to the source, to the run, and to its row beside the verdict."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli.app import main
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.disturbance_files import entries_of, make_sources
from los_testbed.parts.run_parts import RunParts
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
        ("t,fx,fz,wheel.fz", "0,1,2,3;0.0005,-1,2,3", ("columns not used: wheel.fz",)),
        ("t,fx,note", "0,1,n/a;0.0005,-1,2", ("text columns ignored: note",)),
        ("frequency,fx,phase", "1,2,3;100,2,3", ("columns not used: phase",)),
        ("order,fx,ty,comment", "1,2,3,a;2,1,1,b", ("text columns ignored: comment",)),
        ("speed [rpm],frequency,fx,count", WATERFALL, ("columns not used: count",)),
    ],
)
def test_what_has_no_effect_is_said(tmp_path: Path, header: str, rows: str, remarks: tuple[str, ...]) -> None:
    (tmp_path / "a.csv").write_text(f"{header}\n" + rows.replace(";", "\n") + "\n")
    entries = entries_of([f"{tmp_path / 'a.csv'}@wheel_2"])
    for _ in range(2):
        (found,) = make_sources(entries, load_telescope(), RunConditions(RUN.speeds, 0.001, 1))
        assert tuple(text for text in found.remarks if "columns" in text) == remarks


TOML = """
[[disturbance]]
name = "wheel"
kind = "harmonics"
place = "wheel_1"
harmonics = [{order = 1.0, force = [1e-6, 1e-6, 0.0]}, {order = 40.0, force = [1e-6, 0.0, 0.0]}]

[[disturbance]]
name = "cooler"
kind = "cooler"
place = "payload"
frame = "body"
offset = [0.1, 0.0, 0.0]
frequency = 45.0
linewidth = 0.01
harmonics = [{order = 1, force = [0.2, 0.0, 0.0]}, {order = 2, torque = [0.0, 0.0, 0.01]}]

[[disturbance]]
name = "thruster"
kind = "pulses"
force = [0.5, 0.0, 0.0]
period = 2.0
width = 0.05
"""


def test_tables_of_one_file(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(TOML)
    wheel, cooler, thruster = make_sources(entries_of([str(tmp_path / "a.toml")]), load_telescope(), RUN)
    assert wheel.signal.lines.tolist() == [200.0]
    assert wheel.remarks == ("1 tones above 1000 Hz excluded",)
    assert np.abs(wheel.signal.amplitude[0, :2]).tolist() == pytest.approx([1e-6 * 200.0**2] * 2)  # type: ignore[attr-defined]
    assert cooler.signal.lines == pytest.approx(2 * np.pi * np.array([45.0, 90.0]))
    assert thruster.place == "bus" and not thruster.signal.lines.size


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


def test_a_density_from_0_hz_is_that_from_a_low_frequency(tmp_path: Path) -> None:
    zero, low = (of_table(tmp_path, "frequency,Tz", [[first, 1e-3], [40.0, 1e-3]]) for first in (0.0, 0.1))
    assert np.std(zero.values[:, 5]) == pytest.approx(np.sqrt(1e-3 * 40.0), rel=0.2)
    assert np.std(zero.values[:, 5]) == pytest.approx(np.std(low.values[:, 5]), rel=0.2)


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
        ("frequency (Hz),Tz (Nm)", "must be Nm.2/Hz or .*, got 'Nm'"),
        ("frequency (MHz),Tz", "frequency .* must be Hz, kHz or rad/s, got 'mhz'"),
        ("order,Fx (N)", r"must be N s\^2/rad\^2 or .* \(squared = false for N\), got 'N'"),
        ("time (ticks),Fx", "unit of the time must be one of s, ms, us, ns, min, h, d, got 'ticks'"),
        ("time (s),Fx (Nm)", r"unit of Fx \(Nm\) must be N or mN, got 'Nm'"),
        ("time (s),Mz (N)", r"unit of Mz \(N\) must be Nm or mNm, got 'N'"),
        ("frequency (Hz),Fx (Nm^2/Hz)", r"must be N\^2/Hz or mN\^2/Hz, got"),
        ("order,Mx (N s^2)", r"must be Nm s\^2/rad\^2 or"),
        ("order (Hz),Fx", r"unit of order \(Hz\) must be none"),
        ("time,Fx (N)", r"unit of the times must be known where they are 1 apart"),
    ],
)
def test_units_of_another_quantity_are_refused(tmp_path: Path, header: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        of_table(tmp_path, header, [[1.0, 1e-6], [2.0, 1e-6]])


def test_an_array_of_six_columns_may_have_both_units(tmp_path: Path) -> None:
    """One unit of all six is that of another quantity for three of them."""
    for unit, factor in (("N, Nm", [1.0, 1.0]), ("mN; mNm", [1e-3, 1e-3])):
        np.savez(tmp_path / "a.npz", t=T, wrench=WRENCH, wrench_unit=unit)
        (found,) = make_sources(entries_of([str(tmp_path / "a.npz")]), load_telescope(), RUN)
        signal: Any = found.signal
        assert np.allclose(signal.values, WRENCH * np.repeat(factor, 3))
    np.savez(tmp_path / "a.npz", t=T, wrench=WRENCH, wrench_unit="N")
    with pytest.raises(ValueError, match=r"unit of wrench\.\w must be Nm or mNm, got 'N'"):
        make_sources(entries_of([str(tmp_path / "a.npz")]), load_telescope(), RUN)


def test_a_series_may_have_dates(tmp_path: Path) -> None:
    rows = "\n".join(f"2026-01-01T00:00:{t:012.9f},{force}" for t, force in zip(T, WRENCH[:, 0]))
    (tmp_path / "a.csv").write_text(f"time,Fx\n{rows}\n")
    (found,) = make_sources(entries_of([str(tmp_path / "a.csv")]), load_telescope(), RUN)
    signal: Any = found.signal
    assert signal.rate == RATE and np.allclose(signal.values[:, 0], WRENCH[:, 0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            'name = "a"\nkind = "wind"',
            "kind must be one of series, harmonics, waterfall, psd, cooler, pulses, got 'wind'",
        ),
        ('name = "a"\nkind = "cooler"\nfrequncy = 45.0', "keys must be among .*frequency.*, got frequncy"),
        (
            'name = "a"\nkind = "cooler"\nfrequency = 45.0\nharmonics = [{order = 1, forces = [1.0, 0.0, 0.0]}]',
            "keys of a harmonic must be among order, force, torque, got forces",
        ),
        ('name = "a"\nkind = "cooler"\nfrequency = -1.0\nharmonics = [{order = 1}]', "frequency must be .* got -1.0"),
        ('name = "a"\nkind = "pulses"\nplace = "moon"\nperiod = 1.0\nwidth = 0.1', "place must be one of bus, wheels"),
        (
            'name = "a"\nkind = "pulses"\nframe = "up"\nperiod = 1.0\nwidth = 0.1',
            "frame must be own, body or three rows",
        ),
        ('name = "a"\nkind = "pulses"\nperiod = 1.0\nwidth = 2.0', "width must not be above the period"),
        ('name = "a"\nkind = "harmonics"\nharmonics = [{order = 1}]', "speed must be given"),
        ('name = "a"\nkind = "series"\nfile = "none.csv"', "none.csv: no such file"),
        ('kind = "series"', "name must be a text"),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.toml").write_text(f"[[disturbance]]\n{text}\n")
    with pytest.raises(ValueError, match=message) as caught:
        make_sources(entries_of([str(tmp_path / "a.toml")]), load_telescope(), RUN)
    assert "\n" not in str(caught.value)


def test_a_record_that_is_too_short_says_what_to_do(tmp_path: Path) -> None:
    csv(tmp_path / "a.csv")
    with pytest.raises(ValueError, match=r"as long as the run, 60 s, got 3 s \(repeat = true repeats it\)"):
        make_sources(entries_of([str(tmp_path / "a.csv")]), load_telescope(), RunConditions(RUN.speeds, 60.0, 1))
    (tmp_path / "b.toml").write_text('[[disturbance]]\nname = "b"\nkind = "series"\nfile = "a.csv"\nrepeat = true\n')
    (found,) = make_sources(
        entries_of([str(tmp_path / "b.toml")]), load_telescope(), RunConditions(RUN.speeds, 60.0, 1)
    )
    assert len(found.signal.values) == 6000, "noise fits to itself"  # type: ignore[attr-defined]
    assert found.remarks == ("record repeated every 3 s, as it is",)


def test_sources_of_the_telescope_act_in_its_runs_and_change_no_design(tmp_path: Path) -> None:
    (tmp_path / "telescope.toml").write_text(TOML)
    telescope = load_telescope(tmp_path / "telescope.toml")
    assert telescope.parameters_hash == load_telescope().parameters_hash
    config = RunConfig(parameters=str(tmp_path / "telescope.toml"), duration=2.0)
    assert [source.name for source in RunParts(config).sources] == ["wheel", "cooler", "thruster"]
    assert not RunParts(config).config.scenario_acts
    assert RunParts(replace(config, scenario="imbalance")).config.scenario_acts
    assert not RunParts(RunConfig(parameters=config.parameters, disturbance=False)).sources


def test_a_cooler_is_a_tone_and_every_source_has_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    cooler = """
[[disturbance]]
name = "cooler"
kind = "cooler"
frequency = 45.0
harmonics = [{order = 1, force = [200.0, 0.0, 0.0]}, {order = 2, force = [0.0, 100.0, 0.0]}]
"""
    Path("cooler.toml").write_text(cooler)
    csv(Path("measured.csv"))
    command = ["run", "--mode", "inprocess", "--duration", "3", "--json", "--output", "bag", "--report"]
    assert main([*command, "--disturbance", "cooler.toml", "--disturbance", "measured.csv@wheel_2"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["scenario"] == "cooler, measured"
    rows = {row["name"]: row for row in found["disturbances"]}
    assert rows["cooler"]["place"] == "bus" and rows["measured"]["kind"] == "series"
    assert list(rows) == ["cooler", "measured", "sensor noise", "together"]
    assert rows["cooler"]["share"] > 0.85 and sum(row["share"] for row in rows.values()) == pytest.approx(2.0, abs=1e-5)
    budget = found["budget_rpe_mas"]
    assert budget["noise"] < 12.0 and budget["fast"] > 3.0 * budget["noise"]  # all of it was noise
    assert budget["fast"] == pytest.approx(np.sqrt(2) * rows["cooler"]["rpe"], rel=0.05)
    page = Path("bag/report.html").read_text()
    assert "Sources of disturbance" in page and "45.000" in page
    Path("cooler.toml").write_text(cooler.replace("200.0", "300.0"))
    assert main(["report", "bag", "--json"]) == 0
    assert "have changed since the run" in Path("bag/report.html").read_text()
