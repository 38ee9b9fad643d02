"""Runs in which wheels and arrays move, with the telescope and four processes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.runner import Runner
from ros_runs import config_for, topic_hashes

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.ros

THROUGH_REST: dict[str, Any] = {
    "wheel_speed": [1.0, -397.0, 60.0, -100.0],
    "wheel_acceleration": [-8.0, -16.0, 40.0, 0.0],
    "theta": 0.3,
    "theta_rate": 0.2,
    "ramp_duration": 0.3,
}
"""A wheel through rest, one across the mode near 400 rad/s, the arrays turning; constant in the end."""

TABLE = """time,theta,wheel_speed_1,wheel_speed_2,wheel_speed_3,wheel_speed_4
0,0.1,300,-300,80,-80
0.1,0.1,302,-310,60,-80
0.3,0.2,302,-330,-20,-79
"""


@pytest.mark.parametrize(
    "profile",
    ["trapezoidal", pytest.param("linear", marks=pytest.mark.slow), pytest.param("file", marks=pytest.mark.slow)],
)
def test_a_ramp_in_lockstep_has_the_bytes_of_the_ramp_in_one_process(profile: str, tmp_path: Path) -> None:
    moves = {**THROUGH_REST, "profile": profile}
    if profile == "file":
        (tmp_path / "profile.csv").write_text(TABLE, "utf-8")
        moves = {"profile": str(tmp_path / "profile.csv")}
    config = config_for(tmp_path, mode="lockstep", scenario="ramp", duration=0.4, start="steady", seed=5, **moves)
    results = Runner(config, lambda ticks: None).run()
    run_in_process(config, tmp_path / "alone")
    ours, theirs = topic_hashes(results.bag), topic_hashes(tmp_path / "alone")
    loop = [topic for topic in theirs if topic in ours]
    assert len(loop) >= 8 and ours["/telescope/truth/los"][0] == 400
    assert {topic: ours[topic] for topic in loop} == {topic: theirs[topic] for topic in loop}
    motions = [Run.open(bag).parameters["motion"] for bag in (results.bag, tmp_path / "alone")]
    assert motions[0] == motions[1]
