"""The small telescope of tests/support stands in for the plant; nodes are copies of one process."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # message fields are type-checked in tests


@pytest.fixture(scope="session", autouse=True)
def node_template() -> Iterator[None]:
    """Nodes that a runner in the process of the tests starts: see ``support/node_template.py``."""
    from node_template import NodeTemplate

    template = NodeTemplate()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("los_testbed.run.processes.node_process.subprocess", template)
        yield
    template.close()
