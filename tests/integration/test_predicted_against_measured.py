"""The report says what the model of the loop predicts of a bag's tones, or why it predicts nothing."""

import json
import re

import numpy as np
import pytest
import yaml
from los_testbed.bags.writer import BagWriter
from los_testbed.cli import app as cli
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.replay import write_signals
from los_testbed.run.summary.predictions import predictions
from los_testbed.run.summary.ran_loop import RanLoop
from simple_telescope import SimpleTelescope, write_controllers
from support.loop_rows import COMMANDS

from lftkit.systems.sampled.sampled_system import SampledSystem
from pointing_analysis.files.structured_text import load_yaml
from pointing_analysis.read.run import Run
from pointing_analysis.report.model_results import ModelResults
from pointing_analysis.report.report import render

pytestmark = pytest.mark.usefixtures("without_pictures")

LIMIT = 1e-4
"""Of the mirror [rad], small enough to be reached."""

TITLE = "Predicted and measured tones"


def recorded(folder, **settings):
    config = RunConfig(
        **{"mode": "inprocess", "scenario": "design", "duration": 4.0, "output": str(folder), **settings}
    )
    run_in_process(config, folder)
    return folder


@pytest.fixture(scope="module")
def quiet(tmp_path_factory):
    """Stage fsm+pma, scenario design, without sensor noise, from rest; the mirror reaches its limit."""
    return recorded(tmp_path_factory.mktemp("quiet") / "bag", noise=False, start="rest", fsm_authority=LIMIT)


def rewritten(run, target, files=None, **changes):
    """The same record with other attachments or parameters."""
    kept = {**dict(run.attachments), **(files or {})}
    parameters = {**run.parameters, **changes}
    text = {k: v if isinstance(v, str) else json.dumps(v) for k, v in parameters.items() if v is not None}
    attached = {name: ("application/json", data) for name, data in kept.items() if data is not None}
    with BagWriter(target, {"los_testbed": text}, attached) as bag:
        write_signals(bag, {name: (run[name].stamp, run[name].values) for name in run.topics})
    return target


def predicted(bag):
    return predictions([RanLoop.of(Run.open(bag))])


def ratios(page):
    """Last column of the table: figures, or texts where a tone is not clear of noise."""
    part = page[page.index('<section id="predicted"') :].split("</section>", 1)[0]
    rows = re.findall(r"<tr>(<td.*?)</tr>", part, re.DOTALL)
    return [re.findall(r'class="n">([^<]*)</td>', row)[-1] for row in rows]


@pytest.mark.parametrize("loop", ["isolator", "fsm+pma"])
def test_the_report_of_a_quiet_run_has_the_ratio_one(quiet, tmp_path, loop) -> None:
    """Within 2 %, tone by tone, although commands saturate."""
    bag = quiet if loop == "fsm+pma" else recorded(tmp_path / "bag", noise=False, loop=loop)
    assert loop == "isolator" or np.abs(Run.open(bag)["fsm/command"].values).max() == LIMIT
    assert cli.main(["report", str(bag), "--output", str(tmp_path / "r.html")]) == 0
    page = (tmp_path / "r.html").read_text()
    assert TITLE in page
    found = [float(text.split()[0]) for text in ratios(page)]
    assert len(found) >= 2
    assert found == pytest.approx([1.0] * len(found), abs=0.02)


def test_noise_changes_the_ratio_by_what_the_table_says(tmp_path) -> None:
    file = tmp_path / "quiet.toml"  # tones of unit norm are weak beside the paper's accelerometers
    file.write_text("base = 'reference'\n[sensors]\naccelerometer_noise = [2e-4, 2e-4, 2e-4, 4e-4, 4e-4, 4e-4]\n")
    (found,) = predicted(recorded(tmp_path / "bag", duration=6.0, parameters=str(file)))
    strong = [tone for tone in found.tones if not tone.in_noise]
    assert any(tone.uncertainty < 0.02 for tone in strong)
    for tone in strong:
        assert abs(tone.ratio - 1.0) < 2.0 * tone.uncertainty  # four standard deviations


def test_a_bag_with_other_controllers_than_those_that_ran_has_no_prediction(quiet, tmp_path) -> None:
    """Its nodes announced the digest of the observer that they ran, with twice the gain."""
    run, file = Run.open(quiet), tmp_path / "weak.json"
    (tmp_path / "old.json").write_bytes(run.attachments["k_fsm.json"])
    old = SampledSystem.from_file(tmp_path / "old.json")
    SampledSystem(old.A, old.B, 0.5 * old.C, 0.5 * old.D, old.inputs, old.outputs, old.dt, "weak").to_file(file)
    (found,) = predicted(rewritten(run, tmp_path / "bag", {"k_fsm.json": file.read_bytes()}))
    assert not found.tones and re.match("what the node estimator ran has the digest [0-9a-f]{32}, ", found.note)


def test_there_is_no_table_where_there_is_nothing_to_predict(quiet, tmp_path) -> None:
    controllers = write_controllers(tmp_path)
    run_in_process(RunConfig(duration=2.0, mode="inprocess", **controllers), tmp_path / "simple", SimpleTelescope())
    (another,) = predicted(tmp_path / "simple")
    assert another.note == "the node plant announced no digest of what it ran" and not another.tones
    bags = [
        recorded(tmp_path / "still", duration=0.5, disturbance=False),
        recorded(tmp_path / "ramp", duration=0.5, theta_rate=0.01, ramp_duration=0.3),
        rewritten(Run.open(quiet), tmp_path / "replay", mode="replay"),
    ]
    for bag in bags:
        run = Run.open(bag)
        assert predicted(bag) == [None]
        assert TITLE not in render([run], model=ModelResults(predictions=[None]))


class LateCommands:
    """The telescope behind a line on which each command takes one tick more."""

    def __init__(self, config):
        self.plant = RunParts(config).plant()
        self.frame_ticks = self.plant.frame_ticks
        self.under_way = np.zeros(COMMANDS)

    def step(self, command, measurement, truth):
        self.plant.step(self.under_way, measurement, truth)
        self.under_way = command.copy()

    def reset(self):
        self.plant.reset()


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """A record as of an emulated rig, with commands one tick late, at the worst fast tone."""
    folder = tmp_path_factory.mktemp("late")
    config = RunConfig(duration=9.0, mode="inprocess", start="rest", noise=False, worst_of="fast")
    run_in_process(config, folder / "bag", LateCommands(config.emulated()))
    return folder / "bag"


def as_rig(bag, target, delays, name=None):
    """The bag with what a device says of itself in it."""
    run = Run.open(bag)
    parts = RunParts(RunConfig.from_mapping(load_yaml(run.attachments["run.yaml"].decode(), "")).emulated())
    name = name or parts.family.name(parts.physical)
    said = {"device_delay_ticks": delays, "device_emulates": name, "device_clock_drift_ppm": "0"}
    statistics = {**run.parameters["statistics"], "plant": {**run.parameters["statistics"]["plant"], **said}}
    settings = {"device": "rig", "mode": "realtime", "plant": ""}
    plain = {**load_yaml(run.attachments["run.yaml"].decode(), ""), **settings}
    files = {"run.yaml": yaml.safe_dump(plain).encode()}
    return rewritten(run, target, files, statistics=statistics, plant_parameters_hash=None, **settings)


@pytest.mark.further
def test_a_rig_is_predicted_with_its_delays(late, tmp_path) -> None:
    """The response is the mean over the delays; without them it would be 10 % less."""
    ratios = {}
    for name, delays in (("whole", "2:1.0"), ("none", "1:1.0"), ("half", "1:0.5 2:0.5")):
        (found,) = predicted(as_rig(late, tmp_path / name, delays))
        ratios[name] = found.tones[0].ratio
    assert ratios["whole"] == pytest.approx(1.0, abs=0.02)
    assert ratios["none"] == pytest.approx(1.11, abs=0.02)
    assert ratios["half"] == pytest.approx(1.05, abs=0.02)


@pytest.mark.further
@pytest.mark.parametrize(
    ("delays", "name", "words"),
    [
        ("", None, "does not hold the delays"),
        ("2:0.9 7:0.1", None, "10% of the commands came more than 5 ticks"),
        ("5:1.0", None, "not stable"),
        ("2:1.0", "0123456789ab", "another telescope or disturbance"),
    ],
)
def test_a_rig_that_is_not_predicted_has_the_reason_in_its_report(late, tmp_path, delays, name, words) -> None:
    (found,) = predicted(as_rig(late, tmp_path / "bag", delays, name))
    assert not found.tones and words in found.note


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"files": {"k_fsm.json": None}}, ["does not hold the controllers k_fsm.json"]),
        ({"files": {"k_pma.json": b"{}"}}, ["k_pma.json"]),
        ({"files": {"run.yaml": b"durtion: 3.0"}}, ["durtion"]),
        ({"files": {"run.yaml": b"- 1"}}, []),
        ({"files": {"run.yaml": b"scenario: design"}}, ["plant", "digest", "may have changed"]),
        ({"mode": "lockstep"}, ["mode", "not that of its run.yaml"]),
        ({"statistics": {}}, ["the node plant announced no digest"]),
        ({"statistics": None}, ["does not hold what its nodes announced"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_modelled_says_why(quiet, tmp_path, change, words) -> None:
    run = Run.open(rewritten(Run.open(quiet), tmp_path / "bag", **change))
    (found,) = predictions([RanLoop.of(run)])
    page = render([run], model=ModelResults(predictions=[found]))
    assert not found.tones and found.note
    assert "no prediction: " in page
    assert str(tmp_path) not in page
    for word in words:
        assert word in found.note


def test_a_later_part_is_not_compared(quiet, tmp_path) -> None:
    assert cli.main(["report", str(quiet), "--from", "1", "--output", str(tmp_path / "r.html")]) == 0
    page = (tmp_path / "r.html").read_text()
    assert "start with the run" in page and not ratios(page)
    assert cli.main(["report", str(quiet), "--to", "3", "--output", str(tmp_path / "r.html")]) == 0
    found = [float(text.split()[0]) for text in ratios((tmp_path / "r.html").read_text())]
    assert found and found == pytest.approx([1.0] * len(found), abs=0.02)
