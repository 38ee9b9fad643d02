"""Sentences about requests to a run, from bags of any origin."""

import json
from types import SimpleNamespace

import pytest
from los_testbed.run.change_requests import SHOWN, requested


def run(**changes):
    """A run whose nodes tell these changes."""
    statistics = {node: {"changes": json.dumps(rows)} for node, rows in changes.items()}
    return SimpleNamespace(parameters={"statistics": statistics})


def row(tick, name, value, by="/stranger"):
    return {"tick": tick, "name": name, "value": value, "by": by}


def test_requests_are_told_in_order_of_time_with_their_senders():
    found = requested(
        run(
            plant=[row(100, "noise", False), row(9100, "stop", True)],
            controller=[row(50, "loop", "fsm", "/user"), row(60, "active", False)],
        )
    )
    assert found == (
        'loop set to "fsm" by request at 0.05 s, from /user',
        "controller deactivated by request at 0.06 s, from /stranger",
        "noise set to false by request at 0.1 s, from /stranger",
        "stopped by request at 9.1 s, from /stranger",
    )


def test_of_many_requests_the_first_ones_and_the_last_are_told():
    found = requested(run(plant=[row(k, "noise", False) for k in range(50)] + [row(99, "reset", True)]))
    assert len(found) == SHOWN + 2
    assert found[SHOWN] == f"{50 - SHOWN} more changes by request"
    assert found[-1] == "reset by request at 0.099 s, from /stranger"


@pytest.mark.parametrize("text", ["", "[", "[" * 100_000, '[{"by": 1, "name": "stop", "tick": 3}]', None])
def test_what_is_no_list_of_changes_is_left_out(text):
    assert requested(SimpleNamespace(parameters={"statistics": {"plant": {"changes": text}}})) == ()
    assert requested(SimpleNamespace(parameters={"statistics": text})) == ()
