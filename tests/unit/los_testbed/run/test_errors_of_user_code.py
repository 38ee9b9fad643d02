"""Plants and laws of the user: a broken contract or any exception is one line with its place, and the bag is whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli import app
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from simple_telescope import SimpleTelescope, write_controllers
from support.command_line import refused
from user_code import STORED_LAW

from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import scenario_of, summarise

pytestmark = pytest.mark.usefixtures("without_pictures")

Call = Callable[..., tuple[int, str, str]]

HEAD = """
import sys
import numpy as np
from numpy.linalg import LinAlgError
from lftkit.systems.sampled.sampled_system import SampledSystem
from simple_telescope import SimpleTelescope

FAULTS = {
    "ZeroDivisionError": lambda: 1 / 0,
    "LinAlgError": lambda: np.linalg.inv(np.zeros((2, 2))),
    "KeyError": lambda: {}["wheel"],
    "SystemExit": lambda: sys.exit(0),
    "RecursionError": lambda: FAULTS["RecursionError"](),
}
"""

PLANT = """
class Plant(SimpleTelescope):
    def __init__(self):
        super().__init__()
    def step(self, command, measurement, truth):
        tick = self._tick
        super().step(command, measurement, truth)
        if tick == {tick}:
            self.fail()
    def fail(self):
        FAULTS["{fault}"]()
"""

LAW = f"""{STORED_LAW}
class Law(StoredLaw):
    def step(self, accel_Ip, out):
        super().step(accel_Ip, out)
        if self.tick == {{tick}} + 1:
            FAULTS["{{fault}}"]()
"""

KINDS = ["ZeroDivisionError", "LinAlgError", "KeyError", "SystemExit", "RecursionError"]


@pytest.fixture
def module(tmp_path: Path) -> Callable[..., str]:
    """Writes a module with a name of its own into the folder of the command line."""
    write_controllers(tmp_path)

    def write(text: str, head: str = HEAD, **values: object) -> str:
        name = f"faults_{tmp_path.name}".replace("-", "_")
        (tmp_path / f"{name}.py").write_text(head + text.format(**values))
        return name

    return write


def command(option: str, name: str) -> list[str]:
    """A run of 3 s in one process; a plant of the user comes with the controllers of the test."""
    files = ["--k-fsm", "k_fsm.json", *(["--k-pma", "k_pma.json"] if option == "--plant" else [])]
    line = ["run", "--mode", "inprocess", "--duration", "3", "--no-report", "--output", "bag"]
    return [*line, *files, option, name, *([] if option == "--plant" else ["--scenario", "design"])]


def line_of(text: str, what: str) -> int:
    return next(i for i, line in enumerate(text.splitlines(), 1) if what in line)


@pytest.mark.parametrize("fault", ["LinAlgError", "SystemExit", "RecursionError"])
@pytest.mark.parametrize(("option", "text", "method"), [("--plant", PLANT, "Plant.step"), ("--k-pma", LAW, "Law.step")])
def test_an_exception_in_the_run_is_one_line_and_the_bag_is_whole(
    call: Call, module: Callable[..., str], tmp_path: Path, fault: str, option: str, text: str, method: str
) -> None:
    name = module(text, tick=1234, fault=fault)
    code, out, err = call(*command(option, f"{name}:{method.partition('.')[0]}"))
    assert code == 1 and out == "" and "Traceback" not in err
    lines = [line for line in err.splitlines() if line.startswith("los-testbed: ")]
    assert len(lines) == 1 and f"failed at tick 1234: {fault}" in lines[0], err
    raised = line_of((tmp_path / f"{name}.py").read_text(), f'"{fault}": lambda')
    assert f"({method}, {name}.py:{raised})" in lines[0]
    run = Run.open(tmp_path / "bag")
    assert len(run["truth/los"]) == 1234 and run.losses == ()
    assert any(f"failed at tick 1234: {fault}" in problem for problem in summarise(run).problems)


@pytest.mark.parametrize("fault", KINDS)
@pytest.mark.parametrize(
    ("text", "place"),
    [
        ('\nFAULTS["{fault}"]()\n', "({name}.py:"),
        ('\nclass Law:\n    def __init__(self):\n        FAULTS["{fault}"]()\n', "(Law.__init__, {name}.py:"),
        ('\ndef Law():\n    FAULTS["{fault}"]()\n', "(Law, {name}.py:"),
        (
            LAW + '    @property\n    def design_basis(self):\n        FAULTS["{fault}"]()\n',
            "(Law.design_basis, {name}.py:",
        ),
    ],
    ids=["import", "constructor", "function", "attribute"],
)
def test_an_exception_while_it_is_made_names_its_place(
    call: Call, module: Callable[..., str], fault: str, text: str, place: str
) -> None:
    name = module(text, fault=fault, tick=-1)
    code, out, err = call(*command("--k-pma", f"{name}:Law"))
    assert code == 2 and out == "" and err.count("\n") == 1, err
    assert fault in err and place.format(name=name) in err


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("port", "name", "value"),
    [
        ("measurement[8]", "accel_M1[2]", "1e+308"),
        ("measurement[12]", "accel_M2[0]", "nan"),
        ("truth[1]", "[1]", "nan"),
    ],
)
def test_a_value_that_no_telescope_has_is_named_and_the_bag_ends_before_it(
    call: Call, module: Callable[..., str], tmp_path: Path, port: str, name: str, value: str
) -> None:
    body = "\nclass Plant(SimpleTelescope):\n    def step(self, command, measurement, truth):\n"
    body += "        tick = self._tick\n        super().step(command, measurement, truth)\n"
    body += "        if tick >= 1500:\n            {port} = {value}\n"
    made = module(body, port=port, value=f'float("{value}")')
    code, out, err = call(*command("--plant", f"{made}:Plant"))
    assert code == 1 and out == "" and err.count("\n") == 1, err
    assert f"at tick 1500 the {port.partition('[')[0]} {name} is {value}" in err
    run = Run.open(tmp_path / "bag")
    assert len(run["truth/los"]) == 1500
    assert any("tick 1500" in problem for problem in summarise(run).problems)


def test_an_exception_that_is_none_of_pythons_exceptions_is_one_line(call: Call, module: Callable[..., str]) -> None:
    text = "\nclass Stop(BaseException):\n    pass\n" + PLANT.replace('FAULTS["{fault}"]()', 'raise Stop("[/red]")')
    name = module(text, tick=1234)
    code, out, err = call(*command("--plant", f"{name}:Plant"))
    assert code == 1 and out == "" and err.count("\n") == 1 and "Stop" in err and "[/red]" in err, err


MODULE = """
from simple_telescope import SimpleTelescope

class Plain(SimpleTelescope):
    def __init__(self):
        super().__init__()

class Configured(SimpleTelescope):
    def __init__(self, config):
        super().__init__(seed=config.seed)

class Silent(Plain):
    def step(self, command, measurement, truth):
        measurement[:] = 0.0

class Infinite(Plain):
    def step(self, command, measurement, truth):
        super().step(command, measurement, truth)
        measurement[8] = float("nan")

class Long(Plain):
    def step(self, command, measurement, truth):
        truth[:] = [0.0, 0.0, 0.0]

class Broken(Plain):
    def step(self, command, measurement, truth):
        raise ZeroDivisionError("own mistake")
"""


@pytest.fixture
def plants(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module in the working folder, of a name of its own, with two plants and a broken one."""
    name = f"plants_{tmp_path.name}".replace("-", "_")
    (tmp_path / f"{name}.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    return name


@pytest.mark.parametrize("plant", ["Plain", "Configured"])
def test_a_plant_is_named_on_the_command_line(plant: str, plants: str) -> None:
    files = write_controllers(Path.cwd())
    line = ["run", "--plant", f"{plants}:{plant}", "--mode", "inprocess", "--duration", "0.5", "--loop", "fsm"]
    line += ["--k-fsm", files["k_fsm"], "--k-pma", files["k_pma"], "--no-report", "--output", "bag"]
    assert app.main(line) == 0
    run = Run.open("bag")
    assert run.parameters["plant"] == f"{plants}:{plant}"
    assert run.parameters["start"] == "rest"
    direct = SimpleTelescope()
    run_in_process(RunConfig(duration=0.5, loop="fsm", mode="inprocess", **files), Path("direct"), plant=direct)
    np.testing.assert_array_equal(run["truth/los"].values, Run.open("direct")["truth/los"].values)
    assert [scenario_of(r) for r in (run, Run.open("direct"))] == [
        f"{plants}:{plant}",
        f"{SimpleTelescope.__module__}:SimpleTelescope",
    ]


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        ("{}:Silent", "must write all of truth"),
        ("{}:Infinite", "finite|accel_M1[2]"),
        ("{}:Long", "truth (2,)|ValueError"),
        ("{}:Broken", "ZeroDivisionError|own mistake"),
        ("no_such_module:Plant", "No module named 'no_such_module'"),
        ("short_name", "entry point of los_testbed.plants, got 'short_name' (LookupError: known are none)"),
    ],
)
def test_a_plant_that_cannot_be_used_is_an_error_of_the_user(
    plant: str, words: str, plants: str, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [f"--{name.replace('_', '-')}={path}" for name, path in write_controllers(Path.cwd()).items()]
    line = ["run", "--plant", plant.format(plants), "--mode=inprocess", "--duration=1", "--output=bag", *files]
    error = refused(capsys, *line)
    assert all(word in error for word in words.split("|"))
    assert not Path("bag").exists()
