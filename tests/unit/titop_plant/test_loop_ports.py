"""Rows of the loop: what is known of all of them whatever a telescope's file adds."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from lftkit.systems.ports import Port
from titop_plant.interface import COMMAND_PORTS, COMMANDED, MEASURED_PORTS
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.loop_ports import DISTURBANCE, LINE_OF_SIGHT, LoopPorts

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
    file.write_text(OWN)
    return load_telescope(file).loop_ports


def test_idle_devices_are_named_in_the_plural_where_there_are_several(own: LoopPorts) -> None:
    left = own.idle(["shaker", "damper"])
    assert left == "controllers and predictions do not use sensors on_m1, at_root of the telescope's file"
    assert "use sensor at_root and actuators shaker, damper of" in own.idle(["on_m1"])


def test_a_telescope_without_further_sensors_is_told() -> None:
    with pytest.raises(
        ValueError, match=r"sensors must be distinct names of the telescope's file \(it has none\), got"
    ):
        LoopPorts().named(("on_m1",))


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
    assert not own.used_by(law("accel_Ip"), law("pma_force")).further
    for names in (("on_m1",), ("at_root", "shaker"), ("damper",)):
        used = own.used_by(law(), law(*names))
        assert used.sensors == own.sensors
        assert [row.name for row in used.further_actuators] == [n for n in ("shaker", "damper") if n in names]
        assert used.used_by(law(*names)) == used
    assert own.used_by(law("on_m1", "shaker", "damper")) == own


def test_a_controller_sees_what_it_names_in_the_order_of_the_rows(own: LoopPorts) -> None:
    first, given = MEASURED_PORTS[:1], law("at_root", "on_m1", "damper")
    assert [port.name for port in own.seen_by(given, first)] == ["accel_Ip", "on_m1", "at_root"]
    assert [port.name for port in own.driven_by(given, COMMAND_PORTS[1:])] == ["pma_force", "damper"]
    with pytest.raises(ValueError, match=r"measured port must be one of accel_Ip, .*, at_root, got 'shaker'"):
        own.measured_columns([Port("shaker", 1)])


def test_ports_of_a_controller_name_sensors_in_the_order_of_the_rows(own: LoopPorts) -> None:
    """Actuators are in the order of its own outputs: they are behind the eight values of its command."""
    given = law("damper", "at_root", "shaker", "pma_force", "on_m1")
    found = own.among(given.inputs, given.outputs)
    assert [port.name for port in found.further] == ["on_m1", "at_root", "damper", "shaker"]
    assert found.commands == own.commands and not own.among((), ()).further
