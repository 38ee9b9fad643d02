"""Disturbance, observer and proof-mass law of the user in the nodes: the bytes of one process, failures by name."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from los_testbed.run.results import RunError
from los_testbed.run.runner import Runner
from ros_runs import PLANT, config_for, lockstep_and_alone
from user_code import STORED_LAW

from pointing_analysis.read.run import Run
from titop_plant.interface import TICK_NS

MODULE = """
import threading
import numpy as np
from los_estimator.runtime import LosEstimator
from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.telescope.load import load_telescope
"""
MODULE += STORED_LAW
MODULE += """
class Gusts:
    def __init__(self, config):
        self.seed = config.seed
    def reset(self):
        self.rng = np.random.default_rng(self.seed)
    def step(self, out):
        out[:] = 1e-3 * self.rng.standard_normal(28)

class Observer(LosEstimator):
    def __init__(self):
        super().__init__(SampledSystem.from_file("k_fsm.json"), load_telescope().loop_ports.of_law("k_fsm"))

class Law(StoredLaw):
    def step(self, accel_Ip, out):
        super().step(accel_Ip, out)
        np.tanh(out, out=out)

class Raising(Law):
    def step(self, accel_Ip, out):
        super().step(accel_Ip, out)
        if self.tick > 300:
            {}["no such key"]

class Waiting(Law):
    def step(self, accel_Ip, out):
        super().step(accel_Ip, out)
        if self.tick > 300:
            threading.Event().wait()

class Plant:
    frame_ticks = 20
    def reset(self):
        self.tick = 0
    def step(self, command, measurement, truth):
        if self.tick == 700:
            np.linalg.inv(np.zeros((2, 2)))
        measurement[:], truth[:] = 0.0, 0.0
        self.tick += 1

class Failing(Law):
    def step(self, accel_Ip, out):
        super().step(accel_Ip, out)
        if self.tick > 300:
            out[2] = np.nan
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "blocks_of_nodes.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    return "blocks_of_nodes"


def settings(module: str, **more: object) -> dict[str, object]:
    names = {"disturbance_source": "Gusts", "k_fsm": "Observer", "k_pma": "Law"}
    return {**{setting: f"{module}:{name}" for setting, name in names.items()}, **more}


def test_lockstep_gives_the_bytes_of_the_run_in_one_process(tmp_path: Path, module: str) -> None:
    config = config_for(tmp_path, mode="lockstep", duration=0.5, **settings(module))
    assert lockstep_and_alone(config, tmp_path)[0]["/telescope/pma/command"][0] == 500


def test_a_value_that_is_not_finite_ends_the_run_and_names_tick_and_port(tmp_path: Path, module: str) -> None:
    config = config_for(tmp_path, mode="lockstep", duration=2.0, **settings(module, k_pma=f"{module}:Failing"))
    with pytest.raises(RunError, match=rf"k_pma {module}:Failing failed at tick 300: pma_force\[2\] is nan"):
        Runner(config, lambda ticks: None).run()


LAW_RAISES = (
    "k_pma",
    "Raising",
    300,
    r"controller: k_pma {module}:Raising failed at tick 30\d: KeyError: 'no such key' "
    r"\(Raising.step, {module}.py:{line}\)",
)
PLANT_RAISES = (
    "plant",
    "Plant",
    700,
    r"plant: failed at tick 700: LinAlgError: Singular matrix \(Plant.step, {module}.py:{line}\)",
)


@pytest.mark.parametrize(
    ("mode", "setting", "name", "ticks", "words"),
    [
        ("lockstep", *LAW_RAISES),
        ("realtime", *PLANT_RAISES),
        pytest.param("realtime", *LAW_RAISES, marks=pytest.mark.slow),
        pytest.param("lockstep", *PLANT_RAISES, marks=pytest.mark.slow),
    ],
)
def test_any_exception_of_the_user_ends_the_run_with_one_line_and_a_whole_bag(
    tmp_path: Path, module: str, mode: str, setting: str, name: str, ticks: int, words: str
) -> None:
    """It does not start the node again as if it had been killed: the same exception would come again."""
    config = config_for(tmp_path, mode=mode, duration=60.0, **{setting: f"{module}:{name}"})
    raised = {"k_pma": '{}["no such key"]', "plant": "np.linalg.inv"}[setting]
    line = next(i for i, text in enumerate(MODULE.splitlines(), 1) if raised in text)
    runner = Runner(config, lambda ticks: None)
    with pytest.raises(RunError, match=words.format(module=module, line=line)) as error:
        runner.run()
    assert error.value.code == 1 and "\n" not in str(error.value) and "started again" not in str(error.value)
    run = Run.open(tmp_path / "bag")
    # how many periods of a real-time run the machine loses is its matter: the bag goes to the exception
    stamps = run["truth/los"].stamp
    assert run.problems == () and (stamps[-1] - stamps[0]) // TICK_NS >= ticks - 100
    assert mode == "realtime" or len(stamps) >= ticks - 100


def test_a_law_that_waits_for_ever_ends_the_run(tmp_path: Path, module: str) -> None:
    """Python answers no request meanwhile, and no signal ends it: after a while it is killed."""
    config = config_for(tmp_path, mode="lockstep", duration=60.0, hang_timeout=6.0, k_pma=f"{module}:Waiting")
    results = Runner(config, lambda ticks: None).run()
    assert results.failures == ["estimator_controller has not responded for 6 s: the run was ended (--hang-timeout)"]
    assert len(Run.open(results.bag)["truth/los"]) >= 300


BUILT = """
import sys
from los_testbed.nodes import {node}

class Own:
    frame_ticks = 20
    tick = 0
    def reset(self):
        self.tick = 0
    def step(self, *vectors):
        for vector in vectors[{outputs}:]:
            vector[:] = 0.0
        self.tick += 1
        if self.tick == 500:
            [][3]

sys.exit({node}.main(sys.argv[1:], build=lambda config: {made}))
"""


@pytest.mark.parametrize(
    ("node", "outputs"),
    [
        ("controller", -1),
        pytest.param("plant", 1, marks=pytest.mark.slow),
        pytest.param("estimator", -1, marks=pytest.mark.slow),
    ],
)
def test_an_object_that_a_node_was_given_is_named_when_it_fails(tmp_path: Path, node: str, outputs: int) -> None:
    file = tmp_path / "own_node.py"
    file.write_text(BUILT.format(node=node, outputs=outputs, made="Own()"))
    commands = {"plant": PLANT, node: [sys.executable, str(file)]}
    with pytest.raises(RunError, match=rf"{node}: .*failed.*: IndexError: .* \(Own.step, {file}:15\)") as error:
        Runner(config_for(tmp_path, duration=60.0), lambda ticks: None, commands=commands).run()
    assert error.value.code == 1
    assert len(Run.open(tmp_path / "bag")["truth/los"]) > 300


SLOW_AT_FIRST = """
import sys, time
from los_testbed.nodes import {node}

class SlowAtFirst:
    compiled = False
    def reset(self):
        pass
    def step(self, *vectors):
        if not self.compiled:
            time.sleep(0.3)
            self.compiled = True
        vectors[-1][:] = 0.0

sys.exit({node}.main(sys.argv[1:], build=lambda config: SlowAtFirst()))
"""


@pytest.mark.further
@pytest.mark.parametrize("node", ["estimator", pytest.param("controller", marks=pytest.mark.slow)])
def test_a_first_step_of_a_third_of_a_second_costs_no_more_than_that(tmp_path: Path, node: str) -> None:
    """What comes after it is as late as it is; none of it is taken for a stamp of the future."""
    file = tmp_path / "own_node.py"
    file.write_text(SLOW_AT_FIRST.format(node=node))
    commands = {"plant": PLANT, node: [sys.executable, str(file)]}
    results = Runner(config_for(tmp_path, duration=4.0), lambda ticks: None, commands=commands).run()
    run = Run.open(results.bag)
    assert "rejected_future" not in results.statistics[node]
    assert run["fsm/command"].stamp[-1] > run["truth/los"].stamp[-1] - 2_000_000_000, "it works to the end"
