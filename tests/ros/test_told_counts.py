"""What the runner says at the end of messages that were not of the run."""

import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.run.runner import Runner

TOPIC = "/telescope/truth/los"


@pytest.mark.parametrize("misused", [0, 7])
def test_messages_that_were_used_are_not_said_to_be_unused(misused):
    runner = Runner(RunConfig(mode="lockstep"))
    event = {"event": "second_publisher", "topic": TOPIC, "publisher": "/stranger"}
    runner._handle("recorder", event, None)
    used = {f"misused_{TOPIC}": str(misused)} if misused else {}
    runner.results.statistics = {"recorder": {f"foreign_{TOPIC}": "50", **used}}
    runner._tell_counts()
    said = [*runner.results.warnings, *runner.results.failures]
    assert any("not used" in text for text in said) == (not misused)
    assert any(f"{misused} of its messages were used" in text for text in said) == bool(misused)
    assert len(runner.results.failures) == 1
