"""Invalid data: the error is one line that names the body, the port or the line of the file.

NASTRAN files: ``test_structures_nastran.py``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lftkit import Port, connect, invert, static_gain
from titop_plant import ports
from titop_plant.blocks.fast_steering_mirror import FastSteeringMirror, fast_steering_mirror
from titop_plant.blocks.flexible_body import flexible_body, rigid_body
from titop_plant.blocks.mounting import mounted
from titop_plant.blocks.reaction_wheel import ReactionWheel
from titop_plant.blocks.revolute_joint import on_revolute_joint
from titop_plant.structures import (
    ChildPort,
    ModalData,
    check_residual_mass,
    from_inertia,
)
from titop_plant.telescope.assembly import assembled_telescope, build_telescope
from titop_plant.telescope.load import load_telescope

MASS = from_inertia(5.0, np.eye(3), [0.1, 0.0, 0.0])
TURNED = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def panel(**changes: Any) -> ModalData:
    L = np.zeros((1, 6))
    L[0, 2] = 1.5
    data = ModalData("panel", "P", np.zeros(3), MASS, [3.0], [0.01], L, (ChildPort("tip", [1, 0, 0], 0.3 * L.T),))
    return dataclasses.replace(data, **changes)


def heavy_modes() -> ModalData:
    L = np.zeros((1, 6))
    L[0, 2] = 2.4  # effective mass 5.76 of 5 kg
    return panel(participation=L)


def panel_block() -> Any:
    return flexible_body(panel())


def wired(*extra: tuple[str, str], target: str = "panel.wrench_tip", unit: str = ports.WRENCH_UNIT) -> Any:
    load = Port("load", 6, unit)
    return connect(
        {"panel": panel_block()},
        [("accel_P", "panel.accel_P"), ("load", target), *extra],
        inputs=[ports.accel("P"), load],
        outputs={"wrench": "panel.wrench_P"},
    )


OBJECTS: dict[str, tuple[Callable[[], Any], list[str]]] = {
    "residual mass": (
        lambda: check_residual_mass(heavy_modes()),
        ["panel", "residual mass", "z translation", "-0.76 kg of 5"],
    ),
    "negative mass, body": (lambda: panel(mass_matrix=-MASS), ["panel", "mass must be positive", "-5 kg"]),
    "negative mass, inertia": (lambda: from_inertia(-2.0, np.eye(3), [0, 0, 0], "tank"), ["tank", "mass", "-2 kg"]),
    "negative mass, wheel": (lambda: ReactionWheel(-1.0, 0.1, 0.05), ["reaction wheel", "mass", "-1.0"]),
    "negative mass, mirror": (
        lambda: fast_steering_mirror(FastSteeringMirror(-0.05, np.eye(3), 77.0, 0.0)),
        ["fast steering mirror", "-0.05 kg"],
    ),
    "inertia": (lambda: from_inertia(1.0, -np.eye(3), [0, 0, 0], "tank"), ["tank", "inertia_at_cg", "semidefinite"]),
    "direction cosines": (
        lambda: mounted(panel_block(), "P", "A1", dcm=TURNED),
        ["mounting of P at A1", "orthonormal", "0.1"],
    ),
    "rotated body": (lambda: panel().rotated(TURNED), ["panel", "dcm", "orthonormal"]),
    "frequency": (lambda: panel(frequencies=[-3.0]), ["panel", "frequenc", "-3"]),
    "two points of one name": (lambda: panel(parent="tip"), ["panel", "'tip' twice"]),
    "unknown child": (lambda: flexible_body(panel(), deflections=["rim"]), ["panel", "'rim'", "tip"]),
    "joint": (
        lambda: on_revolute_joint(panel_block(), "P", [0, 0, 1], stiffness=-1.0, damping=0.0),
        ["revolute joint at P", "stiffness", "-1.0"],
    ),
    "joint without inertia": (
        lambda: on_revolute_joint(
            rigid_body("ball", "P", np.diag([2.0] * 3 + [0.0] * 3)), "P", [1, 0, 0], stiffness=1.0, damping=0.0
        ),
        ["revolute joint at P", "must have inertia about the axis"],
    ),
    "unknown port": (lambda: wired(target="panel.wrench_rim"), ["'panel.wrench_rim'", "panel.wrench_tip"]),
    "two drivers": (
        lambda: wired(("load", "panel.wrench_tip")),
        ["'panel.wrench_tip'", "must have one driver", "load"],
    ),
    "other unit": (lambda: wired(unit=ports.TWIST_UNIT), ["load -> panel.wrench_tip", "same unit", "m/s2", "Nm"]),
    "open input": (
        lambda: connect(
            {"panel": panel_block()},
            [("accel_P", "panel.accel_P")],
            inputs=[ports.accel("P")],
            outputs={"w": "panel.wrench_P"},
        ),
        ["must have a driver", "none for panel.wrench_tip"],
    ),
    "channel not invertible": (
        lambda: invert(static_gain(np.zeros((1, 1)), [Port("u", 1)], [Port("y", 1)]), {"u": "y"}),
        ["u -> y", "must be invertible"],
    ),
    "port of the telescope": (
        lambda: assembled_telescope().system["los", "wheel_imbalanse"],
        ["input port must be", "got 'wheel_imbalanse'", "wheel_imbalance"],
    ),
    "value beyond its range": (
        lambda: assembled_telescope().system.at({"wheel_2.speed": 2000.0}),
        ["'wheel_2.speed'", "[-1047.2, 1047.2] rad/s", "2000"],
    ),
    "unknown parameter": (
        lambda: assembled_telescope().system.at({"wheel_5.speed": 1.0}),
        ["'wheel_5.speed'", "wheel_1.speed"],
    ),
}


def one_line(error: BaseException, words: list[str]) -> None:
    message = str(error)
    assert "\n" not in message
    for word in words:
        assert word in message, message


@pytest.mark.parametrize("name", OBJECTS)
def test_the_message_names_the_body_or_the_port(name: str) -> None:
    make, words = OBJECTS[name]
    with pytest.raises(ValueError) as caught:
        make()
    one_line(caught.value, words)


ARRAY, MODES = "[solar_array]\n", "[[solar_array.further_modes]]\n"
PARAMETERS = [
    (ARRAY + "mass = -59.0", ["line 2", "'solar_array.mass' must be positive", "-59.0"]),
    ("\n\n[pma]\n\nmoving_mass = 0", ["line 5", "'pma.moving_mass' must be positive", "0"]),
    ("[fsm]\nmass = -0.05", ["line 2", "'fsm.mass'", "-0.05"]),
    ("[fsm]\nstiffness = 'stiff'", ["line 2", "'fsm.stiffness' must be a number", "'stiff'"]),
    ("[fsm]\nstiffness = nan", ["line 2", "'fsm.stiffness' must be a number", "nan"]),
    ("[isolator]\nstiffness = [1e6, 1e6]", ["line 2", "'isolator.stiffness' must have 6 entries, got 2"]),
    ("[isolator]\ndamping = [1.0, 1.0, 1.0, -1.0, 1.0, 1.0]", ["line 2", "'isolator.damping[3]'", "negative"]),
    (ARRAY + "dcm_A1 = [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]", ["at A1", "orthonormal", "0.1"]),
    (ARRAY + "inertia_at_cg = [[-1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]", ["solar array", "inertia_at_cg"]),
    (
        ARRAY + "participation = [[0, 0, 6.5, -57.0, 0, 0], [6.8, 0, 0, 0, 0, 47.0]]",
        ["solar array", "residual mass", "x rotation"],
    ),
    (ARRAY + "frequencies = [0.743]", ["line 2", "'solar_array.frequencies' must have 2 entries"]),
    (ARRAY + "relative_uncertainty = 1.5", ["line 2", "'solar_array.relative_uncertainty'", "1.5"]),
    (ARRAY + "theta_range = [-7.0, 1.0]", ["line 2", "'solar_array.theta_range[0]'", "-7.0"]),
    (ARRAY + "theta_range = [1.0, 2.0]", ["'solar_array.tau'", "lower <= nominal <= upper"]),
    (MODES + 'frequency = 1.0\nshare = 0.1\ndirection = "up"', ["line 4", "[0].direction'", "'up'", "z translation"]),
    (MODES + "frequency = 1.0\nshare = 0.1", ["line 1", "further_modes[0]' has no 'direction'"]),
    (MODES + 'direction = "z translation"\nfrequency = 1.0\nshare = 1.4', ["line 4", "further_modes[0].share'", "1.4"]),
    ("[payload]\nequipment = 3", ["line 2", "'payload.equipment' must be tables"]),
    ('[[payload.equipment]]\nname = "x"\nmass = 1.0\nsize = [1, 1, 1]', ["'position' or a 'node'"]),
    ('[[body.equipment]]\nname = "x"\nmass = -1.0\nsize = [1, 1, 1]\nnode = "G"', ["line 3", "equipment[0].mass'"]),
    ("[payload]\nmodes = 2.5", ["line 2", "'payload.modes' must be a whole number", "2.5"]),
    ("[payload]\nmodes = 4000", ["payload", "modes", "4000"]),
    ('[payload]\nmodal_data = "none.toml"', ["payload.modal_data", "none.toml", "No such file"]),
    ("[optics]\nmirror_distance = 3.0", ["mirror distance", "1.8 m", "3.0"]),
    ("[attitude_control]\nbandwidth = -0.06", ["line 2", "'attitude_control.bandwidth'", "-0.06"]),
    ("[reaction_wheel]\ncant_deg = 0.0", ["line 1", "'reaction_wheel'", "span the space", "rank 2"]),
    ("[materials.cfrp]\nE = -1.0", ["line 2", "'materials.cfrp.E'", "-1.0"]),
    ("[wheels]\nmass = 1.0", ["line 1", "unknown parameter 'wheels'", "reaction_wheel"]),
]


@pytest.mark.parametrize(
    ("text", "words"), PARAMETERS, ids=lambda value: value.split("\n")[-1] if isinstance(value, str) else ""
)
def test_errors_of_a_parameter_file_name_line_and_key_or_the_body(tmp_path: Path, text: str, words: list[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ValueError) as caught:
        build_telescope(load_telescope(path))
    one_line(caught.value, words)
    if "line" in words[0]:
        assert "mine.toml" in str(caught.value)
