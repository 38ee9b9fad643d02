"""Forces, torques and proof masses of a telescope's file: what they move, and laws that command them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli import app
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process

from lftkit.errors import InputError
from lftkit.systems.ports import Port
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_design.synthesis.store import load_designs
from pointing_analysis.read.run import Run
from titop_plant.interface import DT, K_PMA_INPUTS, K_PMA_OUTPUTS
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.summary import summarise

ACTUATORS = """
[[actuator]]
name = "motor"
kind = "torque"
place = "wheels"
axis = [0.6, 0.0, 0.8]
authority = 0.2

[[actuator]]
name = "thruster"
kind = "force"
place = "A1"
axis = [0.0, 0.6, 0.8]
position = [0.1, 0.2, 0.3]
authority = 5.0

[[actuator]]
name = "mass"
place = "M1"
axis = [0.0, 0.0, 1.0]
"""
WITHOUT_SIX = "[pma]\nazimuths_deg = []\n"
GYRO = """
[[sensor]]
name = "gyro"
kind = "rate_gyro"
noise = 1e-7
"""
DAMPER = '''
class Damper:
    """A torque against the rate about the motor's axis."""
    sensors, actuators = ("gyro",), ("motor",)
    def reset(self):
        pass
    def step(self, accel_Ip, out):
        out[:6], out[6] = 0.0, -40.0 * (0.6 * accel_Ip[6] + 0.8 * accel_Ip[8])
'''


def file_of(folder: Path, text: str) -> str:
    path = folder / "telescope.toml"
    path.write_text('base = "reference"\n' + text, "utf-8")
    return str(path)


def test_a_constant_value_turns_the_spacecraft_as_its_inertia_says(tmp_path: Path) -> None:
    """At rest the attitude law, w^2 times the diagonal of the inertia, holds the torque about the centre of mass."""
    telescope = load_telescope(file_of(tmp_path, ACTUATORS))
    moved = load_telescope(file_of(tmp_path, ACTUATORS.replace("[0.1, 0.2, 0.3]", "[0.0, 0.0, 0.0]")))
    angles = []
    for one in (telescope, moved):
        system = build_telescope(one, motors=True).system.at({})
        part = system.select(inputs=[actuator.name for actuator in one.placed_actuators], outputs=("attitude",))
        angles.append(part.D - part.C @ np.linalg.solve(part.A, part.B))
    motor, thruster, _ = telescope.placed_actuators
    assert motor.mount is not None and thruster.mount is not None
    stiffness = telescope.attitude_control.bandwidth**2 * np.diag(summarise(telescope).total_inertia)
    np.testing.assert_allclose(angles[0][:, 0], motor.mount.axis / stiffness, rtol=1e-9, atol=1e-12)
    arm = np.cross([0.1, 0.2, 0.3], thruster.mount.axis) / stiffness
    np.testing.assert_allclose(angles[0][:, 1] - angles[1][:, 1], arm, rtol=1e-8)
    assert np.abs(angles[0][:, 2]).max() < 1e-9 * np.abs(arm).max()  # the force of a mass is within the spacecraft
    assert [actuator.port.unit for actuator in telescope.placed_actuators] == ["Nm", "N", "N"]


@pytest.mark.parametrize("start", ["rest", "steady"])
def test_the_model_of_the_loop_has_them(start: str, tmp_path: Path) -> None:
    """Line of sight of a run, tick by tick, against the sampled loop of the controllers; and its replay."""
    stored = load_designs("implemented")[1]
    ports = tuple(Port(name, 1, unit) for name, unit in (("thruster", "N"), ("motor", "Nm")))
    more = np.random.default_rng(3).standard_normal((2, stored.order + 6)) * np.array([[1.0], [0.05]])
    C, D = np.vstack([stored.C, more[:, : stored.order]]), np.vstack([stored.D, more[:, stored.order :]])
    law = SampledSystem(stored.A, stored.B, C, D, K_PMA_INPUTS, (*K_PMA_OUTPUTS, *ports), DT)
    law.to_file(tmp_path / "k_pma.json")
    settings = {
        "mode": "inprocess", "noise": False, "duration": 1.5, "scenario": "imbalance", "start": start,
        "parameters": file_of(tmp_path, ACTUATORS), "k_pma": str(tmp_path / "k_pma.json"),
    }  # fmt: skip
    config = RunConfig.from_mapping(settings)
    run_in_process(config, tmp_path / "bag")
    run, parts = Run.open(tmp_path / "bag"), RunParts(config)
    los, model = run["truth/los"].values[:, :2], parts.tone_model()
    np.testing.assert_allclose(los, model.record(len(los)), rtol=0.0, atol=1e-9 * np.abs(los).max())
    without = RunParts(replace(config, k_pma=None)).tone_model().record(len(los))
    assert np.abs(los - without).max() > 1e-4 * np.abs(los).max()
    assert model.limits[8:].tolist() == [5.0, 0.2]
    units = {topic.name: topic.unit for topic in parts.topics if topic.name.startswith("actuator/")}
    assert units == {"actuator/thruster/command": "N", "actuator/motor/command": "Nm"}
    assert not app.main(["--quiet", "replay", str(tmp_path / "bag"), "--output", str(tmp_path / "again")])
    other = Run.open(tmp_path / "again")
    for name in ("pma/command", "actuator/thruster/command", "actuator/motor/command"):
        assert np.array_equal(run[name].values, other[name].values) and run[name].values.any()


def test_a_class_damps_the_attitude_with_gyro_and_motor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the six proof masses: the stage is there, the commands are those of the recorded rates."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "attitude_damper.py").write_text(DAMPER, "utf-8")
    telescope = file_of(tmp_path, WITHOUT_SIX + GYRO + ACTUATORS)
    assert load_telescope(telescope).stages[-1] == "fsm+pma"
    config = RunConfig(
        mode="inprocess", duration=1.0, start="rest", parameters=telescope, k_pma="attitude_damper:Damper",
        scenario="imbalance",
    )  # fmt: skip
    run_in_process(config, tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    rate, torque = run["sensor/gyro"].values, run["actuator/motor/command"].values[:, 0]
    expected = np.clip(-40.0 * (rate @ [0.6, 0.0, 0.8]), -0.2, 0.2)
    np.testing.assert_allclose(torque, expected, rtol=1e-12, atol=1e-15)
    assert np.abs(torque).max() > 0.0 and not run["pma/command"].values.any()


def test_a_source_drives_a_torque_by_its_last_column(tmp_path: Path) -> None:
    source = '[[disturbance]]\nname = "sine"\nkind = "cooler"\nplace = "motor"\nfrequency = 40.0\nharmonics = '
    turned = "[{ order = 1, torque = [0.0, 0.0, 0.1] }]\n"
    config = RunConfig(mode="inprocess", parameters=file_of(tmp_path, ACTUATORS + source + turned), loop="isolator")
    (placed,) = RunParts(config).sources
    assert np.flatnonzero(placed.matrix).size == 1 and placed.limit == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('kind = "thruster"', "'actuator[0].kind' must be one of proof_mass, force, torque, got 'thruster'"),
        ('kind = "force"', "has no 'authority'"),
        (
            'kind = "torque"\nauthority = 1.0\nmoving_mass = 1.0',
            "'actuator[0].moving_mass' must be absent for a torque",
        ),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(lines: str, message: str, tmp_path: Path) -> None:
    table = f'[[actuator]]\nname = "one"\nplace = "A1"\naxis = [1.0, 0.0, 0.0]\n{lines}\n'
    with pytest.raises(InputError, match=r"telescope\.toml, line \d: ") as refused:
        load_telescope(file_of(tmp_path, table))
    assert message in str(refused.value)
