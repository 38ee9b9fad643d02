"""Disturbance, observer and proof-mass law of the user in the nodes: the bytes of one process, failures by name."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from los_testbed.loop.simulate import run_in_process
from los_testbed.run.results import RunError
from los_testbed.run.runner import Runner
from ros_runs import config_for, topic_hashes

from pointing_analysis.read import Run

pytestmark = pytest.mark.ros

MODULE = """
import numpy as np
from los_estimator.runtime import LosEstimator
from lti.sampled_system import SampledSystem

class Gusts:
    def __init__(self, config):
        self.seed = config.seed
    def reset(self):
        self.rng = np.random.default_rng(self.seed)
    def step(self, out):
        out[:] = 1e-3 * self.rng.standard_normal(28)

class Observer(LosEstimator):
    def __init__(self):
        super().__init__(SampledSystem.from_file("k_fsm.json"))

class Law:
    def __init__(self):
        self.law = SampledSystem.from_file("k_pma.json")
    def reset(self):
        self.law.reset()
        self.tick = 0
    def step(self, accel_Ip, out):
        self.law.step(accel_Ip, out)
        np.tanh(out, out=out)
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
    results = Runner(config, lambda ticks: None).run()
    run_in_process(config, tmp_path / "alone")
    ours, theirs = topic_hashes(results.bag), topic_hashes(tmp_path / "alone")
    assert ours == theirs
    assert ours["/telescope/pma/command"][0] == 500


def test_a_run_in_real_time_names_them_in_its_bag(tmp_path: Path, module: str) -> None:
    config = config_for(tmp_path, duration=1.0, **settings(module))
    results = Runner(config, lambda ticks: None).run()
    parameters = Run.open(results.bag).parameters
    for setting, name in settings(module).items():
        assert parameters[setting] == name
        assert len(parameters[f"{setting}_source_sha256"]) == 64


def test_a_value_that_is_not_finite_ends_the_run_and_names_tick_and_port(tmp_path: Path, module: str) -> None:
    config = config_for(tmp_path, mode="lockstep", duration=2.0, **settings(module, k_pma=f"{module}:Failing"))
    with pytest.raises(RunError, match=rf"k_pma {module}:Failing failed at tick 300: pma_force\[2\] is nan"):
        Runner(config, lambda ticks: None).run()
