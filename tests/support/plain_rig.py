"""A rig of a few lines, for the supervisor of devices."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from los_testbed.parts.device_contract import Sample
from los_testbed.rig.supervisor import EVERY_TICK

from titop_plant.interface import COLUMNS, GAUGE_PORT


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
