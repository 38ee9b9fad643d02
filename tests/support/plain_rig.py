"""A rig of a few lines, for the supervisor of devices, and such rigs with a fault for whole runs.

A faulty one appends a line to the file that `device_address` names when it is opened, and is at fault a second after
its first command.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from los_testbed.parts.device_contract import Sample
from los_testbed.rig.supervisor import EVERY_TICK

from titop_plant.interface import CAMERA_PORT, COLUMNS, GAUGE_PORT


class PlainRig:
    """Noise of all sensors of every tick, and the mirror at its command; what else comes in a read is in `more`."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(1)
        self.angle = np.zeros(2)
        self.more: list[Sample] = []
        self.called: list[str] = []

    def open(self, config: Any) -> None:
        self.called.append("open")

    def read(self, now_ns: int) -> Sequence[Sample]:
        now_ns = max(now_ns, time.monotonic_ns())
        found = [Sample(port, now_ns, self.noise(port) + self.at(port)) for port in EVERY_TICK]
        more, self.more = self.more, []
        return [*found, *more]

    def noise(self, port: str) -> Any:
        return self.rng.normal(0.0, 1e-8, COLUMNS[port].stop - COLUMNS[port].start)

    def at(self, port: str) -> Any:
        return self.angle if port == GAUGE_PORT else 0.0

    def write(self, command: Any, now_ns: int) -> None:
        self.called.append("write")
        self.angle = command[:2].copy()

    def safe(self) -> None:
        self.called.append("safe")
        self.angle = np.zeros(2)

    def close(self) -> None:
        self.called.append("close")


class FaultyRig(PlainRig):
    """With frames, and a fault in `read`."""

    def open(self, config: Any) -> None:
        super().open(config)
        with Path(config.device_address).open("a") as file:
            file.write("opened\n")
        self.period_ns = round(1e9 / config.camera_rate)
        self.frame_ns, self.first_ns = time.monotonic_ns(), 0

    def write(self, command: Any, now_ns: int) -> None:
        super().write(command, now_ns)
        self.first_ns = self.first_ns or time.monotonic_ns()

    def read(self, now_ns: int) -> Sequence[Sample]:
        if (now := time.monotonic_ns()) >= self.frame_ns:
            self.more.append(Sample(CAMERA_PORT, self.frame_ns, self.noise(CAMERA_PORT)))
            self.frame_ns += self.period_ns * (1 + (now - self.frame_ns) // self.period_ns)
        return self.faulty() if self.first_ns and now > self.first_ns + 10**9 else super().read(now_ns)

    def faulty(self) -> Any:
        """What a read gives from the fault on."""
        return super().read(0)


class Dying(FaultyRig):
    """The process ends."""

    def faulty(self) -> Any:
        os._exit(7)


class Returning(FaultyRig):
    """None in the place of samples."""

    def faulty(self) -> Any:
        return None


class Hanging(FaultyRig):
    """A call that does not return."""

    def faulty(self) -> Any:
        while not self.called.count("safe"):
            time.sleep(0.1)
        return super().faulty()


class HangingForGood(FaultyRig):
    """A call that does not return, and no signal reaches it."""

    def faulty(self) -> Any:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM, signal.SIGINT})
        time.sleep(3600.0)


class Late(FaultyRig):
    """Samples of 5 ms before."""

    def faulty(self) -> Any:
        return [Sample(s.port, s.acquired_ns - 5_000_000, s.values) for s in super().faulty()]


class WithoutFrames(FaultyRig):
    """No frame of the camera, ever."""

    def read(self, now_ns: int) -> Sequence[Sample]:
        return [sample for sample in super().read(now_ns) if sample.port != CAMERA_PORT]
