"""Times of another clock on the steady clock of this host, from requests that the other clock has answered."""

from __future__ import annotations

from collections import deque

import numpy as np

WINDOW = 200
"""Answers that count, the newest ones."""


JUMP_NS = 5_000_000
"""Deviation of an answer from the line, beyond both errors, that indicates a clock step: older answers are dropped."""


class ClockMap:
    """Offset and drift of another clock.

    An answer with the shortest round trip is best: half of it bounds the error of the offset. The offset is a straight
    line through the best half of the newest answers.

    Examples
    --------
    A clock that is 7 s ahead and 50 ppm fast, with a way of 0.1 ms each way:

    >>> clocks = ClockMap()
    >>> for k in range(100):
    ...     sent = k * 100_000_000
    ...     clocks.answer(sent, 7_000_000_000 + round((sent + 100_000) * 1.00005), sent + 200_000)
    >>> round(clocks.drift_ppm, 1), abs(clocks.to_host(7_000_000_000 + round(5e9 * 1.00005)) - 5_000_000_000) < 1000
    (50.0, True)
    """

    def __init__(self) -> None:
        self._answers: deque[tuple[int, int, int]] = deque(maxlen=WINDOW)
        self._reference = 0
        self._offset = 0.0
        self._rate = 0.0
        self.way_us = float("nan")
        self.jumps = 0

    @property
    def known(self) -> bool:
        """Whether there was an answer."""
        return bool(self._answers)

    @property
    def drift_ppm(self) -> float:
        """Drift of the other clock, positive if it is fast [1e-6]."""
        return 1e6 * self._rate

    @property
    def offset_ms(self) -> float:
        """Offset of the other clock, positive if it is ahead, at the newest answer [ms]."""
        return self._offset / 1e6

    def answer(self, sent_ns: int, other_ns: int, received_ns: int) -> None:
        """Add an answer: sent and received by the clock of this host, the time between by the other one."""
        known_to = JUMP_NS + (max(0, received_ns - sent_ns) + 1e3 * max(0.0, self.way_us)) / 2
        if self._answers and abs(other_ns - self._offset_at(other_ns) - (sent_ns + received_ns) / 2) > known_to:
            self._answers.clear()
            self.jumps += 1
        self._answers.append((received_ns - sent_ns, other_ns - (sent_ns + received_ns) // 2, other_ns))
        ways = np.array([way for way, _, _ in self._answers], float)
        best = ways <= np.median(ways)
        times = np.array([other for _, _, other in self._answers])[best]
        offsets = np.array([offset for _, offset, _ in self._answers])[best]
        self._reference, base = int(times[-1]), int(offsets[-1])
        x, y = (times - self._reference).astype(float), (offsets - base).astype(float)
        self.way_us = float(ways[best].mean()) / 1e3
        self._rate = 0.0
        if len(x) > 10 and np.ptp(x) > 1e9:
            self._rate = float(np.sum((x - x.mean()) * (y - y.mean())) / np.sum((x - x.mean()) ** 2))
        self._offset = base + float(y.mean() - self._rate * x.mean())

    def to_host(self, other_ns: int) -> int:
        """The same time on the steady clock of this host [ns]."""
        return other_ns - round(self._offset_at(other_ns))

    def _offset_at(self, other_ns: int) -> float:
        return self._offset + self._rate * (other_ns - self._reference)
