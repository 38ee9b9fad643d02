"""Nodes compare controllers with the telescope: each process for itself, and the runner before it starts any."""

from __future__ import annotations

import os
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from los_testbed.run.processes.node_launch import environment, node_command
from los_testbed.run.runner import Runner
from ros_runs import config_for

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.ros


def user_file(path: Path, text: str) -> str:
    path.write_text(f"[fsm]\n{text}\n")
    return str(path)


@pytest.mark.parametrize("name", [pytest.param("estimator", marks=pytest.mark.slow), "controller"])
def test_a_node_refuses_a_controller_for_another_mirror(name: str, tmp_path: Path) -> None:
    user = user_file(tmp_path / "user.toml", "los_sensitivity = 0.2")
    domain = config_for(tmp_path).domain
    variables = {k: v for k, v in environment(domain, tmp_path).items() if k != "LOS_TESTBED_EVENTS"}
    done = subprocess.run(
        [*node_command(name), "--ros-args", "-p", f"parameters:={user}", "-p", "priority:=false"],
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, **variables},
    )
    assert done.returncode == 2
    assert f"los_testbed {name}: K_FSM, implemented: fsm.los_sensitivity of its design must be 0.2, got 0.1" in (
        done.stderr
    )


def test_a_telescope_with_less_authority_is_run_with_its_own(tmp_path: Path) -> None:
    """Gates and laws have the limit of the telescope; the warning is in the results and in the bag, once each."""
    user = user_file(tmp_path / "user.toml", "authority = 1e-5")
    config = replace(
        config_for(tmp_path), parameters=user, k_fsm="", k_pma="", mode="lockstep", duration=1.2, loop="fsm"
    )
    results = Runner(config).run()
    (warning,) = [line for line in results.warnings if "was designed for" in line]
    assert "fsm_authority 0.0053" in warning and "fsm_authority 1e-05" in warning
    assert results.bag is not None
    run = Run.open(results.bag)
    assert run.parameters["controller_warnings"] == warning
    assert abs(run["fsm/command"].values).max() == 1e-5
    assert not any(int(n) for key, n in results.statistics["plant"].items() if key.startswith("rejected_fsm"))
