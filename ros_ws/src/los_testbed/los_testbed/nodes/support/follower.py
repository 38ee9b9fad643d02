"""Loop of a process that follows the plant's clock: wait for the samples of a tick, synchronize by stamp, compute."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol

from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import stamp_of
from los_testbed.config.topics import TopicDefinition
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.plant_clock import PlantClock
from los_testbed.nodes.support.transport.bundle import TickBundle
from los_testbed.nodes.support.transport.raw_topics import LOCKSTEP_DEPTH, READER_DEPTH, RawSubscription, Waiter
from los_testbed.run.identity import DIGEST
from los_testbed.run.loop.changes import Changes
from los_testbed.run.loop.health import OK, WARN, LoopHealth
from los_testbed.run.loop.latency_histogram import LatencyHistogram
from los_testbed.run.loop.stamp_synchronizer import HOLD_STAMP, NOT_KNOWN, StampSynchronizer

WAIT_NS = 50_000_000
DECISION_NS = 20_000_000
"""Interval of graph queries while a topic has messages of an undecided publisher."""

CHANGE_REPORT_NS = 5_000_000
"""Delay of the report of a change, so that it is in another tick than the response to the request."""

SERVICE_NS, REPORT_NS = 200_000_000, 1_000_000_000
"""Time between answers to requests, and between reports, of a node."""


class NodeLaw(Protocol):
    """Observer or controller in its node."""

    context: NodeContext
    changes: Changes
    digest: str

    def reset(self) -> None:
        """Reset at the start of a run or while the plant holds; the output is zero."""

    def step(self, vector: FloatArray, gap: int) -> None:
        """Step over `gap` missing ticks and on the joined vector of a tick."""

    def publish(self, stamp: int) -> None:
        """Send the output."""

    def settle(self) -> None:
        """Wait until the subscribers have received the last messages."""


class LawLoop:
    """A law in the loop of its process: its settings, times and reports.

    Parameters
    ----------
    law : NodeLaw
    """

    def __init__(self, law: NodeLaw) -> None:
        self.law = law
        self.context = law.context
        self.ticks = 0
        self.next_service = self.next_report = 0
        self._held = self._told = False
        self._tried = self.context.config.exercise > 0.0
        self._troubles = (0, 0)
        self._odd: dict[str, int] = {}
        self._begin_times()

    def _begin_times(self) -> None:
        self.execution, self.period = LatencyHistogram(), LatencyHistogram()
        self._last = 0
        self._health = LoopHealth(self.context.config.mode == "realtime")

    def step(self, since: int, vector: FloatArray, gap: int) -> None:
        """One tick, `since` [ns] after the start of the run, or at a hold tick (-1).

        In a trial before the run the law computes at hold ticks, too, and is reset after each.
        """
        if since < 0:
            if not self._held:  # hold ticks are repeated until they are answered
                self.law.reset()
            if self._tried:
                self.law.step(vector, 0)
                self.law.reset()
            self._held = True
            return
        self._held = False
        changes = self.law.changes
        changes.now = since
        if since >= changes.due:
            changes.advance(since)
        self.law.step(vector, gap)
        self.ticks += 1

    def tell_end(self) -> None:
        """Report once that the node was ended while others of its process continue."""
        if not self._told:
            self._told = True
            self.context.event("left")

    def timed(self, begin: int, end: int) -> None:
        """Note when the work of a tick began and ended (steady clock [ns])."""
        self.execution.add(end - begin)
        if self._last:
            self.period.add(begin - self._last)
        self._last = begin

    def begin_again(self) -> None:
        """The plant holds after a run: the next one has the initial settings and new counts."""
        self.context.finish_work()  # the report has the counts of the moment at which it is written
        self.ticks = 0
        self.law.changes.restore()
        self._begin_times()
        self._troubles = (0, 0)
        self._odd = {}

    def statistics(self, synchronizer: StampSynchronizer, names: Sequence[str]) -> dict[str, str]:
        """Counts and times of the loop."""
        rejected = {f"rejected_{reason}": str(n) for reason, n in sorted(synchronizer.rejected.items())}
        off_grid = {f"off_grid_{names[i]}": str(n) for i, n in sorted(synchronizer.off_grid.items()) if n}
        frames = {name: text for sensor in synchronizer.slow.values() for name, text in sensor.statistics().items()}
        return {
            **({DIGEST: self.law.digest} if self.law.digest else {}),
            "ticks": str(self.ticks),
            "gap_ticks": str(synchronizer.gaps),
            **self.execution.summary("execution"),
            **rejected,
            **{f"not_finite_{name}": str(n) for name, n in _not_finite(synchronizer, names).items()},
            **off_grid,
            **frames,
            **self.law.changes.record(),
        }

    def report(self, synchronizer: StampSynchronizer, names: Sequence[str]) -> None:
        """Diagnostics, and values for plots, by later calls of the context's work."""
        level, message, values = self._health.assess(self.ticks, time.monotonic_ns(), self.execution)
        troubles = (synchronizer.gaps, synchronizer.rejected.total())
        if level == OK and troubles != self._troubles:
            level, message = WARN, "samples missing or rejected"
        if silent := synchronizer.silent():
            level = max(level, WARN)
            message = ", ".join(f"{names[i]} silent for {t * 1e-9:.2g} s" for i, t in silent)
        odd = _not_finite(synchronizer, names)
        if new := [name for name, count in odd.items() if count != self._odd.get(name, 0)]:
            level = max(level, WARN)
            message = ", ".join([*(f"{name} not finite" for name in new), *([message] if silent else [])])
        self._odd = odd
        news = troubles[0] - self._troubles[0], troubles[1] - self._troubles[1]
        self._troubles = troubles
        period = {"period_mean_us": f"{self.period.mean_us:.3f}", "period_max_us": f"{self.period.maximum_us:g}"}
        self.context.diagnose(
            level,
            message,
            lambda: {**values, **period, **self.statistics(synchronizer, names)},
            synchronizer.stamp,
        )
        self.context.plot(
            lambda: {
                **self.period.window("period"),
                **self.execution.window("execution"),
                "ticks": self.ticks,
                "gap_ticks": news[0],
                "rejected_samples": news[1],
            }
        )


def _not_finite(synchronizer: StampSynchronizer, names: Sequence[str]) -> dict[str, int]:
    """Samples that were rejected for a value that is not finite, by topic."""
    return {name or names[index]: count for (index, name), count in sorted(synchronizer.not_finite.items())}


class Follower:
    """Takes samples as they come and steps the laws of this process once for each complete tick.

    Parameters
    ----------
    inputs : sequence of TopicDefinition or TickBundle
        In the order of the synchronizer's parts; the last one is published last and wakes the loop.
    synchronizer : StampSynchronizer
        Joins them by stamp.
    laws : sequence of NodeLaw
        In the order in which they are stepped; the output of the last one is published first.
    """

    def __init__(
        self,
        inputs: Sequence[TopicDefinition | TickBundle],
        synchronizer: StampSynchronizer,
        laws: Sequence[NodeLaw],
    ) -> None:
        self._laws = [LawLoop(law) for law in laws]
        self._context = laws[0].context
        self._synchronizer = synchronizer
        self._start = 0
        self._names = [topic.name for topic in inputs]
        self._names += [sensor.name for number, sensor in synchronizer.slow.items() if number >= len(inputs)]
        mode = self._context.config.mode
        every = mode == "lockstep"
        self._subscriptions = [
            RawSubscription(
                self._context.node, t.name, t.type_name, LOCKSTEP_DEPTH if every else READER_DEPTH, every, t.publisher
            )
            for t in inputs
        ]
        self._on_trigger = Waiter(self._context.node, self._subscriptions[-1:])
        self._on_any = Waiter(self._context.node, self._subscriptions)
        self._trigger = len(inputs) - 1
        self._clock = PlantClock() if mode == "realtime" else None  # in lockstep no time is too early
        self._begun = 0
        self._choose_working()

    def _choose_working(self) -> None:
        """Laws before the first ended one: later ones have no input."""
        ended = [i for i, law in enumerate(self._laws) if law.context.ended]
        self._working = self._laws[: min([len(self._laws), *ended])]
        for i in ended if len(ended) < len(self._laws) and not self._context.stop else ():
            self._laws[i].tell_end()

    def run(self) -> int:
        """Work until a signal comes, or until all laws were ended."""
        for law in self._laws:
            law.context.all_listed()
        self._context.become_real_time()
        now = time.monotonic_ns()
        for i, law in enumerate(self._laws):  # not in the same tick
            law.next_service = now + i * SERVICE_NS // len(self._laws)
            law.next_report = now + i * REPORT_NS // len(self._laws)
            law.context.event("ready")
        next_decision = 0
        while not all(law.context.ended for law in self._laws):
            (self._on_any if self._synchronizer.waiting else self._on_trigger).wait(WAIT_NS)
            now = self._begun = time.monotonic_ns()
            self._drain()
            if now >= next_decision:
                next_decision = now + DECISION_NS
                for subscription in self._subscriptions:
                    subscription.decide(now)
            self._background(now)
        for law in self._laws:
            law.report(self._synchronizer, self._names)
            law.context.finish_work()
            law.context.event("done", statistics=law.statistics(self._synchronizer, self._names))
            law.law.settle()
        return 0

    def _background(self, now: int) -> None:
        """One piece of background work, in the slack after a tick."""
        for law in self._laws:
            if law.law.changes.unpublished and law.next_report > now + CHANGE_REPORT_NS:
                law.next_service, law.next_report = now, now + CHANGE_REPORT_NS
            if now >= law.next_service:
                law.next_service = now + SERVICE_NS
                law.context.service()
                self._choose_working()
                return
        for law in self._laws:
            if law.context.work():
                return
        for law in self._laws:
            if now >= law.next_report:
                law.next_report = now + REPORT_NS
                law.report(self._synchronizer, self._names)
                return

    def _drain(self) -> None:
        """Take new messages; the topic that wakes the loop last, so that it completes the tick."""
        synchronizer, clock = self._synchronizer, self._clock
        for index, subscription in enumerate(self._subscriptions):
            while (taken := subscription.take()) is not None:
                steady = time.monotonic_ns()  # of this sample: a step before it may have taken long
                source = subscription.sort(taken, steady)
                if clock is not None:
                    stamp = stamp_of(taken.data) if len(taken.data) >= 12 and not source else HOLD_STAMP
                    if index == self._trigger and stamp > HOLD_STAMP:
                        clock.note(stamp, steady)
                    synchronizer.now = clock.now(steady)
                self._put(index, taken.data, source)
                clock = self._clock  # another one where another run begins

    def _put(self, index: int, data: bytes, source: str) -> None:
        """Pass a message to the synchronizer; if it completes a tick, step the laws and publish their outputs."""
        synchronizer = self._synchronizer
        vector = synchronizer.put(index, data, source)
        if vector is None:
            return
        stamp, since = synchronizer.stamp, -1
        if stamp != HOLD_STAMP:
            self._start = self._start or stamp
            since = stamp - self._start
        elif self._start:
            self._begin_again()
        working = self._working
        for law in working:
            law.step(since, vector, synchronizer.gap)
        for law in reversed(working):
            law.law.publish(stamp)
        if stamp != HOLD_STAMP:
            end = time.monotonic_ns()
            for law in working:
                law.timed(self._begun, end)
            self._begun = end
        elif self._clock is not None:  # another run begins, on another clock
            self._clock, synchronizer.now = PlantClock(), NOT_KNOWN

    def _begin_again(self) -> None:
        """The plant holds after a run."""
        for law in self._laws:
            law.report(self._synchronizer, self._names)
            law.begin_again()
        self._start = 0
        self._synchronizer.begin_again()
