"""Start of a run: one plant per domain, and no tick before all nodes receive.

Discovery is not symmetric: a reader may be matched on one side and not yet on the other. So the plant
sends hold ticks (stamp zero: no time has passed) until the commands that answer them have come back,
and, if a recorder takes part, until it says that it sees every topic.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from los_testbed.bags.cdr import stamp_of
from los_testbed.loop.stamp_synchronizer import HOLD_STAMP
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.plant_io import PlantIo
from los_testbed.nodes.support.raw_topics import RawSubscription
from los_testbed.topics import FSM_COMMAND, ISOLATOR_ACCEL
from titop_plant.interface import MEASUREMENTS, TRUTH

LISTEN_S = 1.0
"""A plant on the same domain is discovered within 0.4 s with the discovery profile of this package."""

HOLD_PERIOD_S = 0.02

LEASE_S = 11.0
"""A node that was killed has left the graph within this time."""


def refuse_second_plant(context: NodeContext) -> None:
    """Check for another plant before anything is sent.

    Raises
    ------
    ValueError
        Another plant sends on this domain.
    """
    topic = ISOLATOR_ACCEL
    listener = RawSubscription(context.node, topic.name, topic.type_name)
    name = context.node.resolve_topic_name(topic.name)
    start_time = time.monotonic()
    try:
        while not context.stop:
            if listener.take() is not None:
                raise ValueError(f"ROS_DOMAIN_ID must be a domain without a plant, got one where {name} is sent")
            # a plant that was killed stays in the graph for 20 s: only what is sent counts
            patience = 2 * LISTEN_S if context.node.count_publishers(name) else LISTEN_S
            if time.monotonic() - start_time > patience:
                return
            time.sleep(0.01)
    finally:
        listener.close()


def wait_for_followers(context: NodeContext, io: PlantIo, may_begin: Callable[[], bool] = lambda: True) -> None:
    """Send hold ticks until estimator, controller and, if asked for, recorder answer and the run `may_begin`.

    Raises
    ------
    ValueError
        One of them did not answer in time.
    """
    waiting_for = {"fsm/command": io.fsm_input, "pma/command": io.pma_input}
    if context.config.wait_for_recorder:
        waiting_for["recorder/progress"] = io.progress_input
    start_time = time.monotonic()
    while not context.stop:
        io.publish(HOLD_STAMP, np.zeros(MEASUREMENTS), np.zeros(TRUTH))
        time.sleep(HOLD_PERIOD_S)
        for name, subscription in list(waiting_for.items()):
            while (taken := subscription.take()) is not None:
                ours = not subscription.sort(taken, time.monotonic_ns())
                if ours and len(taken[0]) >= 12 and stamp_of(taken[0]) == HOLD_STAMP:
                    waiting_for.pop(name, None)
            subscription.decide(time.monotonic_ns())
        context.service()
        if not waiting_for and not may_begin():
            start_time = time.monotonic()
        elif not waiting_for:
            time.sleep(HOLD_PERIOD_S)  # the last echoes arrive
            _refuse_second_commander(context, io)
            return
        elif time.monotonic() - start_time > context.config.start_timeout:
            _refuse_second_commander(context, io)
            missing = ", ".join(subscription.name for subscription in waiting_for.values())
            raise ValueError(
                f"all nodes must answer within {context.config.start_timeout:g} s, got no message on {missing}"
            )


def _refuse_second_commander(context: NodeContext, io: PlantIo) -> None:
    """Nobody but one node may send commands when a run begins.

    Raises
    ------
    ValueError
        Another node has a publisher on a command topic.
    """
    expected = f"{context.node.get_namespace().rstrip('/')}/{FSM_COMMAND.publisher}"
    end = time.monotonic() + LEASE_S
    for subscription in (io.fsm_input, io.pma_input):
        while True:
            nodes = {endpoint.node for endpoint in subscription.endpoints() if endpoint.node}
            if len(nodes) < 2 or context.stop:
                break
            if time.monotonic() > end:
                others = ", ".join(sorted(nodes - {expected}))
                raise ValueError(f"{subscription.name} must have one publisher, got also one of {others}")
            time.sleep(HOLD_PERIOD_S)
