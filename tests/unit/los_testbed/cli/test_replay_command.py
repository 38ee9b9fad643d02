"""``los-testbed replay``: bit identity is proved or refuted, others are compared, mistakes are one line."""

import json
import re
import shutil

import numpy as np
import pytest
from command_line import CommandLine
from los_testbed.bags.writer import BagWriter
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.replay import write_signals
from scipy.io import savemat
from simple_telescope import SimpleTelescope, write_controllers
from support.forged_bags import cut_short, with_metadata

from lftkit.systems.mat_files import write_mat
from lftkit.systems.sampled.sampled_system import SampledSystem
from lftkit.systems.system import System
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise
from pointing_analysis.requirements.verdict import judge, parse
from titop_plant.interface import DT, K_FSM_INPUTS, K_FSM_OUTPUTS

pytestmark = pytest.mark.usefixtures("without_pictures")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    config = RunConfig(duration=4.0, mode="inprocess", **write_controllers(folder))
    run_in_process(config, folder / "bag", SimpleTelescope(dropout=0.2))
    return folder / "bag"


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    return CommandLine.below(tmp_path, monkeypatch, capsys, "replay")


def other_observer(path, pole=0.9):
    """Quicker than the one that flew."""
    D, B = np.zeros((2, 22)), np.zeros((2, 22))
    B[:, 18:20], B[:, 20:22] = 0.1 * np.eye(2), -0.01 * np.eye(2)
    SampledSystem(pole * np.eye(2), B, np.eye(2), D, K_FSM_INPUTS, K_FSM_OUTPUTS, DT, "quick").to_file(path)
    return path


def changed(recorded, path, places, change):
    """A bag like the recorded one, with other values at these places."""
    run = Run.open(recorded)
    signals = {name: (run[name].stamp, run[name].values.copy()) for name in run.topics}
    for name, place in places.items():
        signals[name][1][place] = change(signals[name][1][place])
    given = {k: v if isinstance(v, str) else json.dumps(v) for k, v in run.parameters.items() if k != "statistics"}
    files = {name: ("application/json", data) for name, data in run.attachments.items()}
    with BagWriter(path, {"los_testbed": given}, files) as bag:
        write_signals(bag, signals)


def test_a_replay_of_a_recording_that_is_not_judged_is_not_either(call, recorded, tmp_path) -> None:
    """Its commands are others, so that its signals do not tell that the mirror ignored the recorded ones."""
    changed(recorded, tmp_path / "faulty", {"fsm/strain_gauge": slice(1000, None)}, lambda angles: 0.0 * angles)
    with_metadata(tmp_path / "faulty", device="my:Rig", mode="realtime")
    call(tmp_path / "faulty", "--output", tmp_path / "replayed")
    (verdict, *_) = summarise(Run.open(tmp_path / "replayed")).verdicts
    assert verdict.status == "not judged" and verdict.note.startswith("the mirror did not follow its command from 1.")


def test_a_replay_of_a_recording_without_its_end_is_not_judged(call, recorded, tmp_path) -> None:
    """It has the samples that are there as all of them."""
    part = cut_short(recorded, tmp_path / "part", 2.0)
    code, _, err = call(part, "--output", tmp_path / "again")
    assert code == 0, err
    again = Run.open(tmp_path / "again")
    limit = parse("prob(|APE| < 1000 arcsec) >= 0.5 at 60 % confidence")
    verdict = judge(limit, [again], 0.0)
    assert verdict.status == "not judged" and "lacks samples before its first or after its last" in verdict.note


def test_as_recorded_is_identical_and_says_so(call, recorded) -> None:
    code, out, _ = call(recorded, "--json")
    assert code == 0
    found = json.loads(out.splitlines()[-1])
    assert found["as_recorded"] and found["identical"] and found["complete"]
    assert {d["compared"] for d in found["differences"]} == {4000}
    code, out, _ = call(recorded)
    assert "bit-identical to the recording on 4000 ticks" in out and out.endswith("\nthe bag is complete\n")


def without_statistics(recorded, path):
    changed(recorded, path, {}, None)
    return path


def without_a_sample(recorded, path):
    """Of the line of sight, which no controller reads."""
    run = Run.open(recorded)
    signals = {name: (run[name].stamp, run[name].values) for name in run.topics}
    stamps, values = signals["truth/los"]
    signals["truth/los"] = np.delete(stamps, 1500), np.delete(values, 1500, axis=0)
    given = {k: v if isinstance(v, str) else json.dumps(v) for k, v in run.parameters.items()}
    files = {name: ("application/json", data) for name, data in run.attachments.items()}
    with BagWriter(path, {"los_testbed": given}, files) as bag:
        write_signals(bag, signals)
    return path


def of_another_plan(recorded, path):
    shutil.copytree(recorded, path)
    with_metadata(path, statistics=json.dumps({"plant": {"ticks": "3000", "planned_ticks": "4000"}}))
    return path


@pytest.mark.parametrize(
    ("lose", "words"),
    [
        (
            lambda bag, path: cut_short(bag, path, 2.0),
            "ended by its plan, after 4000 ticks, but the messages cover 2000",
        ),
        (without_statistics, "whole, and does not say what was planned"),
        (without_a_sample, "1 sample of truth/los missing"),
        (of_another_plan, "the run ended early: after 3000 of 4000 ticks"),
    ],
)
def test_an_identical_replay_of_a_part_is_not_of_a_complete_bag(call, recorded, tmp_path, lose, words) -> None:
    """Sensors and commands of the part agree: nothing in them says what is gone."""
    bag = lose(recorded, tmp_path / "part")
    code, out, _ = call(bag)
    assert code == 0 and "bit-identical" in out and "the bag is complete" not in out
    assert "the bag is not shown to be complete: " in out and words in " ".join(out.split())
    assert json.loads(call(bag, "--json")[1].splitlines()[-1])["complete"] is False


def test_one_bit_is_found(call, recorded, tmp_path) -> None:
    places = {"m1/accel": (1500, 2), "fsm/command": (3000, 0)}
    changed(recorded, tmp_path / "bag", places, lambda value: np.nextafter(value, 1.0))
    code, out, _ = call(tmp_path / "bag", "--json")
    assert code == 1
    found = {d["topic"]: d for d in json.loads(out.splitlines()[-1])["differences"]}
    assert found["fsm/command"]["different"] == 1
    assert found["fsm/command"]["first"] == pytest.approx(3.0)
    assert found["los_estimate"]["different"] == 0  # this observer does not look at M1


def test_another_stage_with_the_recorded_controllers_is_named(call, recorded, tmp_path) -> None:
    code, out, _ = call(recorded, "--loop=fsm")
    assert code == 0 and "controllers as recorded, with loop fsm instead of fsm+pma" in " ".join(out.split())
    assert "other controllers" in call(recorded, "--k-fsm", other_observer(tmp_path / "quick.json"))[1]


CODE = """
import numpy as np
class {name}:
    def reset(self):
        self.held = np.zeros(6)
    def step(self, accel_Ip, out):
        self.held += 0.1 * (accel_Ip - self.held)
        out[:] = {gain} * self.held
"""


@pytest.mark.parametrize("start", ["steady", "rest"])
def test_code_as_recorded_is_known_by_its_source(call, tmp_path, monkeypatch, start) -> None:
    """Its controllers start at rest and are switched on: the replay of the same code begins as the run did."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "law_of_run.py").write_text(CODE.format(name="Law", gain=0.5) + CODE.format(name="Other", gain=0.4))
    files = {"k_fsm": write_controllers(tmp_path)["k_fsm"], "k_pma": "law_of_run:Law"}
    config = RunConfig(duration=2.0, mode="inprocess", start=start, **files)
    run_in_process(config, tmp_path / "bag", SimpleTelescope())
    code, out, err = call(tmp_path / "bag", "--k-pma", "law_of_run:Law")
    assert code == 0, err
    assert "controllers as recorded: replay bit-identical" in out and "the bag is complete" in out
    assert "steady state" not in err
    code, out, _ = call(tmp_path / "bag", "--k-pma", "law_of_run:Other")
    assert code == 0 and "other controllers: " in out and "bit-identical" not in out
    assert "ticks differ" in out and "missing" not in out, "the replay has each tick of the bag"


def test_another_observer_gives_a_bag_and_a_comparison(call, recorded, tmp_path) -> None:
    new = other_observer(tmp_path / "quick.json")
    code, out, _ = call(recorded, "--k-fsm", new, "--output", "replayed", "--json")
    assert code == 0
    found = json.loads(out.splitlines()[-1])
    assert not found["as_recorded"] and not found["identical"]
    assert found["replayed"]["ake_rms_arcsec"] < 0.5 * found["recorded"]["ake_rms_arcsec"]
    run, old = Run.open(call.here / "replayed"), Run.open(recorded)
    assert not run.problems
    for name in ("truth/los", "camera/los", "isolator/accel", "fsm/strain_gauge"):
        assert run[name].values.tobytes() == old[name].values.tobytes()
    assert run.attachments["k_fsm.json"] == new.read_bytes()
    assert run.attachments["k_pma.json"] == old.attachments["k_pma.json"]
    assert run.parameters["mode"] == "replay" and run.parameters["replay_of"] == "bag"
    assert run.parameters["seed"] == old.parameters["seed"]
    again, out, _ = call("replayed", "--json")  # the new bag is complete too
    assert again == 0 and json.loads(out.splitlines()[-1])["identical"]
    code, out, _ = call("replayed")
    assert "identical" in out


FORMS = """
import control
import numpy as np
from lftkit.systems.sampled.sampled_system import SampledSystem

law = SampledSystem.from_file("quick.json")
names = [[f"{port.name}[{k}]" for port in side for k in range(port.size)] for side in (law.inputs, law.outputs)]
system = control.ss(law.A, law.B, law.C, law.D, law.dt, inputs=names[0], outputs=names[1])


class Observer:
    def reset(self):
        self.x, self.seen = np.zeros(law.order), np.zeros(22)

    def step(self, measurement, out):
        self.seen = np.where(np.isnan(measurement), self.seen, measurement)  # the last frame is held
        out[:] = law.C @ self.x + law.D @ self.seen
        self.x = law.A @ self.x + law.B @ self.seen
"""


def test_every_form_of_a_controller_that_a_run_takes_is_replayed(call, tmp_path, monkeypatch) -> None:
    """The same matrices as JSON, .mat, python-control and a class, from rest and without lost frames: one answer."""
    config = RunConfig(duration=1.5, mode="inprocess", start="rest", **write_controllers(tmp_path))
    run_in_process(config, tmp_path / "plain", SimpleTelescope())
    law = SampledSystem.from_file(other_observer(call.here / "quick.json"))
    K = System(law.A, law.B, law.C, law.D, law.inputs, law.outputs, "K", law.dt)
    write_mat(call.here / "quick.mat", K=K)
    (call.here / "forms_of_a_law.py").write_text(FORMS, "utf-8")
    monkeypatch.syspath_prepend(str(call.here))
    found = []
    for form in ("quick.json", "quick.mat", "forms_of_a_law:system", "forms_of_a_law:Observer"):
        code, out, err = call(tmp_path / "plain", "--k-fsm", form, "--json")
        assert code == 0, err
        found.append(json.loads(out.splitlines()[-1]))
    assert not any(one["as_recorded"] for one in found)
    for other in found[1:]:
        assert other["replayed"] == pytest.approx(found[0]["replayed"], rel=1e-9)


def test_matrices_without_names_are_replayed_in_order(call, tmp_path) -> None:
    """The bag of a run with --ports-in-order replays itself; on other bags the option is given, too."""
    files = write_controllers(tmp_path)
    law = SampledSystem.from_file(other_observer(call.here / "quick.json"))
    savemat(call.here / "quick.mat", {**{name: getattr(law, name) for name in "ABCD"}, "Ts": law.dt})
    flown = {**files, "k_fsm": str(call.here / "quick.mat"), "ports_in_order": True}
    for name, setting in (("plain", files), ("flown", flown)):
        run_in_process(
            RunConfig(duration=0.1, mode="inprocess", start="rest", **setting), call.here / name, SimpleTelescope()
        )
    for command, own in (("flown", True), ("plain --k-fsm quick.mat --ports-in-order", False)):
        code, out, err = call(*command.split(), "--json", "--transient", "0")
        assert code == 0, err
        assert json.loads(out.splitlines()[-1])["as_recorded"] == own
    code, _, err = call("plain", "--k-fsm", "quick.mat")
    assert code == 2 and "(--ports-in-order), got 22 without names" in err


def test_a_replay_says_where_its_controllers_start(call, tmp_path) -> None:
    """The recorded observer in another file starts as it did, another one at rest; so does a replay of its own bag."""
    run_in_process(RunConfig(duration=1.5, mode="inprocess"), tmp_path / "steady")
    stored = json.loads(Run.open(tmp_path / "steady").attachments["k_fsm.json"])
    (tmp_path / "same.json").write_text(json.dumps(stored))
    (tmp_path / "weaker.json").write_text(json.dumps({**stored, "C": [[0.9 * c for c in row] for row in stored["C"]]}))
    code, out, err = call(tmp_path / "steady", "--k-fsm", tmp_path / "same.json", "--json")
    assert code == 0 and json.loads(out.splitlines()[-1])["identical"] and "at rest" not in err
    code, out, err = call(tmp_path / "steady", "--k-fsm", tmp_path / "weaker.json", "--output", "other", "--json")
    assert code == 0 and "k_fsm of the replay at rest" in err
    for options in ((), ("--loop", "isolator")):  # the second one starts K_PMA anew, which does not act
        code, out, err = call("other", *options, "--output", f"again{len(options)}", "--json")
        assert code == 0 and json.loads(out.splitlines()[-1])["identical"] is not bool(options)
        code, out, _ = call(f"again{len(options)}", "--json")
        assert code == 0 and json.loads(out.splitlines()[-1])["identical"]


def test_a_controller_that_diverges_is_said_with_tick_and_port(call, recorded, tmp_path) -> None:
    content = json.loads(Run.open(recorded).attachments["k_pma.json"])
    inputs, outputs = len(content["D"][0]), len(content["D"])  # two equal states: their difference is zero, then NaN
    wild = {**content, "A": [[3.0, 0.0], [0.0, 3.0]], "B": [[1.0] * inputs] * 2, "C": [[1.0, -1.0]] * outputs}
    (tmp_path / "wild.json").write_text(json.dumps(wild))
    code, _, err = call(recorded, "--k-pma", tmp_path / "wild.json", "--loop", "fsm+pma")
    assert code == 1
    assert re.search(r"the controller diverges on .*: at tick \d+ the command \[\d\] is nan", err), err


def test_a_sensor_with_nan_is_told_and_where(call, recorded, tmp_path) -> None:
    changed(recorded, tmp_path / "odd", {"m1/accel": (1234, 2)}, lambda value: np.nan)
    code, _, err = call(tmp_path / "odd")
    assert code == 2 and "m1/accel must be finite" in err and "1.234 s" in err
