"""Observer, proof-mass law and disturbance of the user: contract before the run, failures named, the bag names them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli import app
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.start import RunStart
from los_testbed.run.loop.simulate import run_in_process
from simple_telescope import SimpleTelescope, write_controllers
from support.command_line import refused

from lftkit.errors import InputError
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise

pytestmark = pytest.mark.usefixtures("without_pictures")

MODULE = '''
import numpy as np
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from titop_plant.telescope.load import load_telescope

PORTS = load_telescope().loop_ports.of_law("k_fsm")

class Observer(LosEstimator):
    """The test observer of its file, which holds the camera between frames."""
    def __init__(self):
        super().__init__(SampledSystem.from_file("k_fsm.json"), PORTS)

class Law:
    def __init__(self):
        self.system = SampledSystem.from_file("k_pma.json")
    def reset(self):
        self.system.reset()
    def step(self, accel_Ip, out):
        self.system.step(accel_Ip, out)

class Quiet:
    def reset(self):
        pass
    def step(self, out):
        out[:] = 0.0

class Partial(Quiet):
    def step(self, measurement, out):
        out[1] = np.nan

class Passing(Quiet):
    def step(self, measurement, out):
        out[:] = measurement[18:20]

class Long(Quiet):
    def step(self, measurement, out):
        out[:] = np.zeros(3)

class Meddling(Quiet):
    def step(self, measurement, out):
        measurement[3], out[:] = 1.0, 0.0

class Restless(Quiet):
    def step(self, out):
        out[:] = np.random.default_rng().standard_normal(28)
'''


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module in the working folder, of a name of its own, beside the files of the test controllers."""
    name = f"blocks_{tmp_path.name}".replace("-", "_")
    (tmp_path / f"{name}.py").write_text(MODULE)
    write_controllers(tmp_path)
    monkeypatch.chdir(tmp_path)
    return name


def test_classes_give_the_bits_of_the_files_that_they_read(module: str) -> None:
    common = {"duration": 2.0, "mode": "inprocess", "start": "rest"}
    files = {"k_fsm": "k_fsm.json", "k_pma": "k_pma.json"}
    code = {"k_fsm": f"{module}:Observer", "k_pma": f"{module}:Law"}
    for name, settings in (("files", files), ("code", code)):
        run_in_process(RunConfig(**common, **settings), Path(name), SimpleTelescope())
    from_files, from_code = Run.open("files"), Run.open("code")
    for topic in ("truth/los", "los_estimate", "fsm/command", "pma/command"):
        np.testing.assert_array_equal(from_files[topic].values, from_code[topic].values)
    assert np.abs(from_code["pma/command"].values).max() > 0.0


def test_the_bag_names_the_classes_and_their_source(module: str) -> None:
    line = ["run", "--mode", "inprocess", "--duration", "3", "--no-report", "--output", "bag"]
    line += ["--k-fsm", f"{module}:Observer", "--k-pma", f"{module}:Law", "--disturbance", f"{module}:Quiet"]
    assert app.main(line) == 0
    run = Run.open("bag")
    digest = hashlib.sha256(MODULE.encode()).hexdigest()
    for setting, name in (("k_fsm", "Observer"), ("k_pma", "Law"), ("disturbance_source", "Quiet")):
        assert run.parameters[setting] == f"{module}:{name}"
        assert run.parameters[f"{setting}_source_sha256"] == digest
    assert "transient_s" not in run.parameters and "switched on at the start" in run.parameters["start_note"]
    assert not {"k_fsm.json", "k_pma.json"} & set(run.attachments)
    assert app.main(["report", "bag", "--output", "page.html"]) in (0, 1)


@pytest.mark.parametrize(
    ("option", "name", "words"),
    [
        ("--k-fsm", "{}:Partial", "must write all of out, got nothing in los_estimate[0]"),
        ("--k-fsm", "{}:Passing", "must write finite values, got nan in los_estimate[0] at tick 1"),
        ("--k-fsm", "{}:Long", "los_estimate (2,), got ValueError: could not broadcast"),
        ("--k-fsm", "{}:Meddling", "must not change its input"),
        ("--k-pma", "{}:Missing", "has no attribute 'Missing'"),
        ("--k-fsm", "short_name", "k_fsm must be a file, MODULE:NAME or an entry point of los_testbed.k_fsm"),
        ("--disturbance", "{}:Restless", "must give the same outputs after reset"),
    ],
)
def test_what_cannot_be_used_is_one_line_before_the_run(
    option: str, name: str, words: str, module: str, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["run", option, name.format(module), "--mode", "inprocess", "--duration", "1", "--output", "bag"]
    assert words in refused(capsys, *line)
    assert not Path("bag").exists()


MODELS = """

from pathlib import Path
import fsm_pma_controller
import los_estimator
from titop_plant.interface import HELD

OBSERVER = SampledSystem.from_file(Path(los_estimator.__file__).parent / "designs/k_fsm.json")
LAW = SampledSystem.from_file(Path(fsm_pma_controller.__file__).parent / "designs/k_pma.json")

class Plain:
    def __init__(self):
        self.reset()
    def reset(self, state=None, held=None):
        self.x = np.zeros(OBSERVER.order) if state is None else np.array(state)
        self.held = np.zeros(HELD.size) if held is None else np.array(held)
    def step(self, y, out):
        u = y.copy()
        if np.isfinite(u[HELD]).all():
            self.held[:] = u[HELD]
        u[HELD] = self.held
        out[:] = OBSERVER.C @ self.x + OBSERVER.D @ u
        self.x = OBSERVER.A @ self.x + OBSERVER.B @ u

class WithModel(Plain):
    def system(self):
        return OBSERVER.to_control()

class OtherModel(Plain):
    def system(self):
        return SampledSystem(OBSERVER.A, OBSERVER.B, 1.01 * OBSERVER.C, OBSERVER.D, OBSERVER.inputs, OBSERVER.outputs,
                             OBSERVER.dt)

class Forgetful(Plain):
    def system(self):
        return OBSERVER
    def reset(self, state=None, held=None):
        super().reset()

class NoModel(Plain):
    def system(self):
        return 3

class ForceLaw:
    def __init__(self):
        self.reset()
    def reset(self, state=None):
        self.x = np.zeros(LAW.order) if state is None else np.array(state)
    def step(self, a, out):
        out[:] = LAW.C @ self.x + LAW.D @ a
        self.x = LAW.A @ self.x + LAW.B @ a
    def system(self):
        return LAW
"""


@pytest.fixture
def models(module: str) -> str:
    Path(f"{module}_models.py").write_text(MODULE + MODELS)
    return f"{module}_models"


@pytest.mark.parametrize(
    "laws",
    [
        {"k_fsm": "{}:OBSERVER", "k_pma": "{}:LAW"},
        {"k_fsm": "{}:WithModel", "k_pma": "{}:ForceLaw"},
    ],
    ids=["systems", "classes"],
)
def test_a_law_with_a_model_starts_and_is_judged_as_its_file(models: str, laws: dict[str, str]) -> None:
    """The same tone, and the same line of sight from the first sample on."""
    common = {"duration": 0.2, "mode": "inprocess", "scenario": "worst_case", "loop": "fsm+pma"}
    named = {name: text.format(models) for name, text in laws.items()}
    for folder, given in (("files", {}), ("code", named)):
        run_in_process(RunConfig(**common, **given), Path(folder))
    files, code = Run.open("files"), Run.open("code")
    assert code.parameters["transient_s"] == files.parameters["transient_s"] == 0
    assert code.parameters["tones_rad_s"] == files.parameters["tones_rad_s"]
    expected = files["truth/los"].values
    assert np.abs(code["truth/los"].values - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("OtherModel", "step must agree with system() from a state, got "),
        ("Forgetful", "step must agree with system() from a state, got "),
        ("NoModel", "system must return the sampled system of the block, got "),
    ],
)
def test_a_model_that_is_another_system_is_refused(models: str, name: str, words: str) -> None:
    with pytest.raises(InputError) as told:
        _ = RunParts(RunConfig(k_fsm=f"{models}:{name}")).k_fsm
    assert words in str(told.value) and "\n" not in str(told.value)


@pytest.mark.further
def test_without_a_model_the_telescope_shakes_already_when_the_law_is_switched_on(models: str) -> None:
    """So what is left to settle is what the law changes: after 4 s the RPE of the file, not after minutes."""
    common = {"duration": 6.0, "mode": "inprocess", "scenario": "unit_norm", "loop": "fsm", "noise": False}
    plain = {"k_fsm": f"{models}:Plain"}
    for folder, given in (("file", {}), ("code", plain), ("rest", {**plain, "start": "rest"})):
        run_in_process(RunConfig(**common, **given), Path(folder))
    start = RunParts(RunConfig(**common, k_fsm=f"{models}:Plain")).start
    assert start.states is not None and start.switched_on and not start.steady
    assert not start.states.k_fsm.any() and not start.states.camera.any() and start.states.plant.any()
    file, code, rest = (summarise(Run.open(name), transient=4.0).rpe_rms for name in ("file", "code", "rest"))
    assert code == pytest.approx(file, rel=0.1) and abs(rest - file) > 5 * abs(code - file)
    assert RunStart.from_bytes(start.to_bytes()).switched_on and not RunStart.from_bytes(RunStart().to_bytes()).steady
