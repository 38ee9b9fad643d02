"""Loop of the plant node with a device instead of the simulated telescope.

Tick k: at the deadline, never earlier, the commands of tick k - 1 pass the gates and are written to the device, and its
new samples are read and published. A lost period is not made up for.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import numpy as np

from lftkit.errors import InputError
from los_testbed.config.topics import CAMERA_LOS, UNSENT_TICKS
from los_testbed.nodes.plant import RING, PlantLoop
from los_testbed.nodes.support.handshake import OtherPlants
from los_testbed.nodes.support.node_context import NodeContext, run_node
from los_testbed.parts.device_contract import TRUTH_PORT, DeviceError, make_device
from los_testbed.parts.run_parts import RunParts
from los_testbed.rig.supervisor import Supervisor, as_stamp, refused_in_words
from pointing_analysis.read.unsent import UNSENT
from pointing_analysis.requirements.verdict import FAULT_STAMP
from titop_plant.interface import TICK_NS

FIRST_NS, DRAIN_NS = 2 * TICK_NS, 5 * TICK_NS
"""Before the first tick the device is polled at this interval; samples older than it at that tick are discarded."""


HELD_WITHOUT = "held_without_samples"
"""Statistic: ticks that held their command since the one before had no samples of all sensors. The loop has not missed
them: there was no trigger."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node, which has the name of the plant; returns the exit code."""

    def body(context: NodeContext) -> int:
        if not context.config.device:
            raise InputError("device must be MODULE:NAME or an entry point, got none")
        device = Supervisor(make_device(RunParts(context.config).config), context.config)
        others = OtherPlants(context)
        context.event("alone")
        device.open()
        try:
            return DeviceLoop(context, device).run(others)
        finally:
            device.finish()

    return run_node("plant", arguments, body)


class DeviceLoop(PlantLoop):
    """The loop of the plant node with a device.

    Parameters
    ----------
    context : NodeContext
    device : Supervisor
        It is open.
    """

    _answerable: bool
    """Whether the last tick had samples of all sensors."""

    _acquired: list[int]
    """Times of acquisition by tick [ns]."""

    def __init__(self, context: NodeContext, device: Supervisor) -> None:
        super().__init__(context, device)  # type: ignore[arg-type]  # it is not stepped
        self.device = device

    def run(self, others: OtherPlants) -> int:
        """Run; afterwards the actuators are at zero in any case, or the error says that they are not."""
        try:
            return super().run(others)
        except DeviceError:
            self._report(self.io.start + self.ticks * TICK_NS)
            raise
        finally:
            self.device.finish()

    def _run_once(self) -> None:
        self.device.await_first()
        try:
            super()._run_once()
        finally:
            texts = refused_in_words(self.device.counts)
            for message in texts:
                self.context.event("warning", message=message)
            self.context.warn_alone(texts)

    def _meanwhile(self) -> None:
        """Read the rig before the run: unread samples would be lost, and its clock would not be tracked."""
        self.device.drain()

    def _await_first(self) -> None:
        """Read up to the first tick, where the counts begin."""
        while (rest := self.clock.first - FIRST_NS - time.monotonic_ns()) > 0:
            time.sleep(min(rest, DRAIN_NS) * 1e-9)
            self.device.drain()
        self.device.reset()

    def _real_time(self, start: int) -> None:
        context, clock, io, device = self.context, self.clock, self.io, self.device
        total = context.config.ticks
        self._await_first()
        while True:
            late = clock.wait()
            self.lateness.add(late)
            lost = min(late // TICK_NS, total - self.ticks)
            for _ in range(lost):
                self._lose(start + self.ticks * TICK_NS)
            k = self.ticks
            now, woke = start + k * TICK_NS, time.monotonic_ns()
            self._woke[k % RING] = time.time_ns()
            self._take_commands(now)
            if not io.fresh(now):
                self.held += self._answerable
                self._unanswerable += not self._answerable
            if k >= total or self._ended:
                break
            self._advance(now)
            complete = device.read(woke)
            self._acquired[k % RING] = device.acquired_ns
            frames = {
                sample.port: (as_stamp(sample.acquired_ns, clock.first, start), sample.values)
                for sample in device.frames
                # frames acquired before the run are not recorded; the truth has the stamp of its tick
                if sample.port == TRUTH_PORT or sample.acquired_ns >= clock.first
            }
            io.publish_samples(now, device.measurement if complete else None, frames, TRUTH_PORT)
            self._frames += len(frames.keys() - {TRUTH_PORT})
            self.ticks += 1
            self._answerable = complete
            if complete:
                self._count_sent()
            else:
                self._pending[UNSENT_TICKS] += 1
            self.execution.add(time.monotonic_ns() - woke)
            self._background(now)
        if self._again and not context.stop:
            device.write(np.zeros_like(self._command), time.monotonic_ns())
        else:
            device.finish()  # before the last report, which states mirror and forces

    def _begin_counts(self) -> None:
        super()._begin_counts()
        self._frames = self._unanswerable = 0
        self._answerable = True
        self._acquired = [0] * RING

    def _advance(self, now: int) -> None:
        """Changes and commands of a tick."""
        io, command, changes = self.io, self._command, self.changes
        changes.now = now - io.start
        if changes.now >= changes.due:
            changes.advance(changes.now)
        io.apply(now, command)
        self.device.write(command, time.monotonic_ns())
        answered = (min(one.gate.last_stamp for one in io.commands) - io.start) // TICK_NS
        if answered >= 0 and self.ticks - answered < RING:
            self.device.answered(self._acquired[answered % RING])

    def statistics(self) -> dict[str, str]:
        """Counts and times of the loop and of the device."""
        missing = self.ticks // self.device.frame_ticks - self._frames
        frames = {f"{UNSENT}{CAMERA_LOS.name}": str(missing)} if missing > 0 else {}
        held = {HELD_WITHOUT: str(self._unanswerable)} if self._unanswerable else {}
        since = as_stamp(self.device.fault_ns, self.clock.first, self.io.start)
        fault = {FAULT_STAMP: str(since)} if self.device.fault else {}
        return {**super().statistics(), **held, **frames, **self.device.statistics(), **fault}


if __name__ == "__main__":
    sys.exit(main())
