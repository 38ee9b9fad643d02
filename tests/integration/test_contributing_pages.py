"""The pages "Add a ..." of docs/extend have the effect they state: each is followed on a copy of the packages."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from support.followed_page import PackageCopy

from pointing_analysis.read.recorded_sensors import sensors_of
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import requirements_of
from titop_plant.telescope.load import load_telescope

FIGURE = """
from los_design.search.worst_case_search import Search
from los_design.synthesis.pair_problem import BOTH, limits
from los_design.synthesis.store import load_designs
from los_design.verification.loop_models import figures_of
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from los_testbed.campaign.member import metric_columns
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

name, telescope = "force, slow", load_telescope()
system, pair = control_loop_plant(telescope), load_designs("implemented")
loop = ImplementedLoop(OpenLoop(system, telescope, telescope.loop_ports.used_by()), *pair, "fsm+pma")
found = {
    "tuned for": limits(telescope, BOTH)[name],
    "searched": name in Search(loop).metrics,
    "proven": figures_of(telescope, "fsm+pma", telescope.loop_ports.used_by())[name].band,
    "columns": metric_columns("model", ()),
}
"""

FIGURE_VALUES = """
from los_design.verification.verification import check_implemented
from los_loop.member_metrics import MemberMetrics

worst = check_implemented(system, telescope, *pair, [{}], changes=False).both.worst
found |= {
    "verified": worst[name].gamma,
    "frequency": worst[name].omega,
    "all forces": worst["force"].gamma,
    "campaign": MemberMetrics.of(telescope, *pair, "fsm+pma").metrics({})["force_slow_gain"],
}
"""


@pytest.fixture
def copy(tmp_path: Path) -> PackageCopy:
    return PackageCopy.of(tmp_path)


def test_a_figure_of_merit_is_tuned_searched_proven_and_a_column(copy: PackageCopy) -> None:
    copy.follow("Add a figure of merit")
    found = copy.values(FIGURE)
    assert found["tuned for"] == 5.0 and found["searched"]
    assert found["proven"][0] == 0.0 and found["proven"][1] == pytest.approx(85.0)
    assert found["columns"].count("force_slow_gain") == 1


@pytest.mark.slow
def test_a_figure_of_merit_has_the_same_value_in_verification_and_campaign(copy: PackageCopy) -> None:
    """Of a row that is added in the process of the test itself: tests/unit/los_loop/test_figures_of_merit.py."""
    copy.follow("Add a figure of merit")
    found = copy.values(FIGURE + FIGURE_VALUES)
    assert found["frequency"] <= 85.0
    authority = load_telescope().pma.authority
    assert 0.0 < 5.0 * found["verified"] <= 1.001 * authority * found["all forces"]
    assert found["campaign"] == pytest.approx(found["verified"], rel=0.02)


def test_a_pointing_requirement_is_judged_in_table_page_and_json(copy: PackageCopy) -> None:
    name, text = "RPE, long exposure", "prob(|RPE(500 ms)| < 2 arcsec) >= 0.997 at 95 % confidence"
    screen, reported = copy.follow("Add a pointing requirement")
    assert "|RPE(500 ms)|" in screen and "|APE|, 99.7 %" in screen
    page = (copy.folder / "bags/mine/report.html").read_text("utf-8")
    table = page[page.index('id="requirements"') : page.index('id="metrics"')]
    assert name in table and "RPE, finest" not in table
    (run,) = json.loads(reported.splitlines()[-1])["runs"]
    (judged,) = run["requirements"]
    assert (judged["name"], judged["text"]) == (name, text)
    (recorded,) = [r for r in requirements_of(Run.open(copy.folder / "bags/mine")) or () if r.name == name]
    assert recorded.loops == ("fsm", "fsm+pma")


@pytest.fixture(scope="module")
def disturbed(tmp_path_factory: pytest.TempPathFactory) -> PackageCopy:
    """A copy after the page on disturbances, which that on scenarios goes on from."""
    made = PackageCopy.of(tmp_path_factory.mktemp("disturbed"))
    made.follow("Add a disturbance")
    return made


def test_a_disturbance_acts_in_a_run(disturbed: PackageCopy) -> None:
    """The signal moves the line of sight; the tones are those of the numbers on the page."""
    moved = Run.open(disturbed.folder / "bags/slosh")["truth/los"].values
    assert np.abs(moved).max() > 1e-10
    found = disturbed.values(
        "import numpy as np\n"
        "from titop_plant.disturbances.wheel_and_drive_tones import cage_tones\n"
        "from titop_plant.telescope.load import load_telescope\n"
        "tones = cage_tones(load_telescope(), np.array([100.0, -200.0, 0.0, 50.0]), np.random.default_rng(1))\n"
        "found = {'frequency': tones.frequency.tolist(), 'size': np.abs(tones.amplitude).sum(axis=0).tolist()}\n"
    )
    speeds = np.array([100.0, 200.0, 0.0, 50.0])
    np.testing.assert_allclose(found["frequency"], 0.37 * speeds)
    np.testing.assert_allclose(found["size"], 0.02 * load_telescope().imbalance.axial_force * speeds**2)


def test_a_scenario_runs_with_its_tones(disturbed: PackageCopy) -> None:
    """During a ramp its tones follow the wheels."""
    disturbed.follow("Add a scenario")
    run = Run.open(disturbed.folder / "bags/cages")
    speeds = np.abs(load_telescope().default_speeds)
    assert run.parameters["scenario"] == "cages"
    np.testing.assert_allclose(run.parameters["tones_rad_s"], np.sort(0.37 * speeds), rtol=1e-8)
    found = disturbed.values(
        "from los_testbed.run.stages import COMPARED\n"
        "from titop_plant.simulation.build import PlantConfig, PlantFamily\n"
        "from titop_plant.interface import DT\n"
        "ramp = dict(ramp_duration=1.0, wheel_acceleration=(1.0, -1.0, 1.0, -1.0))\n"
        "config = PlantConfig(scenario='cages', **ramp)\n"
        "tones = PlantFamily.of(config).nodes(config, DT)[2]\n"
        "at = [tones.at(s).frequency.tolist() for s in (tones.profile.speeds(0.0), tones.profile.speeds(1.0))]\n"
        "found = {'compared': COMPARED, 'tones': at}\n"
    )
    assert "cages" in found["compared"]
    np.testing.assert_allclose(np.abs(found["tones"]), [0.37 * speeds, 0.37 * (speeds + 1.0)], rtol=1e-12)


def test_a_picture_is_on_the_page_of_the_report(tmp_path: Path) -> None:
    copy = PackageCopy.of(tmp_path, pictures=True)
    copy.follow("Add a picture to the report")
    page = (copy.folder / "report.html").read_text("utf-8")
    figures = re.findall(r'<figure id="([\w-]+)">', page)
    assert figures[-1] == "histogram" and len(figures) > 5
    assert "Histogram of the absolute error of 1 runs" in page.split('<figure id="histogram">')[1]


def test_a_controller_structure_is_tuned(copy: PackageCopy) -> None:
    """Exact gradient; the result has the structure, is stable and better than its start."""
    copy.follow("Add a controller structure")
    names = runpy.run_path(str(copy.folder / "lead.py"))
    lead, result, x = names["Lead"](), names["result"], np.array([0.3, -0.2, 1.1])
    G = np.arange(1.0, 5.0).reshape(2, 2)
    steps = 1e-6 * np.eye(3)
    differences = [np.sum(G * (lead.gain_matrix(x + h) - lead.gain_matrix(x - h))) / 2e-6 for h in steps]
    np.testing.assert_allclose(lead.pullback(x, G), differences, rtol=1e-6)
    reached, start = (compliance_peak(np.exp(x)) for x in (result.x, [0.0, 0.0, 2.0]))
    assert reached < 0.5 * start


def compliance_peak(kzp: np.ndarray) -> float:
    """Largest motion of a unit mass by a force, under k (s + z) / (s + p); the loop must be stable."""
    k, z, p = kzp
    assert np.roots([1.0, p, k, k * z]).real.max() < 0.0
    s = 1j * np.geomspace(1e-3, 1e3, 20001)
    return float(np.abs((s + p) / (s**2 * (s + p) + k * (s + z))).max())


def test_an_actuator_of_a_file_is_driven_by_a_class(copy: PackageCopy) -> None:
    """Its commands are those of the law for the recorded sensor, a tick after another; the mass moves."""
    copy.follow("Add an actuator")
    run = Run.open(copy.folder / "bags/damper")
    speed, expected = 0.0, []
    for value in run["sensor/root"].values[:, 0]:
        speed += 1e-3 * (value - speed)
        expected.append(-20.0 * speed)
    force = run["actuator/damper/command"].values[:, 0]
    assert np.abs(force).max() > 0.0
    np.testing.assert_allclose(force, np.array(expected)[-len(force) :], atol=1e-12)


def test_a_sensor_is_in_bag_replay_and_report(copy: PackageCopy) -> None:
    printed = copy.follow("Add a sensor")
    run = Run.open(copy.folder / "bags/guide")
    names = ("sensor/guide", "camera/los", "m1/accel")
    assert {name: len(run[name]) for name in names} == dict(zip(names, (20, 100, 2000)))
    assert (run["sensor/guide"].stamp % 100_000_000 == 0).all()
    (sensor,) = [sensor for sensor in sensors_of(run) if sensor.topic == "sensor/guide"]
    assert (sensor.unit, sensor.rate, sensor.held, sensor.noise) == ("rad", 10.0, True, (3e-8, 3e-8))
    (reported,) = json.loads(printed[-1].splitlines()[-1])["runs"]
    assert sensor.to_mapping() in reported["sensors"] and len(reported["sensors"]) == 6 and not reported["problems"]
    page = (copy.folder / "bags/guide/report.html").read_text("utf-8")
    table = page[page.index('id="sensors"') : page.index('id="provenance"')]
    row = table[table.index("sensor/guide") :].split("</tr>")[0]
    assert re.findall(r'class="n">([^<]*)</td>', row) == ["10", "3e-08", "20", "0"]
    assert json.loads(copy.run("replay bags/guide --json").splitlines()[-1])["identical"]
