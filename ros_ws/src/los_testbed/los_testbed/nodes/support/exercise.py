"""Trial of the loop before a real-time run: whether commands arrive within their period on this machine."""

from __future__ import annotations

import time

import numpy as np

from los_testbed.nodes.support.handshake import hold
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.plant_io import CommandReader, PlantIo
from los_testbed.run.loop.stamp_synchronizer import HOLD_STAMP
from los_testbed.run.loop.tick_clock import TickClock
from los_testbed.run.results import Exercised
from titop_plant.interface import RATE, TICK_NS

WARM_UP_TICKS = 100
"""First ticks, not counted: the first computation and transmission take longer."""


def exercise(context: NodeContext, io: PlantIo, seconds: float) -> Exercised:
    """Send hold ticks at the tick rate, and count those that are not answered before the next one.

    Periods in which the plant itself was not woken are counted separately: the machine was stalled.

    Parameters
    ----------
    context : NodeContext
        Of the plant.
    io : PlantIo
        Whose followers have answered.
    seconds : float
        Duration [s].
    """
    clock, ticks, late, lost = TickClock(TICK_NS), 0, 0, 0
    latencies: list[int] = []
    clock.begin(time.monotonic_ns() + TICK_NS)
    for reader in io.readers:
        reader.empty()
    woke = 0
    for number in range(round(seconds * RATE) + 1):
        overrun = clock.wait() // TICK_NS
        arrivals = [_last_arrival(reader) for reader in io.readers]
        if number > WARM_UP_TICKS:
            ticks += 1
            lost += overrun
            late += min(arrivals) <= 0
            latencies += [max(arrivals) - woke] if min(arrivals) > 0 else []
        if context.stop:
            break
        woke = time.time_ns()
        hold(io)
    return Exercised(ticks, late, lost, float(np.median(latencies)) / 1e3 if latencies else 0.0)


def _last_arrival(reader: CommandReader) -> int:
    """When the last hold tick was answered, of what has come since the last call (wall clock [ns]); 0: nothing has."""
    last = 0
    while (taken := reader.source.take()) is not None:
        if not reader.source.sort(taken, time.monotonic_ns()) and reader.stamp_of(taken) == HOLD_STAMP:
            last = taken.received
    return last
