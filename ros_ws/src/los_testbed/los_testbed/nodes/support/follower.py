"""Loop of a node that follows the plant's clock: wait for the last sample of a tick, synchronize by stamp, compute."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import stamp_of
from los_testbed.loop.changes import Changes
from los_testbed.loop.health import OK, WARN, LoopHealth
from los_testbed.loop.latency_histogram import LatencyHistogram
from los_testbed.loop.stamp_synchronizer import HOLD_STAMP, NOT_KNOWN, StampSynchronizer
from los_testbed.nodes.support.node_context import NodeContext
from los_testbed.nodes.support.plant_clock import PlantClock
from los_testbed.nodes.support.transport.raw_topics import LOCKSTEP_DEPTH, READER_DEPTH, RawSubscription, Waiter
from los_testbed.topics import TopicDefinition
from titop_plant.interface import TICK_NS

WAIT_NS = 50_000_000
DECISION_NS = 20_000_000
"""Time between looks at the graph while a topic has messages of a publisher that is not yet decided on."""

CHANGE_REPORT_NS = 5_000_000
"""A change is reported this long after it was applied, in another tick than the answer to the request."""

Tick = Callable[[int, FloatArray, int], None]


class Follower:
    """Takes samples as they come and calls `tick(stamp, vector, gap)` once for each complete tick.

    Parameters
    ----------
    context : NodeContext
        The node.
    topics : sequence of TopicDefinition
        Inputs, in the order of the synchronizer's parts; the last one is published last and wakes the loop.
    synchronizer : StampSynchronizer
        Joins them by stamp.
    tick : callable
        What to do with a tick; publishes its result.
    changes : Changes
        Settings that may change during the run.
    """

    def __init__(
        self,
        context: NodeContext,
        topics: Sequence[TopicDefinition],
        synchronizer: StampSynchronizer,
        tick: Tick,
        changes: Changes,
    ) -> None:
        self._context = context
        self._synchronizer = synchronizer
        self._tick = tick
        self._changes = changes
        self._start = 0
        self._names = [topic.name for topic in topics]
        every = context.config.mode == "lockstep"
        self._subscriptions = [
            RawSubscription(
                context.node, t.name, t.type_name, LOCKSTEP_DEPTH if every else READER_DEPTH, every, t.publisher
            )
            for t in topics
        ]
        self._on_trigger = Waiter(context.node, self._subscriptions[-1:])
        self._on_any = Waiter(context.node, self._subscriptions)
        early = [i for i, part in enumerate(synchronizer.parts[:-1]) if part.period_ns == TICK_NS]
        # in lockstep each further wake-up would cost time: nothing goes on meanwhile
        self._early = early if len(early) > 1 and not every else []
        self._gathered = [-1] * len(topics)
        self._execution = LatencyHistogram()
        self._period = LatencyHistogram()
        self._health = LoopHealth(context.config.mode == "realtime")
        self._troubles = (0, 0)
        self._clock = PlantClock() if context.config.mode == "realtime" else None  # in lockstep no time is too early
        self.ticks = 0

    def run(self) -> int:
        """Work until a signal comes."""
        context = self._context
        context.become_real_time()
        context.all_listed()
        context.event("ready")
        next_report, next_service, next_decision, last = time.monotonic_ns(), 0, 0, 0
        while not context.stop:
            gathering = self._wait()
            before = time.monotonic_ns()
            if self._drain():
                self._execution.add(time.monotonic_ns() - before + gathering)
                if last:
                    self._period.add(before - last)
                last = before
            if before >= next_decision:
                next_decision = before + DECISION_NS
                for subscription in self._subscriptions:
                    subscription.decide(before)
            if self._changes.told and next_report > before + CHANGE_REPORT_NS:
                next_service, next_report = before, before + CHANGE_REPORT_NS
            if before >= next_service:  # in the slack after the tick's work
                next_service = before + 200_000_000
                context.service()
            elif context.work():
                pass
            elif before >= next_report:
                next_report = before + 1_000_000_000
                self._report()
        self._report()
        context.finish_work()
        context.event("done", statistics=self.statistics())
        return 0

    def _wait(self) -> int:
        """Wait for the last sample of a tick; the time spent on the earlier ones meanwhile [ns].

        Where there are several earlier ones, they are taken while the last one is still on its way (in real time).
        """
        synchronizer, spent, done = self._synchronizer, 0, 0
        while done < len(self._early) and (done or not synchronizer.waiting):
            self._on_any.wait(WAIT_NS)
            start_time, before = time.monotonic_ns(), done
            while done < len(self._early) and self._gather(self._early[done], start_time):
                done += 1
            spent += time.monotonic_ns() - start_time
            if done == before:  # another one, or nothing has come
                return spent
        (self._on_any if synchronizer.waiting else self._on_trigger).wait(WAIT_NS)
        return spent

    def _gather(self, index: int, steady: int) -> bool:
        """Take a sample of a topic that comes at every tick, if there is one."""
        subscription = self._subscriptions[index]
        if (taken := subscription.take()) is None:
            return False
        if self._clock is not None:
            self._synchronizer.now = self._clock.now(steady)
        source = subscription.sort(taken, steady)
        self._put(index, taken[0], source)
        self._gathered[index] = stamp_of(taken[0]) if not source and len(taken[0]) >= 12 else -1
        return True

    def _drain(self) -> bool:
        """Take what has come; True if a tick was completed.

        The trigger is taken first. It carries the newest stamp, and the other topics are taken up to
        that stamp: no take is spent on asking whether there is more.
        """
        synchronizer, done, steady = self._synchronizer, False, time.monotonic_ns()
        trigger = len(self._subscriptions) - 1
        waiting, newest = [], -1
        while (taken := self._subscriptions[trigger].take()) is not None:
            source = self._subscriptions[trigger].sort(taken, steady)
            waiting.append((taken[0], source))
            newest = stamp_of(taken[0]) if len(taken[0]) >= 12 else newest
            if self._clock is not None and not source and newest > HOLD_STAMP:
                self._clock.note(newest, steady)
        if self._clock is not None:
            synchronizer.now = self._clock.now(steady)
        for index in range(trigger):
            period = synchronizer.parts[index].period_ns
            due = newest - newest % period if newest > 0 else newest
            subscription, gathered = self._subscriptions[index], self._gathered[index]
            seen = gathered if gathered == due else -1
            self._gathered[index] = -1
            while seen < due or newest <= 0:
                taken = subscription.take()
                if taken is None:
                    break
                seen = stamp_of(taken[0]) if len(taken[0]) >= 12 else seen
                done |= self._put(index, taken[0], subscription.sort(taken, steady))
        for data, source in waiting:
            done |= self._put(trigger, data, source)
        return done

    def _put(self, index: int, data: bytes, source: str) -> bool:
        synchronizer = self._synchronizer
        vector = synchronizer.put(index, data, source)
        if vector is None:
            return False
        stamp, changes = synchronizer.stamp, self._changes
        if stamp == HOLD_STAMP:
            if self._start:
                self._begin_again()
        else:
            self._start = self._start or stamp
            changes.now = stamp - self._start
            if changes.now >= changes.due:
                changes.advance(changes.now)
        self._tick(stamp, vector, synchronizer.gap)
        if stamp != HOLD_STAMP:
            self.ticks += 1
        elif self._clock is not None:  # another run begins, on another clock
            self._clock, self._synchronizer.now = PlantClock(), NOT_KNOWN
        return True

    def _begin_again(self) -> None:
        """The plant holds after a run: the next one has the settings of the start and counts of its own."""
        self._report()
        self._context.finish_work()  # the report has the counts of the moment at which it is written
        self._start = self.ticks = 0
        self._changes.restore()
        self._execution, self._period = LatencyHistogram(), LatencyHistogram()
        self._health = LoopHealth(self._context.config.mode == "realtime")
        self._troubles = (0, 0)
        self._synchronizer.begin_again()

    def statistics(self) -> dict[str, str]:
        """Counts and times of the loop."""
        synchronizer = self._synchronizer
        rejected = {f"rejected_{reason}": str(n) for reason, n in sorted(synchronizer.rejected.items())}
        off_grid = {f"off_grid_{self._names[i]}": str(n) for i, n in sorted(synchronizer.off_grid.items()) if n}
        frames = {name: text for sensor in synchronizer.slow.values() for name, text in sensor.statistics().items()}
        return {
            "ticks": str(self.ticks),
            "gap_ticks": str(synchronizer.gaps),
            **self._execution.summary("execution"),
            **rejected,
            **off_grid,
            **frames,
            **self._changes.record(),
        }

    def _report(self) -> None:
        level, message, values = self._health.assess(self.ticks, time.monotonic_ns(), self._execution)
        troubles = (self._synchronizer.gaps, self._synchronizer.rejected.total())
        if level == OK and troubles != self._troubles:
            level, message = WARN, "samples missing or rejected"
        if silent := self._synchronizer.silent():
            level = max(level, WARN)
            message = ", ".join(f"{self._names[i]} silent for {t * 1e-9:.2g} s" for i, t in silent)
        news = troubles[0] - self._troubles[0], troubles[1] - self._troubles[1]
        self._troubles = troubles
        period = {"period_mean_us": f"{self._period.mean_us:.3f}", "period_max_us": f"{self._period.maximum_us:g}"}
        stamp = self._synchronizer.stamp
        self._context.diagnose(level, message, lambda: {**values, **period, **self.statistics()}, stamp)
        self._context.plot(
            lambda: {
                **self._period.window("period"),
                **self._execution.window("execution"),
                "ticks": self.ticks,
                "gap_ticks": news[0],
                "rejected_samples": news[1],
            }
        )
