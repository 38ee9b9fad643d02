"""A plant that is a file: the same telescope as its assembly, MATLAB's layout, one line about what does not fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import io

from lftkit import Port, System, write_mat, write_system
from los_estimator.kalman import acceleration_sensitivity, fitted_sensitivity
from titop_plant.simulation.build import build_plant
from titop_plant.simulation.plant_config import PlantConfig, parameter_values
from titop_plant.telescope.assembly import assembled_telescope, build_telescope
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.uncertain_parameters import further_parameters

SMALL = Path(__file__).parents[3] / "examples" / "spacecraft" / "small_telescope.toml"
WHEELS = "".join(
    f"""
[[reaction_wheel]]
name = "wheel_{axis}"
axis = {[float(axis == one) for one in "xyz"]}
position = [0.0, 0.0, 0.0]
default_speed = 180.0
"""
    for axis in "xyz"
)
TABLES = """
[plant]
file = "plant.mat"

[pma]
azimuths_deg = []

[[solar_array]]
name = "panel"
point = "A1"
like = "reference"
driven = false
"""


def matlab(system: System, names: dict[str, str] | None = None, **changes: Any) -> dict[str, Any]:
    """The struct that the lines of docs/extend/a_plant_from_a_file.md save, by numpy and scipy alone."""
    A, B, C, D = (M.copy() for M in system.sorted_channels().lft)
    column, rows = 0, []
    for element, count in zip(system.parameters, system.occurrences().values()):
        assert element.upper - element.nominal == pytest.approx(element.nominal - element.lower)
        half, there = 0.5 * (element.upper - element.lower), slice(column, column + count)
        B[:, there] *= half
        D[:, there] *= half
        rows.append(((names or {}).get(element.name, element.name), element.nominal, element, count))
        column += count
    fields = "Name", "Nominal", "Range", "Occurrences"
    table = np.zeros((1, len(rows)), dtype=[(name, object) for name in fields])
    for k, (name, nominal, element, count) in enumerate(rows):
        table[0, k] = name, nominal, np.array([[element.lower, element.upper]]), float(count)
    labels = [
        np.array([f"{p.name}({i})" if p.size > 1 else p.name for p in side for i in range(1, p.size + 1)], dtype=object)
        for side in (system.inputs, system.outputs)
    ]
    return {"A": A, "B": B, "C": C, "D": D, "InputName": labels[0], "OutputName": labels[1], "Blocks": table, **changes}


@pytest.fixture(scope="module")
def small() -> System:
    """Two fixed panels and three wheels."""
    return build_telescope(load_telescope(SMALL)).system


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    """A parameter file with the plant of a system, or of a struct for MATLAB."""

    def write(plant: System | dict[str, Any], tables: str = TABLES + WHEELS) -> Path:
        file = tmp_path / "plant.mat"
        if isinstance(plant, System):
            write_mat(file, P=plant)
        else:
            io.savemat(file, {"P": plant})
        (tmp_path / "mine.toml").write_text('base = "reference"\n' + tables)
        return tmp_path / "mine.toml"

    return write


@pytest.mark.parametrize("ending", ["mat", "json"])
def test_the_reference_as_a_file_is_the_reference(tmp_path: Path, ending: str) -> None:
    """All bits of its responses, its parameters and its first seconds."""
    reference = load_telescope()
    system = assembled_telescope(reference).system
    if ending == "mat":
        write_mat(tmp_path / "p.mat", P=system)
    else:
        write_system(tmp_path / "p.json", system)
    (tmp_path / "mine.toml").write_text(f'base = "reference"\n[plant]\nfile = "p.{ending}"\n')
    found = load_telescope(tmp_path / "mine.toml")
    assert found.stages == reference.stages[1:] and dict(found.uncertain) == {
        name: replace(p, description=found.uncertain[name].description) for name, p in reference.uncertain.items()
    }
    own, other = control_loop_plant(found), control_loop_plant(reference)
    (values,) = other.sample_values(np.random.default_rng(0))
    np.testing.assert_array_equal(own.at(values)(30j), other.at(values)(30j))
    runs = []
    for parameters in (str(tmp_path / "mine.toml"), None):
        plant = build_plant(PlantConfig(parameters=parameters, scenario="imbalance"))
        measured, truth = np.zeros((50, 22)), np.zeros((50, 2))
        for row in range(50):
            plant.step(np.zeros(8), measured[row], truth[row])
        runs.append(np.hstack([measured, truth]))
    np.testing.assert_array_equal(runs[0], runs[1])


def test_a_file_of_matlab_is_the_telescope_that_it_was_made_of(written: Callable[..., Path], small: System) -> None:
    """Another telescope, normalised, signals with MATLAB's labels; a parameter without a name of the testbed."""
    telescope = load_telescope(written(matlab(small, {"panel.omega_1": "k1"})))
    assert telescope.plant is not None and telescope.stages == ("isolator", "fsm")
    assert further_parameters(telescope.uncertain, telescope.factors) == ["k1"]
    values = parameter_values(PlantConfig(disturbance=False, frequencies=(20.5,)), telescope)
    assert values == {"wheel_1.speed": 180.0, "wheel_2.speed": 180.0, "wheel_3.speed": 180.0, "k1": 20.5}
    found = telescope.plant.at(values)
    expected = small.at({("panel.omega_1" if name == "k1" else name): value for name, value in values.items()})
    one, other = found["los_controlled", "wheel_imbalance"], expected["los_controlled", "wheel_imbalance"]
    for omega in (0.3, 20.5, 700.0):
        np.testing.assert_allclose(one(1j * omega), other(1j * omega), rtol=1e-8)


def test_speeds_that_are_no_blocks_are_those_of_the_tones(written: Callable[..., Path], small: System) -> None:
    speeds = {f"wheel_{i}.speed": 100.0 * i for i in (1, 2, 3)}
    fixed = System(*small.at(speeds).matrices, small.inputs, small.outputs)
    config = PlantConfig(parameters=str(written(fixed)), scenario="imbalance", wheel_speed=(100.0, 150.0, 200.0))
    plant = build_plant(config)
    assert load_telescope(config.parameters).uncertain == {}
    assert {100.0, 150.0, 200.0} <= {round(float(tone), 9) for tone in plant.tones}


def test_the_fitted_sensitivity_predicts_as_that_of_the_bodies_does() -> None:
    """Rigid motion of the whole: the acceleration of the line of sight by the accelerometers."""
    assembled = assembled_telescope()
    known = acceleration_sensitivity(load_telescope(), assembled.bodies[1])
    fitted = fitted_sensitivity(assembled.system)
    spin = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    seen = np.concatenate([spin, *(assembled.bodies[1].child_tau(name) @ spin for name in ("M1", "M2"))])
    assert known @ seen == pytest.approx([1.0, 0.0], abs=1e-9)
    assert fitted @ seen == pytest.approx([1.0, 0.0], abs=0.1)


def without(system: System, *names: str) -> System:
    return system.select(
        inputs=[p.name for p in system.inputs if p.name not in names],
        outputs=[p.name for p in system.outputs if p.name not in names],
    )


def in_unit(system: System, name: str, unit: str) -> System:
    outputs = tuple(Port(p.name, p.size, unit if p.name == name else p.unit) for p in system.outputs)
    return replace(system, outputs=outputs)


@pytest.mark.parametrize(
    ("change", "tables", "message"),
    [
        (lambda p: without(p, "accel_M2"), "", "must have the output accel_M2"),
        (lambda p: in_unit(p, "los_controlled", "arcsec"), "", "los_controlled must be in rad, got arcsec"),
        (lambda p: p.renamed(elements={"wheel_3.speed": "speed"}), "", "must have wheel_1.speed, wheel_2.speed"),
        (lambda p: replace(p, dt=0.001), "", "must be continuous, got the period 0.001 s"),
        (None, WHEELS.replace("wheel_", "w") + WHEELS, "wheel_imbalance must have 30 signals, got 15"),
        (None, '[[sensor]]\nname = "x"\n', "must be absent with [plant]"),
    ],
)
def test_a_plant_that_does_not_fit_is_refused_in_one_line(
    written: Callable[..., Path], small: System, change: Callable[[System], System] | None, tables: str, message: str
) -> None:
    text = TABLES + (tables if "[[reaction_wheel]]" in tables else WHEELS + tables)
    path = written(change(small) if change else small, text)
    with pytest.raises(ValueError) as refused:
        load_telescope(path)
    assert message in str(refused.value) and "\n" not in str(refused.value) and "mine.toml" in str(refused.value)
