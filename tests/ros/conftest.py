"""All files need rclpy and have the mark `ros`; the small telescope of tests/support stands in for the plant; nodes are
copies of one process."""

import os
import sys
from collections.abc import Generator, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))

os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"  # message fields are type-checked in tests

TOO_SLOW = "a plant step must take less than 1 ms in real time"
"""Why a run in real time ends on a machine that gives the plant too little of a processor."""


class NeedsRclpy(pytest.Module):
    """A file of tests, which is skipped before it is imported where rclpy is missing."""

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        pytest.importorskip("rclpy")
        pytest.importorskip("std_srvs")
        return super().collect()


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module:
    """Every file of this folder."""
    module = NeedsRclpy.from_parent(parent, path=module_path)
    module.add_marker(pytest.mark.ros)
    return module


def _skipped_where_too_slow() -> Generator[None, Any, Any]:
    try:
        return (yield)
    except RuntimeError as error:
        if TOO_SLOW in str(error):
            pytest.skip("this machine is too slow or too busy for a run in real time")
        raise


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Generator[None, Any, Any]:
    """Of a run in real time that this machine does not bear nothing can be judged."""
    return (yield from _skipped_where_too_slow())


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup() -> Generator[None, Any, Any]:
    """As for a test: several share the run of a fixture."""
    return (yield from _skipped_where_too_slow())


@pytest.fixture(scope="session", autouse=True)
def node_template() -> Iterator[None]:
    """Nodes that a runner in the process of the tests starts: see ``support/node_template.py``."""
    from node_template import NodeTemplate

    template = NodeTemplate()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("los_testbed.run.processes.node_process.subprocess", template)
        yield
    template.close()
