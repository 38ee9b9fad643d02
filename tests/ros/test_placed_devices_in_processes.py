"""A law of the user that reads a placed sensor and commands a placed actuator, in four processes."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from ros_runs import config_for, lockstep_and_alone

EXAMPLES = Path(__file__).parents[2] / "examples"

pytestmark = pytest.mark.ros


@pytest.mark.slow
def test_lockstep_has_the_bytes_of_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)
    config = config_for(
        tmp_path,
        mode="lockstep",
        duration=0.3,
        seed=5,
        loop="fsm+pma",
        parameters=str(EXAMPLES / "spacecraft/damper_at_an_array.toml"),
        k_pma="classes_for_a_run:DampedRoot",
    )
    hashes, *_ = lockstep_and_alone(config, tmp_path)
    assert hashes["/telescope/actuator/damper/command"][0] == hashes["/telescope/sensor/root"][0] == 300
