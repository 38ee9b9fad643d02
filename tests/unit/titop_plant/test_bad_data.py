"""Invalid data: the error is one line that names the body, the port or the line of the file.

A row is what is made, or the text of a parameter file, and parts of the message between bars. Further wrong files:
``tests/integration/test_wrong_inputs.py``; NASTRAN files: ``test_nastran_decks.py``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lftkit import Port, RealParameter
from titop_plant.blocks.fast_steering_mirror import FastSteeringMirror, fast_steering_mirror
from titop_plant.blocks.flexible_body import flexible_body, rigid_body
from titop_plant.blocks.reaction_wheel import ReactionWheel, reaction_wheel
from titop_plant.blocks.revolute_joint import on_revolute_joint
from titop_plant.blocks.wheel_bearing import WheelBearing
from titop_plant.sensors import SensorEntry
from titop_plant.simulation.plant_config import PlantConfig
from titop_plant.structures import (
    Beam,
    BeamFrame,
    ChildPort,
    LumpedMass,
    ModalData,
    Section,
    from_inertia,
    to_modal_data,
)
from titop_plant.structures.sections import bar, box, tube
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.load import load_telescope

TURNED = np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
SECTION = Section(E=7e10, G=2.7e10, density=2800.0, A=4e-4, Iy=3e-8, Iz=6e-8, J=5e-8)
ALUMINIUM = {"E": 7e10, "G": 2.7e10, "density": 2800.0}
LIMITS = load_telescope().device_limits
BALL = np.diag([2.0] * 3 + [0.0] * 3)
X = np.array([1.0, 0.0, 0.0])


def arm(**changes: Any) -> ModalData:
    L = np.zeros((3, 6))
    L[:, 2] = 0.5
    tip = ChildPort("tip", X, 0.3 * L.T)
    mass = from_inertia(40.0, np.diag([3.0, 4.0, 5.0]), [0.2, -0.1, 0.4])
    data = ModalData("arm", "P", np.zeros(3), mass, [10.0, 20.0, 35.0], [0.01] * 3, L, (tip,))
    return dataclasses.replace(data, **changes)


def crane(beam: Beam | None = None, *masses: LumpedMass) -> BeamFrame:
    nodes = {"a": [0.0, 0.0, 0.0], "c": [0.8, 0.1, 0.2]}
    return BeamFrame("crane", nodes, (beam or Beam("a", "c", SECTION, X),), masses)


def loose() -> BeamFrame:
    """A second part has a mass and no stiffness."""
    nodes = {"a": 0 * X, "c": X, "d": 5 * X}
    return BeamFrame("loose", nodes, (Beam("a", "c", SECTION),), (LumpedMass("d", 1.0, np.eye(3), name="lost"),))


def wheel(**bearing: float) -> ReactionWheel:
    return ReactionWheel(
        1.0, 0.096, 0.05, WheelBearing(**{"rotor_mass": 0.8, "rotor_radial_inertia": 0.045, **bearing})
    )


def joint(body: Any, **values: float) -> Any:
    return on_revolute_joint(body, "P", X, **{"stiffness": 1.0, "damping": 0.0, **values})


SOFT, SPEED = {"radial_stiffness": 1.5e6}, RealParameter("speed", 0.0, -1000.0, 1000.0)
OBJECTS: list[tuple[Callable[[], Any], str]] = [
    (lambda: from_inertia(-2.0, np.eye(3), [0, 0, 0], "tank"), "tank|mass|-2 kg"),
    (lambda: from_inertia(1.0, -np.eye(3), [0, 0, 0], "tank"), "tank|inertia_at_cg|semidefinite"),
    (lambda: ReactionWheel(-1.0, 0.1, 0.05), "mass must be above 0 kg, got -1"),
    (lambda: fast_steering_mirror(FastSteeringMirror(-0.05, np.eye(3), 77.0, 0.0)), "fast steering mirror|-0.05 kg"),
    (lambda: arm().rotated(TURNED), "arm|dcm|orthonormal"),
    (lambda: flexible_body(arm(), deflections=["rim"]), "arm|'rim'|tip"),
    (lambda: joint(flexible_body(arm()), stiffness=-1.0), "revolute joint at P|stiffness|-1.0"),
    (lambda: joint(rigid_body("ball", "P", BALL)), "revolute joint at P|must have inertia about the axis"),
    (lambda: arm(frequencies=[10.0, 0.0, 35.0]), "arm|frequencies|0 rad/s for mode 2|clamped"),
    (lambda: arm(frequencies="abc"), "arm|frequencies|numbers"),
    (lambda: arm(participation=np.zeros((3, 5))), "arm|participation|(3, 6)|(3, 5)"),
    (lambda: arm(mass_matrix=-np.eye(6)), "arm|mass must be positive|-1 kg"),
    (lambda: arm(mass_matrix=np.diag([1.0, 1, 1, 1, -2, 1])), "arm|inertia|-2|y rotation"),
    (lambda: arm(mass_matrix=np.eye(6) + 0.1 * np.eye(6, k=3)), "arm|symmetric|[0, 3]"),
    (lambda: arm(mass_matrix=np.eye(6) + 3 * (np.eye(6, k=3) + np.eye(6, k=-3))), "arm|positive semidefinite"),
    (lambda: arm(mass_matrix=np.full((6, 6), np.nan)), "arm|mass_matrix|finite"),
    (lambda: arm(parent="tip"), "arm|different names|tip"),
    (lambda: arm(parent=""), "arm|names"),
    (lambda: arm(children=(ChildPort("tip", X, np.zeros((6, 2))),)), "arm|tip|(6, 3)|(6, 2)"),
    (lambda: to_modal_data(crane(), "x", ["c"]), "crane: parent and ports must be of |got 'x'"),
    (lambda: to_modal_data(crane(), "a", ["c"], 999), "modes must be 0 to 6, got 999"),
    (
        lambda: to_modal_data(BeamFrame("b", {"a": 0 * X, "c": X, "d": 2 * X}, (Beam("a", "c", SECTION),)), "a", []),
        "mass in all six",
    ),
    (lambda: to_modal_data(loose(), "a", ["c"]), "loose: structure must have no mechanism"),
    (lambda: crane(Beam("a", "x", SECTION)), "ends of beam a-x must be nodes, got unknown node 'x'"),
    (lambda: crane(None, LumpedMass("x", 1.0)), "must be at a node, got 'x'"),
    (lambda: crane(Beam("a", "a", SECTION)), "end points must be different"),
    (lambda: crane(Beam("a", "c", SECTION, [0.8, 0.1, 0.2])), "parallel"),
    (lambda: Beam("a", "c", SECTION, elements=0), "elements must be at least 1"),
    (lambda: LumpedMass("a", -1.0, name="tank"), "tank|mass must not be negative, got -1"),
    (lambda: dataclasses.replace(SECTION, E=-1.0), "E must be positive"),
    (lambda: dataclasses.replace(SECTION, density=-1.0), "density"),
    (lambda: tube(ALUMINIUM, 0.1, 0.06), "tube"),
    (lambda: box(ALUMINIUM, 0.1, 0.1, 0.05), "box"),
    (lambda: bar(ALUMINIUM, 0.1, 0.0), "bar"),
    (lambda: wheel(radial_stiffness=-1.0), "radial_stiffness must be above 0 N/m, got -1"),
    (lambda: wheel(radial_damping=1.0, axial_stiffness=1.0), "radial_damping must be absent without radial_stiffness"),
    (lambda: wheel(), "must have one of radial_stiffness, axial_stiffness, rocking_stiffness, got none"),
    (
        lambda: reaction_wheel(wheel(**SOFT, rotor_mass=1.5), SPEED),
        "bearing.rotor_mass must be at most 1 of the wheel, got 1.5",
    ),
    (lambda: wheel(**SOFT, radial_damping=-0.1), "radial_damping must be at least 0 N s/m, got -0.1"),
    (lambda: dataclasses.replace(LIMITS, mirror_rate=-1.0), "mirror_rate must be at least 0 rad/s, got -1"),
    (lambda: dataclasses.replace(LIMITS, gauge_step=-1.0), "gauge_step must be at least 0 rad, got -1"),
    (lambda: dataclasses.replace(LIMITS, cut_off=500.0), "cut_off must be at least 0 and below 500 Hz, got 500"),
    (lambda: SensorEntry(Port("a", 4), "a", "a", "a", "n", "s"), "size of a must be 1 to 3, or 6 of a twist, got 4"),
    (lambda: PlantConfig(camera_rate=300.0), "camera_rate must divide 1000 Hz (50, 40, 25, ...), got 300 Hz"),
    (lambda: PlantConfig(camera_rate=0.5), "camera_rate must be between 1 and 1000 Hz, got 0.5"),
    (lambda: PlantConfig(scenario="quiet"), "scenario must be one of worst_case, unit_norm, design, |got 'quiet'"),
]


def parts_of(error: ValueError, words: str) -> None:
    message = str(error)
    assert "\n" not in message
    for word in words.split("|"):
        assert word in message, message


@pytest.mark.parametrize(("make", "words"), OBJECTS, ids=lambda value: value if isinstance(value, str) else "")
def test_the_message_names_the_body_or_the_port(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(ValueError) as caught:
        make()
    parts_of(caught.value, words)


ARRAY, MODES = "[solar_array]\n", "[[solar_array.further_modes]]\n"
ONE = '[[solar_array]]\nname = "one"\nlike = "reference"\npoint = "A1"\n'
TWO = ONE + ONE.replace("one", "two").replace("A1", "A2")
SENSOR = '[[sensor]]\nname = "a"\nplace = "bus"\n'
PUSH = '[[actuator]]\nname = "a"\nplace = "A1"\naxis = [0.0, 0.0, 1.0]\n'
NAMED, MOUNT = '[[requirement]]\nname = "APE"\n', '[[payload.equipment]]\nname = "FSM mount"\n'
DRIFT = 'name = "drift"\ntext = "prob(|PDE(1 s, 10 s)| < 1 arcsec) >= 0.9 at 90 % confidence"\n'
BEARING = "[reaction_wheel.bearing]\nrotor_mass = 0.8\nrotor_radial_inertia = 0.045\nradial_stiffness = 1.5e6\n"
NOISE = "[reaction_wheel.broadband]\nfrequency = [1.0, 2.0]\n"
STEPPER = (
    "[sadm.stepper]\nrotor_inertia = 1.2e-5\ngear_ratio = 100.0\nfull_steps = 200\nmicro_steps = 16\n"
    "holding_torque = 0.4\nrate = 1e-3\n"
)
FILES = [
    ("[pma\n", "is not a TOML file"),
    ("[robot]\nx = 1\n", "line 2|unknown parameter 'robot'"),
    ("pma = 3\n", "line 2|'pma' must be a table"),
    ("[materials]\nwood = [1.0]\n", "line 3: 'materials.wood' must be a table, got [1.0]"),
    ("[camera]\nexposure = 1e308\n", "line 3: 'camera.exposure' must be whole milliseconds, got 1e+308 s"),
    (
        '[robot]\n[pma]\nmas = 1.0\n[[sensor]]\nplac = "bus"\n[[payload.equipment]]\nname = "x"\nsiz = 1\n',
        "line 2: unknown parameter 'robot'|line 4: unknown parameter 'pma.mas'|; line 6: unknown parameter "
        "'sensor[0].plac': did you mean place?; line 9: unknown parameter 'payload.equipment[0].siz': did you mean",
    ),
    ('[[payload.equipment]]\nname = "x"\n', "line 2: 'payload.equipment[0]' has no 'mass' and 'size'"),
    ("\n\n[pma]\n\nmoving_mass = 0", "line 6|'pma.moving_mass' must be above 0 kg, got 0"),
    ("[fsm]\nstiffness = nan", "line 3|'fsm.stiffness' must be a finite number above 0 Nm/rad, got nan"),
    ("[materials.aluminium]\nE = [7e10]", "line 3|E' must be a number above 0 Pa, got [70000000000]"),
    ('[body]\nmodal_data = ["a"]', "line 3|'body.modal_data' must be a text|got ['a']"),
    ("[body]\ndeck_heights = [[1.0], 0, 2]", "line 3|'body.deck_heights[0]' must be a number, got [1]"),
    ("[body]\ndeck_heights = 1", "line 3|'body.deck_heights' must be a list of 3 numbers, got 1"),
    ("[solar_array]\nparticipation = true", "line 3|must be a list of 1 list of 6 numbers or more, got True"),
    ("[isolator]\nstiffness = [1e6, 1e6]", "line 3|'isolator.stiffness' must hold 6 numbers, got 2"),
    (
        "[isolator]\ndamping = [1.0, 1.0, 1.0, -1.0, 1.0, 1.0]",
        "line 3|'isolator.damping[3]' must be at least 0 N s/m|got -1",
    ),
    (ARRAY + f"dcm_A1 = {TURNED.tolist()}", "at A1|orthonormal|0.1"),
    (ARRAY + "inertia_at_cg = [[-1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]", "solar array|inertia_at_cg"),
    (ARRAY + "theta_range = [-7.0, 1.0]", "line 3|'solar_array.theta_range[0]'|between -2 pi and 2 pi|got -7"),
    (ARRAY + "theta_range = [1.0, 2.0]", "line 3|'solar_array.theta_range' must be increasing and contain 0|1 to 2"),
    (MODES + 'frequency = 1.0\nshare = 0.1\ndirection = "up"', "line 5|[0].direction'|'up'|z translation"),
    (MODES + "frequency = 1.0\nshare = 0.1", "line 2|further_modes[0]' has no 'direction'"),
    (MODES + 'direction = "z translation"\nfrequency = 1.0\nshare = 1.4', "line 5|further_modes[0].share'|1.4"),
    ("[payload]\nequipment = 3", "line 3|'payload.equipment' must be tables"),
    ('[[payload.equipment]]\nname = "x"\nmass = 1.0\nsize = [1, 1, 1]', "'position' or a 'node'"),
    ("[[payload.equipment]]\nmass = 3.0", "payload.equipment[0]|name"),
    (MOUNT + MOUNT, "line 5|payload.equipment[1].name|twice"),
    ('[payload]\nreplace = ["sections"]', "payload.replace|equipment|sections"),
    ('[payload]\nreplace = ["equipment"]', "payload.replace|must name lists that this file holds"),
    ("[payload]\nmodes = 2.5", "line 3|'payload.modes' must be a whole number|2.5"),
    ("[optics]\nmirror_distance = 3.0", "line 3|optics.mirror_distance|below the primary focal length 1.8 m, got 3 m"),
    ("[reaction_wheel]\ncant_deg = 0.0", "line 2|'reaction_wheel'|span the space|rank 2"),
    ("[reaction_wheel]\nazimuths_deg = [0, 120, 240]\n", "default_speed|each of 3 wheels|got 4"),
    ('[[solar_array]]\nname = "one"\nlike = "reference"\n', "solar_array[0]|no 'point'"),
    ('[[solar_array]]\nname = "one"\npoint = "A1"\nmass = 3.0\n', "solar_array[0]|must have modes"),
    (ONE + ONE.replace("A1", "A2"), "solar_array[1].name|once|'one' twice"),
    (ONE.replace('"one"', '"payload"'), "solar_array[0].name|another place|'payload'"),
    (ONE + "colour = 1\n", "line 6|solar_array[0].colour|frequencies"),
    (ONE + "dcm = [[1, 0, 0], [0, 1, 0], [0, 0, 2]]\n", "solar_array[0].dcm|orthonormal"),
    (TWO + 'parameters = "one"\nfrequencies = [0.7, 2.0]\n', "solar_array[1].frequencies|'one'|shares"),
    (TWO + "theta_range = [-1.0, 1.0]\n", "solar_array[1].theta_range|'one'|one angle"),
    (ONE + "theta_range = [1.0, 2.0]\n", "theta_range|contain 0|1 to 2"),
    ("solar_array = []\n[sadm]\ntorque_bound = 5.0\n", "line 4|sadm.torque_bound|no solar array is driven"),
    ("[pma]\nazimuths_deg = []\nmoving_mass = 3.0\n", "line 4|pma.moving_mass|no proof-mass actuator"),
    ("[pma]\nazimuths_deg = [1.0, 2.0]\n", "pma.azimuths_deg|3 angles, or none|got 2"),
    (SENSOR.replace("bus", "M3"), "line 4: 'sensor[0].place' must be one of bus, wheels"),
    ('[[sensor]]\nname = "a"\n', "'sensor[0]' has no 'place'"),
    (SENSOR + SENSOR, "'sensor[1].name' must be given once, got 'a' twice"),
    (
        SENSOR + "axes = [[1.0, 1.0, 0.0]]",
        "'sensor[0].axes' must be a unit vector, got [1.0, 1.0, 0.0] of length 1.414",
    ),
    (
        SENSOR + 'kind = "gyro"',
        "'sensor[0].kind' must be one of accelerometer, |got 'gyro'",
    ),
    (SENSOR + "noise = -1.0", "'sensor[0].noise' must be at least 0, got -1"),
    (SENSOR + "range = 0.0", "'sensor[0].range' must be above 0, got 0"),
    ('[[actuator]]\nname = "a"\nplace = "A1"\n', "'actuator[0]' has no 'axis'"),
    (PUSH + "inertia = [1.0, 1.0, 0.0]", "'actuator[0].inertia[2]' must be above 0 kg m2, got 0"),
    (NAMED + 'text = "APE below 3"\n', "line 4: 'requirement[0].text' must be a requirement"),
    (NAMED + "loop = 3\n", "line 4|must be a text or a list of texts, got 3"),
    (NAMED + 'loop = "both"\n', "line 4|must be among none, isolator, fsm, fsm+pma"),
    (NAMED + "limit = 3\n", "unknown parameter 'requirement[0].limit'"),
    (
        f'replace = ["requirement"]\n[[requirement]]\n{DRIFT}',
        "one on |APE|one on |APE| and one on rms RPE for the stages",
    ),
    ('[sensors]\ncamera = "film"\n', "line 3: 'sensors.camera' must be vector, magnitude or image, got 'film'"),
    ("[camera]\nwindow = 8\n", "line 3: 'camera.window' must be odd and between 7 and 63 pixels, got 8"),
    ("[camera]\nexposure = 0.0205\n", "line 3: 'camera.exposure' must be whole milliseconds, got 0.0205 s"),
    ('[sensors]\ncamera = "image"\ncamera_noise = 1e-8\n', "line 4: 'sensors.camera_noise' must be absent"),
    ('[sensors]\ncamera = "image"\n[optics]\npupil = "no.fits"\n', "cannot read the pupil |no.fits"),
    ("[plant]\n", "must be a table with the name of a file"),
    ('[plant]\nfile = "none.mat"\n', "none.mat"),
    ('[plant]\nfile = "mine.toml"\n', "must be a .mat file"),
    (BEARING.replace("rotor_mass = 0.8\n", ""), "line 2|reaction_wheel.bearing|no 'rotor_mass'"),
    (BEARING.replace("0.8", "1.8"), "line 3|rotor_mass|at most 1 of the wheel, got 1.8"),
    (BEARING + "colour = 1\n", "line 6|reaction_wheel.bearing.colour|rotor_mass"),
    (BEARING.replace("1.5e6", '"soft"'), "line 5|radial_stiffness' must be a number above 0 N/m, got 'soft'"),
    (BEARING.replace("1.5e6", "-1.0"), "line 5: 'reaction_wheel.bearing.radial_stiffness' must be above 0 N/m, got -1"),
    ("[reaction_wheel]\nbearing = 3\n", "line 3|reaction_wheel.bearing|must be a table, got 3"),
    (NOISE, "broadband|must have a density"),
    (NOISE.replace("1.0", "3.0") + "radial_force = [1.0, 1.0]\n", "line 3|increasing frequencies|[3.0, 2.0]"),
    (NOISE + "radial_force = [1.0]\n", "line 4|radial_force|must hold 2 numbers, one for each frequency, got 1"),
    (STEPPER.replace("200", "201"), "line 5: 'sadm.stepper.full_steps' must be a multiple of 4, got 201"),
    (STEPPER.replace("200", "200.5"), "line 5|full_steps|whole number above 0, got 200.5"),
    (STEPPER.replace("rate = 1e-3", "rate = 0.0"), "line 8: 'sadm.stepper.rate' must not be zero"),
    (STEPPER + "gear_errors = [[100.0]]\n", "gear_errors|list of [cycles, angle]"),
]


@pytest.mark.parametrize(("text", "words"), FILES, ids=lambda value: value.split("\n")[-1])
def test_errors_of_a_parameter_file_name_line_and_key_or_the_body(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'base = "reference"\n{text}')
    with pytest.raises(ValueError) as caught:
        build_telescope(load_telescope(path))
    parts_of(caught.value, words)
    assert "line" not in words or "mine.toml" in str(caught.value)
    with pytest.raises(ValueError, match="cannot read the parameter file"):
        load_telescope(tmp_path / "none.toml")
