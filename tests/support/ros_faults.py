"""Runs with a fault in the middle, and what the nodes said about it."""

import threading
from typing import Any

from los_testbed.run.runner import Runner
from ros_runs import PLANT, config_for


def run_with_fault(folder, at, fault, duration=None, after=500, **values):
    """Run the small telescope, and call `fault(runner)` once in a thread when `at` ticks are done.

    The run goes on for `duration`; without one it is ended `after` ticks after the fault returned.
    """
    config = config_for(folder, duration=duration or 240.0, **values)
    return when_running(config, fault, at, {"plant": PLANT}, None if duration else after)


def when_running(config, fault, at, commands=None, after=None):
    """Run, and call `fault(runner)` once in a thread when `at` ticks are done.

    With `after`, the run is ended so many ticks after the fault returned.
    """
    state: dict[str, Any] = {}
    errors: list[BaseException] = []

    def act():
        try:
            fault(runner)
        except BaseException as error:
            errors.append(error)

    def progress(ticks):
        if ticks >= at and "thread" not in state:
            state["thread"] = threading.Thread(target=act)
            state["thread"].start()
        over = after is not None and "thread" in state and not state["thread"].is_alive()
        if over and "ended" not in state and ticks - state.setdefault("end", ticks) >= after:
            state["ended"] = True  # a second interrupt would end the run at once
            raise KeyboardInterrupt

    runner = Runner(config, progress, commands)
    try:
        return runner.run()
    finally:
        if "thread" in state:
            state["thread"].join()
        assert not errors, errors


def diagnostics(bag, name, namespace="telescope"):
    """Times of arrival [ns], levels and messages of one node, in order."""
    from diagnostic_msgs.msg import DiagnosticArray
    from mcap.reader import make_reader
    from rclpy.serialization import deserialize_message

    with next(bag.glob("*.mcap")).open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=["/diagnostics"]):
            for status in deserialize_message(message.data, DiagnosticArray).status:
                if status.name == f"{namespace}: {name}":
                    yield message.log_time, status.level[0], status.message
