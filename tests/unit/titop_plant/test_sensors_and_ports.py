"""Rows of the loop, sensors and the guide camera: order, noise, bias, frames, low-pass, what a file adds."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lftkit.systems.ports import Port
from titop_plant.interface import ACCELEROMETERS, COLUMNS, COMMAND_PORTS, COMMANDED, LAW_PORTS, MEASURED, MEASURED_PORTS
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.control_plant import with_sensors
from titop_plant.telescope.guide_camera import exposure_low_pass
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.loop_ports import DISTURBANCE, LINE_OF_SIGHT, LoopPorts

EXAMPLES = Path(__file__).parents[3] / "examples" / "spacecraft"
OWN = """
[[sensor]]
name = "on_m1"
place = "M1"
noise = 2e-4
bias = 3e-3

[[sensor]]
name = "at_root"
place = "A1"
axes = [[0.0, 0.0, 1.0]]

[[actuator]]
name = "shaker"
place = "A1"
axis = [0.0, 0.0, 1.0]
authority = 7.9

[[actuator]]
name = "damper"
place = "detector"
axis = [1.0, 0.0, 0.0]
"""


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> LoopPorts:
    """Rows of a telescope with sensors and actuators of a file."""
    file = tmp_path_factory.mktemp("telescope") / "own.toml"
    file.write_text('base = "reference"\n' + OWN)
    return load_telescope(file).loop_ports


def test_a_name_that_no_row_has_is_refused() -> None:
    ports = load_telescope().loop_ports
    with pytest.raises(ValueError, match=r"sensors must be a list .* of the telescope's file \(accel_Ip, .*, got"):
        ports.of_law("k_pma", ["on_m1"])
    with pytest.raises(ValueError, match=r"actuators must be a list .* \(pma_force\), got \['fsm_command'\]"):
        ports.of_law("k_pma", (), ["fsm_command"])


@pytest.mark.parametrize("names", ["on_m1", {"on_m1"}, None, [["on_m1"]], ["on_m1", "on_m1"]], ids=repr)
def test_names_that_have_no_order_are_refused(own: LoopPorts, names: Any) -> None:
    """A set would have another order of the vector in each process."""
    with pytest.raises(ValueError, match="sensors must be a list or tuple of distinct names of the telescope's file"):
        own.of_law("k_pma", names)


@pytest.mark.parametrize("file", [None, *sorted(EXAMPLES.glob("*.toml"))], ids=lambda file: file and file.stem)
def test_every_other_port_of_a_telescope_is_a_reserved_name(file: Path | None, tmp_path: Path) -> None:
    """Also of one with loads on all nodes and motors: a device of that name would be connected in place of the port."""
    telescope, text = load_telescope(file), "" if file is None else file.read_text()
    devices = {row.name for row in (*telescope.placed_sensors, *telescope.placed_actuators)}
    loads, names = tuple(dict.fromkeys(telescope.nodes.values())), set[str]()
    for isolated in (True, False):
        system = build_telescope(telescope, isolated=isolated, loads=loads, motors=True).system
        whole = with_sensors(system, telescope)
        names |= {port.name for one in (system, whole) for port in (*one.inputs, *one.outputs)} - devices
    assert {"attitude", "los", "load_M1"} < names
    for name in sorted(names):
        table = f'\n[[actuator]]\nname = "{name}"\nplace = "M1"\naxis = [1.0, 0.0, 0.0]\n'
        (tmp_path / "mine.toml").write_text((text or 'base = "reference"\n') + table)
        with pytest.raises(ValueError, match=r"actuator\[\d\].name' must not be one of .*, nor begin with load_, got"):
            load_telescope(tmp_path / "mine.toml")


def law(*names: str) -> SimpleNamespace:
    """A controller with ports of these names."""
    ports = tuple(Port(name, 1) for name in names)
    return SimpleNamespace(inputs=ports, outputs=ports)


@pytest.mark.parametrize("count", [0, 20, 22])
def test_ports_of_the_response_are_a_partition(own: LoopPorts, count: int) -> None:
    """Whatever the number of disturbances is; the port of the forces has those of the file's actuators."""
    inputs = np.arange(count + own.commands)
    found = [inputs[own.columns_of(name)] for name in (DISTURBANCE, *COMMANDED)]
    assert np.concatenate(found).tolist() == inputs.tolist() and len(found[0]) == count
    outputs = np.arange(2 + own.commands)
    rows = [outputs[own.rows_of(name)] for name in (LINE_OF_SIGHT, *COMMANDED)]
    assert np.concatenate(rows).tolist() == outputs.tolist() and len(rows[0]) == 2
    assert outputs[own.applied].size == inputs[own.added].size == own.commands
    assert np.array_equal(outputs[own.applied][own.forces], rows[-1])


def test_each_value_has_its_noise_and_scale(own: LoopPorts) -> None:
    telescope = load_telescope()
    assert np.array_equal(own.noise[:22], np.concatenate([row.noise for row in telescope.sensors]))
    assert own.noise[22:25].tolist() == [2e-4] * 3 and own.bias[22:25].tolist() == [3e-3] * 3
    authority = np.concatenate([np.full(row.port.size, row.authority) for row in own.actuators])
    limit = telescope.pma.authority  # one limit for all forces in units of their scale
    np.testing.assert_allclose(authority[own.forces], limit * own.scale[own.forces], rtol=1e-15)
    assert own.scale[:8].tolist() == [1.0] * 8


def test_a_loop_has_the_rows_that_its_controllers_use(own: LoopPorts) -> None:
    stored = own.used_by(law("accel_Ip"), law("pma_force"))
    assert (stored.measured, stored.commanded) == (MEASURED_PORTS, COMMAND_PORTS)
    for names in (("on_m1",), ("at_root", "shaker"), ("damper",)):
        used = own.used_by(law(), law(*names))
        assert [row.name for row in used.sensors] == [*MEASURED, *(n for n in ("on_m1", "at_root") if n in names)]
        assert [row.name for row in used.actuators] == [*COMMANDED, *(n for n in ("shaker", "damper") if n in names)]
        assert used.used_by(law(*names)) == used
    assert own.used_by(law("on_m1", "at_root", "shaker", "damper")) == own


def test_a_controller_sees_what_it_names_in_the_order_of_the_rows(own: LoopPorts) -> None:
    used = own.of_system("k_pma", law("at_root", "accel_M2", "on_m1", "damper"))
    assert [row.name for row in used.sensors] == ["accel_Ip", "accel_M2", "on_m1", "at_root"]
    assert [row.name for row in used.actuators] == ["pma_force", "damper"]
    with pytest.raises(ValueError, match=r"measured port must be one of accel_Ip, .*, at_root, got 'shaker'"):
        own.measured_columns([Port("shaker", 1)])


def test_ports_of_a_controller_name_sensors_in_the_order_of_the_rows(own: LoopPorts) -> None:
    """Actuators are in the order of its own outputs, behind those of the stored controller."""
    used = own.of_system("k_pma", law("damper", "at_root", "shaker", "pma_force", "on_m1"))
    assert [port.name for port in used.commanded] == ["pma_force", "damper", "shaker"]
    assert used.commands == own.commands - 2  # without the mirror
    assert own.of_system("k_pma", law()).law_ports("k_pma") == LAW_PORTS["k_pma"]
    assert own.of_system("k_fsm", law()).law_ports("k_fsm") == LAW_PORTS["k_fsm"]


REFERENCE = load_telescope()


def user(folder: Path, text: str) -> str:
    file = folder / "user.toml"
    file.write_text('base = "reference"\n' + text, "utf-8")
    return str(file)


@pytest.mark.parametrize(("exposure", "delay", "ratio"), [(0.02, 0.0, 16), (0.02, 0.002, 8), (0.005, 0.02, 8)])
def test_the_low_pass_is_the_exposure_up_to_the_second_order(exposure: float, delay: float, ratio: float) -> None:
    """At half of the frequency an eighth of the difference to the exposure; without delay it is one order higher."""
    c0, c1, c2 = exposure_low_pass(exposure, delay)
    omega = np.array([2.0, 1.0]) / (exposure + delay) / 10.0
    s = 1j * omega
    exact = np.exp(-s * delay) * (1.0 - np.exp(-s * exposure)) / (s * exposure)
    error = np.abs(c0 / (s**2 + c1 * s + c2) - exact)
    assert 1e-9 < error[1] < 1e-3
    assert error[0] / error[1] == pytest.approx(ratio, rel=0.05)


def test_the_vector_camera_and_its_designs_are_as_they_were(tmp_path: Path) -> None:
    """The table of the guide camera counts only where low-pass and noise follow from it."""
    own = load_telescope(user(tmp_path, "[camera]\nmagnitude = 9.0\nexposure = 0.01\n"))
    assert own.camera.magnitude == 9.0 and not own.takes_images
    assert own.parameters_hash == REFERENCE.parameters_hash
    assert own.to_mapping()["sensors"] == REFERENCE.to_mapping()["sensors"]


def test_a_star_makes_low_pass_and_noise(tmp_path: Path) -> None:
    values = {}
    for magnitude in (10.0, 12.0, 14.0):
        text = f'[sensors]\ncamera = "magnitude"\n[camera]\nmagnitude = {magnitude}\n'
        values[magnitude] = load_telescope(user(tmp_path, text))
    sensors = [own.to_mapping()["sensors"] for own in values.values()]
    assert all(tuple(s["camera_filter"]) == exposure_low_pass(0.02, 0.002) for s in sensors)
    noise = [s["camera_noise"] for s in sensors]
    # a bright star: the noise of its photons alone, so the root of their number; a faint one has more
    assert noise[1] / noise[0] > 10.0**0.4 and noise[2] / noise[1] > noise[1] / noise[0]
    hashes = {own.parameters_hash for own in values.values()} | {REFERENCE.parameters_hash}
    assert len(hashes) == 4


TABLE: dict[str, Any] = {
    "accelerometer_noise": [1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3],
    "accelerometer_bias": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
    "camera_noise": 2e-3,
    "strain_gauge_noise": 5e-2,
    "washout": 0.7,
}


@pytest.fixture(scope="module")
def sensed():
    return load_telescope().changed({"sensors": TABLE})


def test_each_port_has_its_own_values_in_the_order_of_the_measurement(sensed) -> None:
    found = sensed.sensors
    assert tuple(sensor.port.name for sensor in found) == MEASURED
    noise, bias = sensed.loop_ports.noise, sensed.loop_ports.bias
    for sensor in found:
        part, name = COLUMNS[sensor.port.name], sensor.port.name
        accelerometer = name in ACCELEROMETERS
        assert (sensor.framed, sensor.washout) == (name == "camera_los", 0.7 if accelerometer else 0.0)
        kind = {"camera_los": 2e-3, "fsm_angle": 5e-2}.get(name, TABLE["accelerometer_noise"])
        assert np.array_equal(noise[part], np.broadcast_to(kind, sensor.port.size))
        assert np.array_equal(bias[part], TABLE["accelerometer_bias"] if accelerometer else np.zeros(2))


def test_noise_of_a_frame_is_larger_as_if_every_tick_had_one(sensed) -> None:
    """The mean of the samples of a frame's ticks has the frame's noise."""
    ratio = sensed.loop_ports.with_frames(25).noise_of_ticks / sensed.loop_ports.noise
    assert ratio[COLUMNS["camera_los"]].tolist() == [5.0, 5.0]
    assert np.sum(ratio != 1.0) == 2
