"""What users and strangers may do to a run by mistake or on purpose: no requests, many at once, impostors."""

import json
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from bystander import Bystander
from los_testbed.bags.cdr import codec_for
from los_testbed.config.topics import FSM_COMMAND, TRUTH_LOS
from los_testbed.nodes.support.parameters import FAULT
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_faults import run_with_fault
from ros_runs import judged_at_pace
from user_node import UserNode

from pointing_analysis.read.run import Run

pytestmark = pytest.mark.ros
TURNS, FORGED = 6, 50

NO_CHANGES = [
    '{"name": "camera_dropout", "value": NaN}',
    '{"name": "camera_dropout", "value": Infinity}',
    '{"name": "camera_dropout", "value": ' + "9" * 400 + "}",
    '{"name": "camera_dropout", "value": ' + "9" * 5000 + "}",
    '{"name": "camera_dropout", "value": 0.1, "at": NaN}',
    '{"name": "camera_dropout", "value": "0.1"}',
    '{"name": "stop", "value": false}',
    '{"name": "active", "value": false}',
    '{"name": "\\ud800", "value": "\\ud800"}',
    "[" * 20_000,
    "{",
]


def set_fault(*texts):
    """A request with these values, each set by itself; a node answers five requests a second."""
    return SetParameters.Request(parameters=[Parameter(FAULT, value=text).to_parameter_msg() for text in texts])


def use(runner, found):
    user = UserNode(runner.domain)
    remote = user.remote
    try:
        found["refused"] = [
            result
            for node in ("plant", "controller")
            for result in remote._call(SetParameters, f"{node}/set_parameters", set_fault(*NO_CHANGES)).results
        ]
        for _ in range(TURNS):
            remote.turn("controller", "deactivate")
            remote.turn("controller", "activate")
        forge(runner.domain)
    finally:
        user.close()


def forge(domain):
    """Commands from a node with the name of the controller."""
    codec = codec_for(FSM_COMMAND)
    impostor = Bystander(domain, [FSM_COMMAND], [TRUTH_LOS], name="controller", namespace="/telescope")
    try:
        for _ in range(FORGED):
            impostor.send(FSM_COMMAND, codec.encode(impostor.next(TRUTH_LOS), np.full(2, 1e-3)))
        impostor.settle()
    finally:
        impostor.close()


@pytest.fixture(scope="module")
def rough(tmp_path_factory):
    found: dict[str, Any] = {}
    results = run_with_fault(tmp_path_factory.mktemp("rough"), 300, lambda runner: use(runner, found), after=500)
    return found, results, Run.open(results.bag)


def test_texts_that_are_no_change_are_refused_with_a_reason_and_end_no_node(rough):
    assert [result.successful for result in rough[0]["refused"]] == [False] * 2 * len(NO_CHANGES)
    reasons = [result.reason for result in rough[0]["refused"]]
    assert [text for text in reasons if "must be" not in text and "unknown parameter 'active'" not in text] == []
    assert not any("again" in line for line in rough[1].failures), "no node was started again"


def test_a_controller_turned_off_and_on_many_times_is_on_in_the_end(rough):
    statistics, run = rough[1].statistics["controller"], rough[2]
    turns = [change["value"] for change in json.loads(statistics["changes"]) if change["name"] == "active"]
    assert turns == [False, True] * TURNS
    assert np.abs(run["fsm/command"].values[-200:, :2]).max() > 5e-5


def test_commands_of_an_impostor_with_the_name_of_the_controller_reach_no_actuator(rough):
    _, results, run = rough
    line = "/telescope/fsm/command had a second publisher (node of the same name): its messages were not used"
    assert line in results.failures
    plant = results.statistics["plant"]
    seen = int(plant["foreign_/telescope/fsm/command"])
    assert seen <= FORGED
    if judged_at_pace(run, "that the plant sees every forged command"):
        assert seen == FORGED
    refused = sum(int(plant.get(f"rejected_fsm_{reason}", 0)) for reason in ("foreign", "unmatched", "future"))
    assert refused == seen
    own = np.abs(run["fsm/command"].values[:, :2]).max()
    assert own < 9e-4, "1e-3 was asked for"
    angle = np.abs(run["fsm/strain_gauge"].values[:, :2]).max()
    assert angle < 9e-4
    if judged_at_pace(run, "that the mirror follows the recorded commands"):
        assert angle < 1.1 * own
