"""For every test: linear algebra on one thread, as the testbed runs it; no time limit per hypothesis example; an hour
for a slow test that names no other time.

At the end of a run: what was skipped or could not be judged, and how to get it.
"""

from __future__ import annotations

import gc
import os
import signal
import tempfile
import warnings
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
from _pytest.doctest import DoctestModule
from support.further import is_further
from support.skip_remedies import summary
from support.unjudged import UnjudgedWarning, unjudged_lines

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported; child processes inherit it
if not os.access(Path.home(), os.W_OK):  # tests that take rclpy as it comes need a folder for its log
    os.environ.setdefault("ROS_LOG_DIR", f"{tempfile.gettempdir()}/ros_log_of_tests_{os.getuid()}")
os.environ.pop("COLUMNS", None)  # tables are as wide as on any terminal that does not say its size
os.environ.setdefault("LOS_TESTBED_QUIET", "1")  # lines of progress come by the clock: no test may depend on them

from hypothesis import settings

settings.register_profile("any-machine", deadline=None, max_examples=30)  # no test depends on the machine's speed
settings.load_profile("any-machine")

# Who starts the tests may ignore these, and programs inherit it: those of the tests are to end by them.
signal.signal(signal.SIGTERM, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

collect_ignore = ["support/without_linux"]
"""It changes the platform of the program that imports it, and doctests import all."""

SKIPPED_VARIABLE = "SKIPPED_TESTS_FILE"
"""Environment variable: a file that the lines are appended to, so that several runs can be summed up."""

SLOW_S = 3600.0
"""Time limit of slow tests [s]: minutes where the machine is quiet."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With ``--dist loadfile`` the tests of the nodes are one file, see ``tests/support/lanes.py``."""
    from support.lanes import Lanes

    return Lanes(config, log) if config.getoption("dist") == "loadfile" else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The limit of slow tests, the mark of further ones; in a process of several, the tests of the nodes first."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        from support.lanes import nodes_first

        items[:] = nodes_first(items)
    for item in items:
        if is_further(item.nodeid):
            item.add_marker(pytest.mark.further)
        if item.get_closest_marker("slow") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(SLOW_S))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """In a process of several, tests that start no nodes give way to those that do."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        from support.lanes import give_way

        give_way(item.nodeid)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files of further tests are not imported where none of them is asked for."""
    if "not further" in config.option.markexpr and is_further(collection_path.relative_to(config.rootpath).as_posix()):
        return True
    return None


class DoctestsWhereExamplesAre:
    """With ``--doctest-modules`` a module without examples is neither imported nor searched for them."""

    @pytest.hookimpl(wrapper=True)
    def pytest_collect_file(self, file_path: Path) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
        collectors = yield
        if file_path.suffix != ".py" or b">>>" in file_path.read_bytes():
            return collectors
        return [each for each in collectors if not isinstance(each, DoctestModule)]


def pytest_configure(config: pytest.Config) -> None:
    """A plugin of the run, since the packages are outside the folder of this file."""
    config.pluginmanager.register(DoctestsWhereExamplesAre())


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Nearly all that is made while tests are collected stays: nothing is gained by looking for garbage in it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish() -> None:
    """The collected tests stay until the end: later collections of garbage need not look at them."""
    gc.freeze()


@pytest.fixture
def without_pictures(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports without their pictures, which take more than a second: for tests of what else is on a page.

    What is computed for pictures alone is left out, too, and the figures of a star are those of ten exposures. A test
    with the marker ``pictures`` has all of them in spite of it.
    """
    if request.node.get_closest_marker("pictures") is None:
        monkeypatch.setattr("pointing_analysis.report.report.PICTURES", ())
        monkeypatch.setattr("pointing_analysis.requirements.image_summary.MOST", 10)
        monkeypatch.setattr("los_testbed.run.summary.loop_curves.broken_loops", lambda *_: ())


@pytest.fixture(scope="session")
def telescope() -> Any:
    """Parameters of the reference telescope; nothing may change them."""
    from titop_plant.telescope.load import load_telescope

    return load_telescope()


@pytest.fixture(scope="session")
def system(telescope: Any) -> Any:
    """The reference telescope between the ports of the control loop, an uncertain system."""
    from titop_plant.telescope.control_plant import control_loop_plant

    return control_loop_plant(telescope)


UNJUDGED: list[str] = []
"""What was not judged in this run."""


def pytest_warning_recorded(warning_message: warnings.WarningMessage) -> None:
    """Keep what a test could not judge; the class may have been imported by two names."""
    if warning_message.category.__name__ == UnjudgedWarning.__name__:
        UNJUDGED.append(str(warning_message.message))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """One line per reason for which tests were skipped or parts of them not judged, with the remedy."""
    if "PYTEST_XDIST_WORKER" in os.environ:  # the process that started this one counts for all
        return
    reports = terminalreporter.stats.get("skipped", [])
    reasons = [str(report.longrepr[2]).removeprefix("Skipped: ").splitlines()[0] for report in reports]
    lines = summary(reasons) + unjudged_lines(UNJUDGED)
    if lines:
        terminalreporter.section("skipped tests and what was not judged, and how to run them")
        for line in lines:
            terminalreporter.write_line(line)
    if file := os.environ.get(SKIPPED_VARIABLE):
        with Path(file).open("a", encoding="utf-8") as stream:
            stream.writelines(f"{line}\n" for line in lines)
