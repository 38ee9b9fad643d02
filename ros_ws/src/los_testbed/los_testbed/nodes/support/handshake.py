"""Start of a run: one plant per domain, and no tick before all nodes receive.

Discovery is not symmetric: a reader may be matched on one side and not yet on the other. So the plant
sends hold ticks (stamp zero: no time has passed) until the commands that answer them have come back,
and, if a recorder takes part, until it says that it sees every topic.
"""

from __future__ import annotations

import time

import numpy as np

from los_testbed.bags.cdr import stamp_of
from los_testbed.loop.stamp_synchronizer import HOLD_STAMP
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.plant_io import PlantIo
from los_testbed.nodes.support.raw_topics import RawSubscription
from los_testbed.topics import ISOLATOR_ACCEL, NAMESPACE
from titop_plant.interface import MEASUREMENTS, TRUTH

LISTEN_S = 1.0
"""A plant on the same domain is discovered within 0.4 s with the discovery profile of this package."""

HOLD_PERIOD_S = 0.02


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


def wait_for_followers(context: NodeContext, io: PlantIo) -> None:
    """Send hold ticks until estimator, controller and, if asked for, recorder answer.

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
                if stamp_of(taken[0]) == HOLD_STAMP:
                    waiting_for.pop(name, None)
        if not waiting_for:
            time.sleep(HOLD_PERIOD_S)  # the last echoes arrive
            return
        if time.monotonic() - start_time > context.config.start_timeout:
            missing = ", ".join(f"{NAMESPACE}/{name}" for name in waiting_for)
            raise ValueError(
                f"all nodes must answer within {context.config.start_timeout:g} s, got no message on {missing}"
            )
