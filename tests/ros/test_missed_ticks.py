"""A run that misses more of its ticks than is permitted has an exit code of its own."""

import os
import subprocess
import sys

import pytest

pytest.importorskip("rclpy")
from simple_telescope import write_controllers

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.ros

SLOW = """
import time
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator

class Slow(LosEstimator):
    def __init__(self):
        super().__init__(SampledSystem.from_file("k_fsm.json"))
    def step(self, measurement, out):
        time.sleep(0.003)
        super().step(measurement, out)
"""


@pytest.mark.parametrize(
    ("limit", "code"), [(("--mode=realtime",), 4), pytest.param(("--max-missed=100",), 0, marks=pytest.mark.slow)]
)
def test_more_missed_ticks_than_the_limit_are_no_success(tmp_path, limit, code):
    write_controllers(tmp_path)
    (tmp_path / "slow.py").write_text(SLOW)
    command = [sys.executable, "-m", "los_testbed.cli.app", "run", "--duration=2", "--no-report", "--k-fsm=slow:Slow"]
    command += ["--domain=free", f"--output={tmp_path / 'bag'}", "--start=rest", *limit]
    variables = {**os.environ, "PYTHONPATH": str(tmp_path), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=variables, timeout=600)
    assert done.returncode == code, done.stdout + done.stderr
    if code:
        line = done.stderr.splitlines()[-1]
        assert line.startswith("los-testbed: missed ticks must be at most 0.5 % (--max-missed), got "), line
        assert line.endswith(f"the bag is whole: {tmp_path / 'bag'}")
    assert not Run.open(tmp_path / "bag").problems
