"""A law of the user that reads a placed sensor and commands a placed actuator, in four processes."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.runner import Runner
from ros_runs import config_for, topic_hashes

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
    results = Runner(config, lambda ticks: None).run()
    run_in_process(config, tmp_path / "alone")
    ours, theirs = topic_hashes(results.bag), topic_hashes(tmp_path / "alone")
    assert ours["/telescope/actuator/damper/command"][0] == ours["/telescope/sensor/root"][0] == 300
    assert {topic: ours[topic] for topic in theirs if topic in ours} == theirs
