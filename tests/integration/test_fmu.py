"""Units of FMI 2.0 in FMPy: the loop of both has the bits of the testbed."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli import app as cli
from los_testbed.config.run_config import RunConfig
from los_testbed.flight import export
from los_testbed.flight.fmu import plant_model
from los_testbed.parts.run_parts import RunParts
from support.flight_library import STRICT, same_bits
from support.loop_rows import COMMANDS, MEASUREMENTS, ROWS

from lftkit.arrays import FloatArray
from titop_plant.interface import DT, ESTIMATES, FORCES, PLATFORM, TRUTH

fmpy = pytest.importorskip("fmpy")
with_compiler = pytest.mark.skipif(export.compiler() is None, reason="no C compiler")
TICKS = 300


@pytest.fixture(scope="module")
def units(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fmu")
    assert cli.main(["export", "fmu", "--output", str(folder / "law.fmu")]) == 0
    assert cli.main(["export", "fmu", "--telescope", "--output", str(folder / "plant.fmu")]) == 0
    return folder


@contextmanager
def running(file: Path, folder: Path) -> Iterator[tuple[Any, list[int], list[int]]]:
    """A unit after its initialisation, with the references of its inputs and outputs."""
    from fmpy.fmi2 import FMU2Slave

    description = fmpy.read_model_description(str(file))
    folder.mkdir()
    fmpy.extract(str(file), str(folder))
    unit = FMU2Slave(
        guid=description.guid,
        unzipDirectory=str(folder),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="unit",
    )
    unit.instantiate()
    unit.setupExperiment(startTime=0.0)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    kinds = (
        [v.valueReference for v in description.modelVariables if v.causality == kind] for kind in ("input", "output")
    )
    try:
        yield unit, *kinds
    finally:
        unit.terminate()
        unit.freeInstance()


@with_compiler
def test_the_loop_of_both_units_has_the_bits_of_the_testbed(units: Path, tmp_path: Path) -> None:
    parts = RunParts(RunConfig(mode="inprocess", start="rest"))
    plant, estimator, controller = parts.plant(), parts.estimator(), parts.controller()
    plant.change("noise", 0)
    command, measured, los, estimate = np.zeros(COMMANDS), np.zeros(MEASUREMENTS), np.zeros(TRUTH), np.zeros(ESTIMATES)
    given: FloatArray = np.zeros(COMMANDS)
    with (
        running(units / "plant.fmu", tmp_path / "plant") as (telescope, commands, samples),
        running(units / "law.fmu", tmp_path / "law") as (law, sensed, answers),
    ):
        for k in range(TICKS):
            plant.step(command, measured, los)
            telescope.setReal(commands, given.tolist())
            telescope.doStep(k * DT, DT)
            values = np.array(telescope.getReal(samples))
            present = np.isfinite(measured)
            assert same_bits(values[:MEASUREMENTS][present], measured[present]).all()
            assert same_bits(values[MEASUREMENTS:], los).all()
            estimator.step(measured, estimate)
            controller.step(estimate, measured[PLATFORM], command)
            law.setReal(sensed, values[:MEASUREMENTS].tolist())
            law.doStep(k * DT, DT)
            found = np.array(law.getReal(answers))
            given = found[:COMMANDS]
            assert same_bits(given, command).all() and same_bits(found[COMMANDS:], estimate).all()
    assert np.abs(command[FORCES]).max() > 0 and np.abs(los).max() > 0


@with_compiler
def test_a_step_of_several_ticks_holds_its_inputs_and_a_reset_begins_again(units: Path, tmp_path: Path) -> None:
    with running(units / "plant.fmu", tmp_path / "plant") as (unit, commands, outputs):
        unit.setReal(commands, [1e-5, -2e-5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        for k in range(5):
            unit.doStep(k * DT, DT)
        single = unit.getReal(outputs)
        unit.reset()
        unit.setReal(commands, [1e-5, -2e-5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        unit.doStep(0.0, 5 * DT)
        assert unit.getReal(outputs) == single
        for size in (0.5 * DT, 0.0, -DT):
            with pytest.raises(Exception, match="fmi2DoStep"):
                unit.doStep(0.0, size)


def test_the_descriptions_are_valid(units: Path) -> None:
    from fmpy.validation import validate_fmu

    for name, inputs, outputs in (
        ("law", MEASUREMENTS, COMMANDS + ESTIMATES),
        ("plant", COMMANDS, MEASUREMENTS + TRUTH),
    ):
        assert not validate_fmu(str(units / f"{name}.fmu"))
        found = fmpy.read_model_description(str(units / f"{name}.fmu")).modelVariables
        assert [sum(v.causality == kind for v in found) for kind in ("input", "output")] == [inputs, outputs]


def test_without_a_compiler_a_unit_has_its_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert cli.main(["export", "fmu", "--output", str(tmp_path / "law.fmu")]) == 0
    assert "not built: no C compiler" in capsys.readouterr().out
    with zipfile.ZipFile(tmp_path / "law.fmu") as archive:
        names = set(archive.namelist())
    assert {"modelDescription.xml", "sources/fmi2.c", "sources/k_fsm.c"} <= names
    assert not any(name.startswith("binaries") for name in names)
    with pytest.raises(SystemExit, match="2"):
        cli.main(["export", "fmu", "--output", str(tmp_path / "law.fmu")])


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_unit_for_windows_has_a_library_with_the_functions_of_fmi(tmp_path: Path) -> None:
    pytest.importorskip("ziglang")
    file = tmp_path / "law.fmu"
    assert cli.main(["export", "fmu", "--windows", "--output", str(file)]) == 0
    with zipfile.ZipFile(file) as archive:
        assert archive.read("binaries/linux64/los_law.so")[:4] == b"\x7fELF"
        library = archive.read("binaries/win64/los_law.dll")
    assert library[:2] == b"MZ" and all(name in library for name in (b"fmi2Instantiate", b"fmi2DoStep", b"fmi2GetReal"))


def test_without_a_compiler_for_windows_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SystemExit, match="2"):
        cli.main(["export", "fmu", "--windows", "--output", str(tmp_path / "law.fmu")])
    assert "ziglang" in capsys.readouterr().err and not list(tmp_path.iterdir())


@with_compiler
@pytest.mark.parametrize("name", ["law", "plant"])
def test_the_sources_compile_without_a_warning(units: Path, tmp_path: Path, name: str) -> None:
    with zipfile.ZipFile(units / f"{name}.fmu") as archive:
        archive.extractall(tmp_path)
    sources = sorted(map(str, (tmp_path / "sources").glob("*.c")))
    line = [*(export.compiler() or ()), *STRICT, "-fsyntax-only", *sources]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr


def test_a_plant_that_is_no_telescope_with_constant_parameters_is_refused() -> None:
    config = RunConfig(mode="inprocess", scenario="ramp", theta_rate=0.01, ramp_duration=1.0, start="rest")
    with pytest.raises(ValueError, match="constant parameters"):
        plant_model(RunParts(config).plant(), ROWS)
