"""Plant node: keeps the time, publishes sensors and truth, applies the commands of the previous tick.

Tick k of the real-time loop: take the commands computed from tick k - 1, pass them through the gates, step the plant,
and publish at the deadline. Commands shortly before the deadline are taken early; if both have arrived, the plant is
stepped early, too, else at the deadline. Tick k is always k ms of the steady clock after the first one: over lost
periods the plant is integrated with its last command, and their samples are not sent. In lockstep the node waits for
both commands of the published tick instead of the clock, and ``/clock`` follows the ticks.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.support.threads import one_thread
from los_testbed.config.plugins import RAISED, in_one_line, made_by
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import UNSENT_TICKS
from los_testbed.nodes.support.exercise import exercise
from los_testbed.nodes.support.follower import SERVICE_NS
from los_testbed.nodes.support.handshake import OtherPlants, wait_for_followers
from los_testbed.nodes.support.lockstep import LockstepPacer
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.nodes.support.plant_io import PlantIo
from los_testbed.nodes.support.run_services import OVER, WAITING, RunServices
from los_testbed.parts.image_camera import frame_counts, image_camera_of
from los_testbed.parts.run_parts import RunParts, build_plant
from los_testbed.parts.stepped_plant import SteppedPlant, plant_notes
from los_testbed.parts.user_blocks import BlockFailedError, beyond, watched
from los_testbed.run.identity import DIGEST, announced
from los_testbed.run.loop.changes import NAMES, RESET, STOP, Apply
from los_testbed.run.loop.closed_loop import SIMULATED_START_NS, LoopDivergedError, aligned_start
from los_testbed.run.loop.compiled_loop import compile_telescope
from los_testbed.run.loop.contract import RunFailedError, check_plant
from los_testbed.run.loop.health import ERROR, OK, WARN, LoopHealth
from los_testbed.run.loop.latency_histogram import LatencyHistogram
from los_testbed.run.loop.tick_clock import TickClock
from los_testbed.run.results import Exercised, RunError, check_missed, in_statistics
from pointing_analysis.command.exit_codes import ExitCode
from pointing_analysis.read.run_end import AFTER, OUTSIDE, PLANNED, missed_share
from pointing_analysis.read.unsent import UNSENT
from titop_plant.interface import RATE, TICK_NS, TRUTH

RING = 64

TRIALS = 2
"""Trials of the loop before it is considered too slow."""

OWN_PLANT = "start must be rest in every node for a plant other than the telescope, got steady"

EARLY_NS = 250_000, 120_000
"""Lead before the deadline of a tick at which commands are taken. With both, the plant is stepped: the simulation is
not part of the loop, and the sensors' samples are sent at the deadline."""

SLOW_STEPS = 1000
"""Steps over lost periods after which the backlog must have decreased."""

CLOCK_TICKS = 10
"""Ticks from one message on ``/clock`` to the next in lockstep: every node spends time on each of them."""

CLOCK_STEP_NS = 1_000_000_000
"""The middleware stamps arrivals with the wall clock: a longer latency than this [ns] is a step of that clock."""


def main(arguments: Sequence[str] | None = None, build: Callable[[RunConfig], SteppedPlant] = build_plant) -> int:
    """Run the node; returns the exit code."""

    def body(context: NodeContext) -> int:
        others = OtherPlants(context)
        context.event("alone")
        by_user, command = build is not build_plant, None
        if context.config.device:
            raise InputError(
                f"device must be absent for the node plant, got {context.config.device}: use the node device"
            )
        parts = RunParts(context.config)
        plant = made_by(build, parts.config, "plant") if by_user else parts.plant()
        if by_user or context.config.plant:
            check_plant(plant, parts.ports)
        if not by_user:
            command = parts.start.command
        elif context.config.start != "rest":
            context.event("warning", message=OWN_PLANT)
            context.warn_alone([OWN_PLANT])
        compile_telescope(plant, context.config.ticks)
        with one_thread():
            return PlantLoop(context, plant, command, "" if by_user else announced(parts)["plant"]).run(others)

    return run_node("plant", arguments, body)


class PlantLoop:
    """The loop of the plant node.

    Parameters
    ----------
    context : NodeContext
        The node.
    plant : SteppedPlant
        The simulated telescope.
    first_command : ndarray, optional
        Command that the first tick applies [rad, N]; default: zero.
    digest : str
        By which the node announces the plant (:func:`los_testbed.run.identity.announced`); of another one empty.
    """

    def __init__(
        self, context: NodeContext, plant: SteppedPlant, first_command: FloatArray | None = None, digest: str = ""
    ) -> None:
        self.context = context
        self.plant = plant
        self._first_command = first_command
        self._digest = digest
        self.io = PlantIo(context)
        self._pacer = LockstepPacer(context, self.io) if context.config.mode == "lockstep" else None
        self._begin_counts()
        self._woke = [0] * RING
        self._command = np.zeros(self.io.ports.commands)
        self._measurement = np.zeros(self.io.ports.measurements)
        self._truth = np.zeros(TRUTH)
        self._camera = image_camera_of(plant)
        self._image = None if self._camera is None else self._camera.image.ravel()
        change = getattr(plant, "change", None)
        appliers: dict[str, Apply] = {STOP: context.end, RESET: self._ask_again}
        if change is not None:
            appliers.update({name: partial(change, name) for name in NAMES["plant"] if name not in appliers})
        self.changes = context.allow_changes(appliers)
        self.services = RunServices(context.node, self.changes, context.config.wait_for_start, context.requesters)
        self._again = False
        self._exercised: Exercised | None = None

    def _begin_counts(self) -> None:
        """Counts and times of a run."""
        self.ticks = 0
        self.held = 0
        self.lost = 0
        self.unsent: Counter[str] = Counter()
        self._pending: Counter[str] = Counter()
        self.sent = 0
        self._next_report = 0
        self.clock = TickClock(TICK_NS)
        self.lateness = LatencyHistogram()
        self.latency = LatencyHistogram()
        self.execution = LatencyHistogram()
        self.period = LatencyHistogram()
        self.health = LoopHealth(self.context.config.mode == "realtime")
        self._reported: tuple[int, int] = (0, 0)
        self._faded = False
        self._second = ""

    def run(self, others: OtherPlants) -> int:
        """Run, unless another plant is active, and again after every reset."""
        context = self.context
        context.become_real_time()
        context.all_listed()
        wait_for_followers(
            context, self.io, lambda: self.services.may_begin, others.refuse_running, meanwhile=self._meanwhile
        )
        others.close()
        if context.config.exercise and context.config.mode == "realtime" and not self._keeps_pace():
            context.event("done", statistics={})
            return 0
        while True:
            if context.stop:
                context.event("done", statistics={})
                return 0
            self.services.begin()
            self._run_once()
            if not self._again or context.stop:
                break
            context.event("reset")
            self._again, self.services.state = False, WAITING
            self.changes.restore()
            self._begin_counts()
            self.io.forget()
            wait_for_followers(context, self.io, lambda: self.services.may_begin, meanwhile=self._meanwhile)
        self.services.state = OVER
        context.event("done", statistics=self.statistics(), latency=self.latency.histogram())
        if beyond(self._truth).any():
            raise LoopDivergedError(f"the loop diverged within the first {self.ticks} ms")
        if self._pacer is not None and self._pacer.hang:
            raise RunError(self._pacer.hang, ExitCode.RESTARTED)
        if not context.process.tells:  # a runner judges the run by its record
            check_missed(missed_share(self.statistics()), context.config)
        return 0

    def _keeps_pace(self) -> bool:
        """Whether the loop under trial meets its deadlines; a single stall of the machine does not count."""
        config = self.context.config
        for trial in range(TRIALS):
            self._exercised = measured = exercise(self.context, self.io, config.exercise)
            if measured.share <= config.max_missed or self.context.stop:
                return True
            if trial == TRIALS - 1:
                self.context.event("too_slow", **asdict(measured))
        return False

    def _ask_again(self, value: bool) -> None:
        self._again = True

    def _meanwhile(self) -> None:
        """Work every 20 ms before a run: none for a simulated telescope."""

    @property
    def _ended(self) -> bool:
        """Whether the run is to end before its time."""
        return self.context.stop or self._again

    def _run_once(self) -> None:
        """The ticks of a run and the last report."""
        context, config = self.context, self.context.config
        period = RunParts(config).ports.period
        watched(self.plant.reset, "reset")()
        if config.mode == "lockstep":
            start = aligned_start(SIMULATED_START_NS, period)
        else:
            start = aligned_start(time.time_ns() + 20_000_000, period)
            self.clock.begin(time.monotonic_ns() + start - time.time_ns())
        self.io.begin(start, self._first_command)
        context.event("running", start_ns=start)
        if self._pacer is not None:
            self._lockstep(start, self._pacer)
        else:
            self._real_time(start)
        self.io.settle()
        self._report(start + self.ticks * TICK_NS, last=True)
        context.finish_work()

    @property
    def missed(self) -> int:
        """Ticks sent with an older command, and lost periods; at most all ticks."""
        return self.held + self.lost

    def _real_time(self, start: int) -> None:
        context, clock = self.context, self.clock
        total, last = context.config.ticks, 0
        while True:
            k = self.ticks
            now = start + k * TICK_NS
            self._take_early(now)
            over, early = k >= total or self._ended, 0
            stepped = not over and self.io.fresh(now)
            if stepped:
                start_time = time.monotonic_ns()
                self._step(now)
                early = time.monotonic_ns() - start_time
            late = clock.wait()
            self.lateness.add(late)
            start_time = time.monotonic_ns()
            if last:
                self.period.add(start_time - last)
            last = start_time
            self._woke[k % RING] = time.time_ns()
            if not self.io.fresh(now):
                self._take_commands(now)
            if over:  # one more wake-up, for the commands of the last tick
                break
            if not stepped:
                self._step(now)
            if late >= TICK_NS:
                self._catch_up(start)
                if self.ticks >= total:
                    continue
                now = start + self.ticks * TICK_NS
                self._woke[self.ticks % RING] = time.time_ns()
            self.held += not self.io.fresh(now)
            self._publish(now)
            self.execution.add(time.monotonic_ns() - start_time + early)
            if self._camera is not None:
                self._camera.work()
            self._background(now)

    def _catch_up(self, start: int) -> None:
        """Integrate over lost periods up to the current one; the last step can be published unless its period is over.

        Raises
        ------
        RunFailedError
            Steps take longer than ticks: the plant would never catch up.
        """
        clock, total, steps = self.clock, self.context.config.ticks, 0
        entered, behind = time.monotonic_ns(), clock.present() - self.ticks
        while self.ticks < min(clock.present(), total):
            self._lose(start + self.ticks * TICK_NS)
            if self.ticks < total:
                self._step(start + self.ticks * TICK_NS)
            steps += 1
            clock.pauses.take()
            if steps % SLOW_STEPS == 0 and clock.present() - self.ticks >= behind:
                spent = (time.monotonic_ns() - entered) / steps / 1e6
                raise RunFailedError(f"a plant step must take less than 1 ms in real time, got {spent:.2g} ms")
        clock.resume_at(self.ticks + 1)

    def _lose(self, now: int) -> None:
        """Count a tick of which no sample is sent, with the slower samples that were due."""
        self.ticks += 1
        self.lost += 1
        self._pending.update((UNSENT_TICKS, *self.io.framed_at(now)))

    def _take_early(self, now: int) -> None:
        """Take the commands that came before the deadline."""
        for lead in EARLY_NS:
            self.clock.sleep(lead)
            self._take_commands(now)
            if self.io.fresh(now):
                return

    def _take_commands(self, now: int) -> None:
        """Offer all commands that arrived to the gates; count the latency of the mirror commands."""
        self.io.take(now, time.monotonic_ns(), self._note_latency)

    def _note_latency(self, stamp: int, received: int) -> None:
        """Count the time from the samples of a tick to the arrival of its mirror command."""
        latency = received - self._woke[(stamp - self.io.start) // TICK_NS % RING]
        if 0 <= latency < CLOCK_STEP_NS:
            self.latency.add(latency)

    def _step(self, now: int) -> None:
        """Changes, commands and plant of a tick."""
        io, command, changes = self.io, self._command, self.changes
        changes.now = now - io.start
        try:
            if changes.now >= changes.due:
                changes.advance(changes.now)
            io.apply(now, command)
            self.plant.step(command, self._measurement, self._truth)
            io.pack(now, self._measurement)
        except BlockFailedError:  # its message has the cause
            raise
        except RAISED as error:
            raise RunFailedError(f"failed at tick {self.ticks}: {in_one_line(error)}") from error

    def _publish(self, now: int) -> None:
        """Sensors and truth of a tick."""
        self.io.publish(now, self._measurement, self._truth, self._image)
        self.ticks += 1
        self._count_sent()

    def _count_sent(self) -> None:
        """A tick whose samples were sent: periods lost before it are missing between samples."""
        if self._pending:
            if self.sent:  # no sample is missing before the first one
                self.unsent.update(self._pending)
            self._pending.clear()
        self.sent += 1

    def _background(self, now: int) -> None:
        """Background work, one kind per published tick, after its urgent work."""
        phase = (self.sent - 1) % 200
        if self.context.work():
            return
        if phase % 20 == 10 and (news := self.io.watch.look(time.monotonic_ns())):
            self._second = f"second publisher on {news[0][0]}"
            self.context.report_second_publishers(news)
            self._report(now)
        elif phase == 50 or phase == 150:
            self.context.event("progress", tick=self.ticks)
        elif phase == 100:
            self.context.service()
        elif phase % 20 == 15 and self.io.fading() != self._faded:
            self._report(now)  # reported at once, not at the end of the second
        elif self.ticks > self._next_report:
            self._next_report = self.ticks - self.ticks % RATE + RATE
            self._report(now)

    def _lockstep(self, start: int, pacer: LockstepPacer) -> None:
        context, total = self.context, self.context.config.ticks
        pacer.begin()
        next_service = 0
        for k in range(total):
            now = start + k * TICK_NS
            if k % CLOCK_TICKS == 0:
                pacer.clock(now)
            start_time = time.monotonic_ns()
            self._step(now)
            self._publish(now)
            if not pacer.wait(now) or self._again:
                break
            end = time.monotonic_ns()
            self.latency.add(end - start_time)
            context.alive(tick=self.ticks)
            if k % 20 == 0:
                context.report_second_publishers(self.io.watch.look(time.monotonic_ns()))
            if k % 100 == 0 or end >= next_service:  # ticks may take long, on a busy machine or with images
                next_service = end + SERVICE_NS
                context.event("progress", tick=self.ticks)
                context.service()
            if k % RATE == 0:
                self._report(now)
            context.work()
        if self.ticks:
            pacer.wait_for_recorder(start + (self.ticks - 1) * TICK_NS)
        context.event("progress", tick=self.ticks)

    def statistics(self) -> dict[str, str]:
        """Counts and times of the loop."""
        lockstep = self.context.config.mode == "lockstep"
        outside = self.ticks - self.sent - self.unsent[UNSENT_TICKS]
        return {
            **({DIGEST: self._digest} if self._digest else {}),
            "ticks": str(self.ticks),
            PLANNED: str(self.context.config.ticks),
            "missed_ticks": str(self.missed),
            "lost_periods": str(self.lost),
            **{f"{UNSENT}{name}": str(count) for name, count in sorted(self.unsent.items())},
            **({OUTSIDE: str(outside)} if outside else {}),
            **({AFTER: str(self._pending[UNSENT_TICKS])} if self.sent and self._pending[UNSENT_TICKS] else {}),
            **(self.latency.summary("turnaround" if lockstep else "latency")),
            **({} if lockstep else self.lateness.summary("lateness")),
            **({} if lockstep else {"period_mean_us": f"{self.period.mean_us:.3f}"}),
            **({} if lockstep else {"period_max_us": f"{self.period.maximum_us:g}"}),
            **self.execution.summary("execution"),
            **({} if self._exercised is None else in_statistics(self._exercised)),
            **self.io.rejections(),
            **self.io.watch.statistics(),
            **self.changes.record(),
            **plant_notes(self.plant),
            **frame_counts(self.plant),
        }

    def _report(self, now: int, last: bool = False) -> None:
        """Level by what happened since the last report."""
        rejected = self.io.rejected_total()
        news = (self.missed - self._reported[0], rejected - self._reported[1])
        self._reported = (self.missed, rejected)
        level, message, values = self.health.assess(self.ticks, time.monotonic_ns(), self.execution)
        self._faded = self.io.fading()
        if self._faded:
            level, message = ERROR, "no valid commands: the last ones fade to zero"
        elif self._second:
            level, message, self._second = ERROR, self._second, ""
        elif news[1]:
            level, message = WARN, f"{news[1]} commands rejected"
        elif news[0] > 10:
            level, message = ERROR, f"{news[0]} ticks missed"
        elif news[0]:
            level, message = max(level, WARN), f"{news[0]} ticks missed"
        elif last:
            level, message = OK, "finished"
        self.context.diagnose(level, message, lambda: {**values, **self.statistics()}, now)
        self.context.plot(lambda: self._plotted(news))

    def _plotted(self, news: tuple[int, int]) -> dict[str, float]:
        """Values since the last report: `news` are missed ticks and rejected commands."""
        return {
            **self.period.window("period"),
            **self.lateness.window("lateness"),
            **self.latency.window("latency"),
            **self.execution.window("execution"),
            "ticks": self.ticks,
            "missed_ticks": news[0],
            "rejected_commands": news[1],
            "actuators_faded": float(self._faded),
        }


if __name__ == "__main__":
    sys.exit(main())
