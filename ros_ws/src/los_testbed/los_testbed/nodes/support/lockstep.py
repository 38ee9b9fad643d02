"""Lockstep: simulated time advances when all commands of a tick have arrived."""

from __future__ import annotations

import time
from collections.abc import Sequence

from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from los_testbed.bags.cdr import stamp_of
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.plant_io import PlantIo
from los_testbed.nodes.support.transport.raw_topics import Waiter
from los_testbed.run.processes.answer_watch import TICKS, AnswerWatch
from titop_plant.interface import TICK_NS

WAIT_NS = 50_000_000

AHEAD_NS = 60 * TICK_NS
"""Largest lag of the recorder before the plant waits: no publisher drops a sample (its history is
:data:`los_testbed.config.topics.DEPTH` long) before the recorder has it."""


class LockstepPacer:
    """Paces the plant by the commands, and by the recorder where one takes part.

    Attributes
    ----------
    hang : str
        Why it has ended a run in which no command came for ``hang_timeout``; a runner watches its own nodes.
    """

    def __init__(self, context: NodeContext, io: PlantIo) -> None:
        self._context = context
        self._io = io
        self._on_last = self._on_any = Waiter(context.node, [])
        self._recorder = Waiter(context.node, [io.progress_input])
        self._recorded = 0
        self._clock = context.node.create_publisher(Clock, "/clock", QoSProfile(depth=1))
        self._message = Clock()
        self._watch = AnswerWatch()
        self.hang = ""

    def begin(self) -> None:
        """Start of a run: the recorder has none of its samples."""
        self._recorded = 0
        self._watch.heard(TICKS)
        sources = [reader.source for reader in self._io.readers]
        self._on_last = Waiter(self._context.node, sources[-1:])  # sent last: one wake-up for all
        self._on_any = Waiter(self._context.node, sources)

    def clock(self, now: int) -> None:
        """Publish simulated time."""
        stamp = self._message.clock
        stamp.sec, stamp.nanosec = divmod(now, 1_000_000_000)
        self._clock.publish(self._message)

    def wait(self, now: int) -> bool:
        """Return when all commands of tick `now` have arrived; False if the run was stopped or hangs."""
        io, following = self._io, now + TICK_NS
        if self._context.stop:
            return False
        self._on_last.wait(WAIT_NS)
        while True:
            io.take(following, time.monotonic_ns())
            if io.fresh(following):
                self._watch.heard(TICKS)
                return self.wait_for_recorder(now, AHEAD_NS)
            if self._context.stop:
                return False
            unanswered = io.unanswered(following)
            self._context.alive(waits_for=unanswered)
            if not self._context.process.tells and self._hangs(unanswered):
                return False
            self._on_any.wait(WAIT_NS)

    def _hangs(self, unanswered: Sequence[str]) -> bool:
        """Whether no tick was done for too long; a warning before."""
        self._watch.waits_for(unanswered)
        for line in self._watch.look():
            self._context.node.get_logger().warning(line)
        if hung := self._watch.silent(self._context.config.hang_timeout):
            self.hang = f"{self._watch.in_words(hung)}: the run was ended (--hang-timeout)"
        return bool(self.hang)

    def wait_for_recorder(self, now: int, ahead: int = 0) -> bool:
        """Return when the recorder has all but the last `ahead` [ns] up to `now`; False if the run was stopped.

        A recorder that sends nothing for the start-up time is no longer waited for.
        """
        if not self._context.config.wait_for_recorder:
            return True
        self._recorded = self._recorded or now - TICK_NS
        deadline = time.monotonic() + self._context.config.start_timeout
        while now - self._recorded > ahead:
            while (taken := self._io.progress_input.take()) is not None:
                if self._io.progress_input.sort(taken, time.monotonic_ns()):
                    continue
                self._recorded = max(self._recorded, stamp_of(taken[0]))
            if now - self._recorded <= ahead:
                break
            if self._context.stop or time.monotonic() > deadline:
                return not self._context.stop
            self._context.alive(waits_for=[self._io.progress_input.name])
            self._recorder.wait(WAIT_NS)
        return True
