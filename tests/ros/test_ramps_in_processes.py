"""Runs in which wheels and arrays move, with the telescope and four processes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
from ros_runs import config_for, lockstep_and_alone

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
    hashes, ours, theirs = lockstep_and_alone(config, tmp_path)
    assert hashes["/telescope/truth/los"][0] == 400 and ours.parameters["motion"] == theirs.parameters["motion"]
