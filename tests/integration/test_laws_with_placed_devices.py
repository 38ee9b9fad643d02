"""Sensors and actuators of a telescope's file in runs, bags, replays, campaigns and controllers of the user."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign import adversarial
from los_testbed.campaign.member import MemberEvaluator, metric_columns
from los_testbed.campaign.sampling import MemberParameters, members
from los_testbed.cli import app
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.replay import controller_of, controllers, drive, metrics
from los_testbed.run.summary.loop_curves import loop_curves
from los_testbed.run.summary.ran_loop import RanLoop
from support.command_line import refused

import fsm_pma_controller
import los_estimator
from lftkit import sampled
from lftkit.proofs.sampled_loop import LoopProof, check_loop_proof
from lftkit.proofs.sampled_loop.bounds import member_gains
from lftkit.systems.ports import Port
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_design.synthesis.store import load_designs
from los_design.verification.certify import ProofPart, prove_part
from los_design.verification.loop_models import box_of, figures_of, margins_of, provable_open_loop, telescope_model
from los_loop.implemented_loop import ImplementedLoop, loop_metrics
from los_loop.noise import noise_covariances, noise_rms
from los_loop.nyquist import broken_loops
from los_loop.open_loop import OpenLoop
from pointing_analysis.read.mcap.records import BagError
from pointing_analysis.read.run import Run
from pointing_analysis.replay.replay import compare
from pointing_analysis.requirements.summary import summarise
from titop_plant.interface import COMMANDED, DT, K_FSM_INPUTS, K_FSM_OUTPUTS, K_PMA_INPUTS, K_PMA_OUTPUTS, MEASURED
from titop_plant.simulation.plant_config import parameter_values
from titop_plant.telescope.assembly import build_telescope
from titop_plant.telescope.control_plant import loop_plant, with_sensors
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.telescope import Telescope

TELESCOPE = """
[[sensor]]
name = "on_m1"
place = "M1"
noise = 0.0

[[sensor]]
name = "at_root"
place = "A1"
axes = [[0.0, 0.0, 1.0]]

[[actuator]]
name = "shaker"
place = "A1"
axis = [0.0, 0.0, 1.0]
moving_mass = 0.5

[[actuator]]
name = "idle"
place = "detector"
axis = [1.0, 0.0, 0.0]
"""
LAWS = '''
import numpy as np

class Still:
    def reset(self):
        pass
    def step(self, measurement, out):
        out[:] = 0.0

class Shaking:
    """A chirp on one actuator, above its authority at times."""
    actuators = ("shaker",)
    def reset(self):
        self.tick = 0
    def step(self, accel_Ip, out):
        out[:6], out[6] = 0.0, 40.0 * np.sin(2e-5 * self.tick**2)
        self.tick += 1

class Seeing(Still):
    sensors = ("at_root", "on_m1")
    def step(self, measurement, out):
        out[:] = measurement[22], measurement[25]

class Greedy(Still):
    actuators = ("shaker",)

class Unknown(Still):
    sensors = ("on_m2",)
'''
SINE = """
[[disturbance]]
name = "sine"
kind = "cooler"
place = "shaker"
frequency = 40.0
harmonics = [{ order = 1, force = [0.0, 0.0, 2.0] }]
"""
ON_M1, AT_ROOT, SHAKER = Port("on_m1", 3, "m/s2"), Port("at_root", 1, "m/s2"), Port("shaker", 1, "N")


@pytest.fixture
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RunConfig:
    """A short run of a telescope with further devices, in a folder with laws of the user."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.toml").write_text('base = "reference"\n' + TELESCOPE)
    (tmp_path / "laws_with_devices.py").write_text(LAWS)
    return RunConfig(
        duration=0.4, loop="fsm+pma", scenario="imbalance", disturbance=False, noise=False, start="rest",
        parameters="own.toml",
    )  # fmt: skip


def law_with_devices() -> SampledSystem:
    """The stored K_PMA, which adds a low-passed sensor to its forces and drives an actuator."""
    stored = SampledSystem.from_file(Path(str(fsm_pma_controller.__file__)).parent / "designs" / "k_pma.json")
    n = stored.order
    A = np.block([[stored.A, np.zeros((n, 1))], [np.zeros((1, n)), np.array([[0.9]])]])
    B = np.block([[stored.B, np.zeros((n, 1))], [np.zeros((1, 6)), np.array([[0.1]])]])
    C = np.block([[stored.C, np.full((6, 1), 5.0)], [np.zeros((1, n)), np.array([[-300.0]])]])
    D = np.block([[stored.D, np.zeros((6, 1))], [np.zeros((1, 7))]])
    return SampledSystem(A, B, C, D, (*K_PMA_INPUTS, AT_ROOT), (*K_PMA_OUTPUTS, SHAKER), DT)


@pytest.mark.parametrize(
    ("changed", "still"),
    [
        ({"loop": "isolator"}, "actuators shaker, idle"),
        ({"loop": "fsm", "k_pma": "laws_with_devices:Shaking"}, "actuators shaker, idle"),
        ({"k_pma": "laws_with_devices:Shaking"}, "actuator idle"),
    ],
)
def test_an_actuator_that_nothing_drives_in_the_stage_is_named_before_the_work(
    base: RunConfig, changed: dict[str, str], still: str
) -> None:
    lines = [line for line in RunParts(replace(base, **changed)).check() if "do not use" in line]
    assert len(lines) == 1 and f" and {still} of the telescope's file" in lines[0]


def test_a_bag_has_the_sensors_by_their_names(base: RunConfig, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(
        'base = "reference"\n' + TELESCOPE.replace('place = "A1"\naxes', 'place = "A1"\nrange = 1e-3\naxes') + SINE
    )
    config = replace(base, duration=1.0, loop="fsm", disturbance=True)
    run_in_process(config, tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    own, loop = run["sensor/on_m1"], run["m1/accel"]
    assert own.values.shape == (1000, 3) and np.array_equal(own.stamp, loop.stamp)
    assert own.values == pytest.approx(loop.values[:, :3], abs=1e-12)  # also what the source adds
    assert np.abs(run["sensor/at_root"].values[:, 0]).max() == 1e-3
    assert [topic.unit for topic in RunParts(config).topics if topic.name.startswith("sensor/")] == ["m/s2", "m/s2"]


def test_an_actuator_moves_what_its_command_says(base: RunConfig, tmp_path: Path) -> None:
    """The run against the matrices of the telescope with the force as an input, stepped one by one."""
    config = replace(base, k_fsm="laws_with_devices:Still", k_pma="laws_with_devices:Shaking")
    run_in_process(config, tmp_path / "bag")
    run, telescope = Run.open(tmp_path / "bag"), load_telescope("own.toml")
    force = run["actuator/shaker/command"].values[:, 0]
    assert np.abs(force).max() == 31.6  # the law is limited, as the plant is
    assert not run["pma/command"].values.any()

    whole = with_sensors(build_telescope(telescope, motors=True).system, telescope)
    outputs = [*MEASURED, "los_controlled", "on_m1", "at_root"]
    chosen = whole.select(inputs=[*COMMANDED, "shaker"], outputs=outputs)
    plant = sampled(chosen.at(parameter_values(RunParts(config).settings, telescope)), DT, method="hold")
    x, found = np.zeros(len(plant.A)), []
    applied = np.r_[0.0, force[:-1]]  # of tick k - 1
    for u in applied:
        found.append(plant.C @ x + plant.D[:, 8] * u)  # the first of the file's actuators
        x = plant.A @ x + plant.B[:, 8] * u
    expected = np.array(found)
    for name, columns in (("truth/los", slice(22, 24)), ("sensor/on_m1", slice(24, 27)), ("sensor/at_root", [27])):
        size = np.abs(expected[:, columns]).max()
        values = run[name].values[:, : expected[:, columns].shape[1]]  # a vector has three values
        assert size > 0.0
        np.testing.assert_allclose(values, expected[:, columns], atol=1e-9 * size)


def test_an_observer_sees_the_sensors_that_it_names_in_its_order(base: RunConfig, tmp_path: Path) -> None:
    config = replace(base, k_fsm="laws_with_devices:Seeing", k_pma="laws_with_devices:Shaking")
    run_in_process(config, tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    seen = np.c_[run["sensor/at_root"].values[:, 0], run["sensor/on_m1"].values[:, 2]]
    assert seen.any() and np.array_equal(run["los_estimate"].values[:, :2], seen)


def test_a_file_with_these_ports_closes_the_loop(base: RunConfig, tmp_path: Path) -> None:
    """A file gives the bits of its own steps; a sensor that it leaves out, and one that it weighs by zero, nothing."""
    law = law_with_devices()
    law.to_file(tmp_path / "k_pma.json")
    D = np.c_[np.zeros((2, 18)), 0.02 * np.eye(2), np.zeros((2, 2)), np.zeros((2, 3))]
    observer = SampledSystem([], [], [], D, (*K_FSM_INPUTS, ON_M1), K_FSM_OUTPUTS, DT)
    observer.to_file(tmp_path / "k_fsm.json")
    replace(observer, D=D[:, :22], inputs=K_FSM_INPUTS).to_file(tmp_path / "plain.json")
    config = replace(base, k_fsm="k_fsm.json", k_pma="k_pma.json", noise=True, disturbance=True)
    parts = RunParts(config)
    used = parts.used["k_pma"]
    assert not parts.code
    assert [port.name for port in (*used.measured, *used.commanded)] == ["accel_Ip", "at_root", "pma_force", "shaker"]
    bags = {name: tmp_path / name for name in ("k_fsm", "plain")}
    for name, bag in bags.items():
        run_in_process(replace(config, k_fsm=f"{name}.json"), bag)
    run, other = (Run.open(bag) for bag in bags.values())
    sensed, out = np.c_[run["isolator/accel"].values, run["sensor/at_root"].values[:, 0]], np.zeros(7)
    commands = np.c_[run["pma/command"].values, run["actuator/shaker/command"].values[:, 0]]
    for given, command in zip(sensed, commands):
        law.step(given, out)
        assert np.array_equal(np.clip(out, -31.6, 31.6), command)
    assert commands[:, 6].any()
    assert np.array_equal(run["truth/los"].values, other["truth/los"].values)


def observer_with_devices() -> SampledSystem:
    """The stored K_FSM, which adds a little of a sensor to its states and its estimate."""
    stored = SampledSystem.from_file(Path(str(los_estimator.__file__)).parent / "designs" / "k_fsm.json")
    B, D = (np.c_[matrix, np.full((len(matrix), 3), 1e-7)] for matrix in (stored.B, stored.D))
    return replace(stored, B=B, D=D, inputs=(*stored.inputs, ON_M1))


@pytest.mark.parametrize(("seeing", "start"), [(False, "rest"), (True, "steady")])
def test_the_model_of_the_loop_has_them(base: RunConfig, tmp_path: Path, seeing: bool, start: str) -> None:
    """Line of sight of a run, tick by tick, against the sampled loop of the controllers in its bag."""
    law = law_with_devices()
    law.to_file(tmp_path / "k_pma.json")
    observer_with_devices().to_file(tmp_path / "k_fsm.json")
    own = "k_fsm.json" if seeing else None
    config = replace(base, k_pma="k_pma.json", disturbance=True, k_fsm=own, start=start)
    run_in_process(config, tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    recorded = {name: controller_of(run, name)[0] for name in ("k_fsm", "k_pma")}
    parts = RunParts(config, recorded)
    assert (parts.start.states is None) == (start == "rest") and not parts.start.note
    los = run["truth/los"].values[:, :2]
    expected = parts.tone_model().record(len(los))
    assert np.abs(run["actuator/shaker/command"].values).max() > 1e-3
    np.testing.assert_allclose(los, expected, rtol=0.0, atol=1e-9 * np.abs(los).max())
    without = RunParts(replace(config, k_fsm=None, k_pma=None)).tone_model().record(len(los))
    assert np.abs(los - without).max() > 1e-4 * np.abs(los).max()


TWINS = """
[[sensor]]
name = "twin_accel"
place = "platform"

[[sensor]]
name = "twin_spin"
place = "platform"
kind = "angular_accelerometer"

[[actuator]]
name = "twin"
place = "platform"
axis = [0.0, 0.0, -1.0]
position = [0.41569219381653056, 0.24, 0.0]
"""
"""Sensors beside those of the platform, and an actuator where its first one is: 0.48 m at 30 deg, mass along +z."""


def twin_pair(telescope: Telescope) -> tuple[SampledSystem, SampledSystem]:
    """The stored pair, behind the twin sensors, the force of the first actuator through its twin."""
    k_fsm, k_pma = load_designs("implemented")
    accel, spin = (sensor.port for sensor in telescope.placed_sensors)
    C, D = (np.vstack([0.0 * matrix[:1], matrix[1:], matrix[:1]]) for matrix in (k_pma.C, k_pma.D))
    inputs, outputs = (*K_PMA_INPUTS, accel, spin), (*K_PMA_OUTPUTS, Port("twin", 1, "N"))
    B, D = (np.hstack([0.0 * matrix, matrix]) for matrix in (k_pma.B, D))
    twin = replace(k_pma, B=B, C=C, D=D, inputs=inputs, outputs=outputs)
    whole = k_fsm.with_inputs(K_FSM_INPUTS)
    B, D = (np.hstack([0.0 * matrix[:, :6], matrix[:, 6:], matrix[:, :6]]) for matrix in (whole.B, whole.D))
    return replace(whole, B=B, D=D, inputs=(*K_FSM_INPUTS, accel, spin)), twin  # the noise is that of one sensor


@pytest.mark.further
def test_devices_at_the_place_of_the_standard_ones_give_their_figures(base: RunConfig, tmp_path: Path) -> None:
    """Both behind the twin sensors, K_PMA with the twin actuator, against the same with the standard ones: to 1e-9."""
    (tmp_path / "twins.toml").write_text('base = "reference"\n' + TWINS)
    telescope = load_telescope(tmp_path / "twins.toml")
    (k_fsm, k_pma), (observer, twin) = load_designs("implemented"), twin_pair(telescope)
    ports, rng = telescope.loop_ports.used_by(observer, twin), np.random.default_rng(1)
    plain = telescope.loop_ports.used_by(k_fsm, k_pma)
    assert ports.scale.tolist() == [1.0] * 9 and plain.commands == 8
    standard = ImplementedLoop(
        OpenLoop(loop_plant(telescope, plain), telescope, telescope.loop_ports.used_by()), k_fsm, k_pma, "fsm+pma"
    )
    open_loop = OpenLoop(loop_plant(telescope, ports), telescope, ports)
    other = ImplementedLoop(open_loop, observer, twin, "fsm+pma")
    known, own = (loop_metrics(telescope, "fsm+pma", one) for one in (plain, ports))
    points = rng.uniform(size=(4, len(open_loop.names)))
    for omega in (0.3, 90.0, 399.5, 900.0):
        one, two = standard.at(omega), other.at(omega)
        for name in ("APE", "slow", "fast", "mirror", "force", "sensitivity, mirror"):
            expected = standard.gains(one, known[name], points)
            np.testing.assert_allclose(other.gains(two, own[name], points), expected, rtol=1e-9)
    for values in ({}, open_loop.values(points[0])):
        radii = [loop.sampled_at(values)[1].spectral_radius() for loop in (standard, other)]
        assert radii[0] == pytest.approx(radii[1], abs=1e-11)
    noise = [
        noise_rms(noise_covariances(loop.system.at({}), *loop.pair, telescope, loop="fsm+pma"))
        for loop in (standard, other)
    ]
    np.testing.assert_allclose(noise[1], noise[0], rtol=1e-6)  # covariances with modes of minutes have 7 digits


def test_such_a_run_is_replayed_bit_by_bit(base: RunConfig, tmp_path: Path) -> None:
    """Also from the bag that a replay has written; other controllers are told what the bag does not hold."""
    law_with_devices().to_file(tmp_path / "k_pma.json")
    observer_with_devices().to_file(tmp_path / "k_fsm.json")
    run_in_process(
        replace(base, k_fsm="k_fsm.json", k_pma="k_pma.json", noise=True, disturbance=True, duration=1.5), Path("bag")
    )
    assert not app.main(["--quiet", "replay", "bag", "--output", "again"])
    assert Run.open(Path("again")).attachments["k_pma.json"] == Path("k_pma.json").read_bytes()
    assert not app.main(["--quiet", "replay", "again"])
    run, other = Run.open(Path("bag")), Run.open(Path("again"))
    for name in ("sensor/at_root", "sensor/on_m1", "actuator/shaker/command"):
        assert np.array_equal(run[name].values, other[name].values) and run[name].values.any()
    law = law_with_devices()
    order = np.r_[6, :6]  # the same law with its sensor first, in another file
    replace(law, B=law.B[:, order], D=law.D[:, order], inputs=(AT_ROOT, *K_PMA_INPUTS)).to_file(tmp_path / "same.json")
    chosen = controllers(run, k_pma=Path("same.json"))
    assert not chosen.warnings or "starts at rest" not in chosen.warnings[-1]
    assert not chosen.as_recorded and compare(run, drive(run, chosen, lambda done, total: None)).identical
    found = metrics(run, drive(run, chosen, lambda done, total: None))
    forces = [np.abs(run[name].values).max() for name in ("pma/command", "actuator/shaker/command")]
    assert found["recorded"]["pma_peak_n"] == found["replayed"]["pma_peak_n"] == max(forces)
    for port, message in ((Port("idle", 1, "N"), "got idle"), (Port("shaker", 1, "N"), "topic sensor/elsewhere")):
        unlike = replace(law, inputs=(*K_PMA_INPUTS, Port("elsewhere", 1)), outputs=(*K_PMA_OUTPUTS, port))
        unlike.to_file(tmp_path / "other.json")
        with pytest.raises(BagError, match=message):
            drive(run, controllers(run, k_pma=Path("other.json")), lambda done, total: None)


def test_a_replay_has_the_bits_of_laws_with_ports_in_another_order(base: RunConfig, tmp_path: Path) -> None:
    """Sums are taken in the order of the telescope's file, and so are they in a replay; of a class in its own."""
    law = observer_with_devices()
    B, D = (np.c_[np.full((len(matrix), 1), 3e-7), matrix] for matrix in (law.B, law.D))
    replace(law, B=B, D=D, inputs=(AT_ROOT, *law.inputs)).to_file(tmp_path / "k_fsm.json")
    law_with_devices().to_file(tmp_path / "k_pma.json")
    files = replace(base, k_fsm="k_fsm.json", k_pma="k_pma.json", noise=True, disturbance=True, duration=1.5)
    classes = {"k_fsm": "laws_with_devices:Seeing", "k_pma": "laws_with_devices:Shaking"}
    run_in_process(files, Path("files"))
    run_in_process(replace(base, duration=1.5, **classes), Path("classes"))
    assert not app.main(["--quiet", "replay", "files"])
    assert not app.main(["--quiet", "replay", "classes", *(f"--{k.replace('_', '-')}={v}" for k, v in classes.items())])


@pytest.mark.parametrize(
    "limits", [5, ["shaker"], {"shaker": -1.0}, {"shaker": "large"}, {"shaker": math.nan}], ids=repr
)
def test_limits_of_a_bag_that_are_none_are_refused(limits: Any) -> None:
    """As of a bag that somebody has altered."""
    run = Run.open(Path(__file__).parents[2] / "bags" / "reference")
    with pytest.raises(BagError, match="actuator_authority must be positive limits by the names of actuators, got"):
        controllers(run.changed({**run.parameters, "actuator_authority": limits}, run.attachments))


def test_forces_that_move_nothing_are_named(base: RunConfig, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(f"base = 'reference'\n{TELESCOPE}\n[pma]\nazimuths_deg = []\n")
    assert "pma_force moves nothing: the telescope has no proof masses" in RunParts(base).idle_devices
    law_with_devices().to_file(tmp_path / "k_pma.json")
    assert "moves nothing" not in RunParts(replace(base, k_pma="k_pma.json")).idle_devices


@pytest.mark.parametrize("depth", ["time", pytest.param("model", marks=pytest.mark.further)])
def test_a_campaign_gives_such_a_pair_the_figures_of_the_standard_one(
    base: RunConfig, tmp_path: Path, depth: str
) -> None:
    """Without noise in time, where each sensor has its own sequence; a row is that of its run."""
    (tmp_path / "twins.toml").write_text('base = "reference"\n' + TWINS)
    base = replace(base, parameters="twins.toml", duration=1.1, scenario="imbalance", disturbance=True)
    for name, law in zip(("k_fsm", "k_pma"), twin_pair(load_telescope("twins.toml"))):
        law.to_file(tmp_path / f"{name}.json")
    own = replace(base, k_fsm="k_fsm.json", k_pma="k_pma.json")
    parameters = MemberParameters.of("twins.toml")
    member = dict(zip(parameters.columns, map(float, members("uniform", 1, 4, "twins.toml")[0]))) | {"seed": 7}
    rows = [MemberEvaluator.of(one).row(0, member, depth) for one in (base, own)]
    names = [name for name in metric_columns(depth, RunParts(base).telescope.requirements) if rows[0][name]]
    figures = [name for name in names if name != "sensitivity_forces"]  # of seven actuators, not of six
    found, expected = ([row[name] for name in figures] for row in (rows[1], rows[0]))
    assert rows[1]["status"] == "ok" and len(figures) > 6
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    if depth == "time":
        noisy = replace(own, noise=True)
        run_in_process(replace(noisy, **parameters.settings(member)), tmp_path / "bag")
        summary = summarise(Run.open(tmp_path / "bag"))
        row = MemberEvaluator.of(noisy).row(0, member, "time")
        assert (row["rpe_rms_mas"], row["ape_max_arcsec"]) == (summary.rpe_rms, summary.ape_max)


@pytest.mark.parametrize(
    ("setting", "name", "message"),
    [
        (
            "k_fsm",
            "Unknown",
            "distinct names of the telescope's file (accel_Ip, .*, on_m1, at_root), got ('on_m2',)",
        ),
        ("k_fsm", "Greedy", "an observer must command no actuator (k_pma does), got shaker"),
    ],
)
def test_other_devices_are_refused(
    base: RunConfig, capsys: pytest.CaptureFixture[str], setting: str, name: str, message: str
) -> None:
    line = ["run", "--mode", "inprocess", "--parameters", "own.toml", f"--{setting.replace('_', '-')}"]
    found = refused(capsys, *line, f"laws_with_devices:{name}", "--output", "bag")
    assert all(part in found for part in message.split(".*"))
    assert not Path("bag").exists()


def test_an_actuator_has_one_driver(base: RunConfig, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text('base = "reference"\n' + TELESCOPE + SINE)
    config = replace(base, k_pma="laws_with_devices:Shaking", disturbance=True)
    with pytest.raises(ValueError, match="actuator shaker must have one driver, got source sine and k_pma"):
        RunParts(config).check()
    (source,) = RunParts(config).sources
    assert source.limit == 31.6
    (tmp_path / "own.toml").write_text('base = "reference"\n' + TELESCOPE + SINE + SINE.replace('"sine"', '"other"'))
    with pytest.raises(ValueError, match="actuator shaker must have one source, got 2"):
        _ = RunParts(config).sources


def test_the_models_of_proofs_have_the_gains_of_such_a_loop(base: RunConfig, tmp_path: Path) -> None:
    """Figures and sensitivities, at random members; a part of the band is proven and checked."""
    (tmp_path / "twins.toml").write_text('base = "reference"\n' + TWINS)
    telescope, rng = load_telescope(tmp_path / "twins.toml"), np.random.default_rng(7)
    pair = twin_pair(telescope)
    open_loop = provable_open_loop(telescope, *pair)
    loop = ImplementedLoop(open_loop, *pair, "fsm+pma")
    points = rng.uniform(size=(4, len(open_loop.names)))
    deviations = open_loop.low + points * open_loop.width - open_loop.nominal
    deviations[:, -1] = 4.0 * np.arctan(deviations[:, -1])
    metrics = figures_of(telescope, "fsm+pma", loop.ports) | margins_of(telescope, "fsm+pma", loop.ports)
    for name in ("fast", "force", "sensitivity, mirror", "sensitivity, forces"):
        model = telescope_model(loop, metrics[name])
        for omega in (0.7, 31.0, 333.0):
            expected = loop.gains(loop.at(omega), metrics[name], points)
            np.testing.assert_allclose(member_gains(model, omega, deviations), expected, rtol=1e-5)
    model, box, band = telescope_model(loop, metrics["fast"]), box_of(loop), (200.0, 200.5)
    part = prove_part(ProofPart(model, box, band, 1.0, math.inf, tmp_path / "part.npz"))
    assert part.finished and not part.uncovered
    proof = LoopProof(model, tuple(p.name for p in loop.system.parameters), box, band, 1.0, part.strips)
    assert check_loop_proof(proof, stability=False).windows > 0


def test_sensors_that_no_proof_takes_are_refused_before_the_design(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "slow.toml"
    file.write_text('base = "reference"\n[[sensor]]\nname = "slow"\nkind = "rate_gyro"\nrate = 10.0\n')
    line = refused(capsys, "design", "all", "--certify", "--parameters", file, "--output", tmp_path / "mine")
    assert "the rate of the camera, 50 Hz, got slow" in line and not (tmp_path / "mine").exists()


def test_the_curves_of_such_a_pair_are_those_of_the_standard_one(base: RunConfig, tmp_path: Path) -> None:
    """At the mirror; at the forces there are six actuators in the one and seven in the other."""
    (tmp_path / "twins.toml").write_text('base = "reference"\n' + TWINS)
    base = replace(base, parameters="twins.toml")
    for name, law in zip(("k_fsm", "k_pma"), twin_pair(load_telescope("twins.toml"))):
        law.to_file(tmp_path / f"{name}.json")
    own = replace(base, k_fsm="k_fsm.json", k_pma="k_pma.json")
    curves = []
    for parts in (RunParts(base), RunParts(own)):
        loop = parts.implemented_loop(parameter_values(parts.settings, parts.telescope))
        curves.append({found.place: found for found in broken_loops(loop, loop.point({}))})
    standard, twin = (found["mirror"] for found in curves)
    np.testing.assert_allclose(twin.omega, standard.omega, rtol=1e-9)
    np.testing.assert_allclose(twin.sensitivity, standard.sensitivity, rtol=1e-6)
    np.testing.assert_allclose(twin.loci, standard.loci, rtol=1e-6, atol=1e-6)
    assert curves[1].keys() == {"mirror", "forces"}


def test_members_for_such_a_pair_are_found_by_a_search(
    base: RunConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(adversarial, "MOST_ASCENTS", 1)
    monkeypatch.setattr(adversarial, "METRICS", ("slow",))
    observer_with_devices().to_file(tmp_path / "k_fsm.json")
    found = adversarial.adversarial_members(replace(base, k_fsm="k_fsm.json"), 1, 0)
    low, high = MemberParameters.of("own.toml").limits.T
    assert found.shape == (1, low.size) and np.all((low <= found) & (found <= high))
    uniform = members("uniform", 1, 0, "own.toml")
    assert not np.array_equal(found, uniform), "the worst point of the search comes first"


def test_the_report_of_a_run_with_a_sensor_of_the_user_has_its_curves(base: RunConfig, tmp_path: Path) -> None:
    observer_with_devices().to_file(tmp_path / "k_fsm.json")
    run_in_process(replace(base, k_fsm="k_fsm.json", loop="fsm"), tmp_path / "bag")
    loop = RanLoop.of(Run.open(tmp_path / "bag"))
    curves, reason = loop_curves(loop)
    assert not reason and [found.place for found in curves] == ["mirror"]
