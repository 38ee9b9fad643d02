"""Commands on their way to the actuators: checked, counted, held, and faded out when they stop."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np

from fsm_pma_controller.fade import fade_weights
from lftkit.arrays import FloatArray
from los_testbed.bags.cdr import Codec, CodecError
from los_testbed.run.loop.source_guard import OURS
from titop_plant.interface import TICK_NS


class CommandGate:
    r"""Gate of one command topic.

    A command is accepted if it can be read, is finite, within the actuator's limit and stamped with a
    tick that is newer than the last accepted one, not in the future and not older than the hold time. Reasons are
    checked in this order, and the first one counts; a publisher that is not matched comes before the last two.
    Without a valid command the last one is held for `hold_ticks` and then faded to zero along a raised
    cosine of `fade_ticks`; when commands return they fade in along the same ramp, so there is no jump.

    Parameters
    ----------
    codec : Codec
        Bytes of the topic.
    limit : float
        Largest magnitude of each value [rad] or [N]; **the sender saturates, larger values are rejected**.
    hold_ticks, fade_ticks : int
        Times above in ticks.

    Examples
    --------
    >>> gate = CommandGate(Codec("geometry_msgs/msg/Vector3Stamped", 2, "fsm"), 5.3e-3)
    >>> gate.offer(b"\x00\x01", now_ns=2_000_000), gate.rejected["size"]
    (False, 1)
    """

    def __init__(self, codec: Codec, limit: float, hold_ticks: int = 20, fade_ticks: int = 20) -> None:
        self.codec = codec
        self.limit = limit
        self.hold_ticks = hold_ticks
        self.fade_ticks = fade_ticks
        self.rejected: Counter[str] = Counter()
        self.accepted = 0
        self.last_stamp = 0
        self._candidate = np.zeros(codec.size)
        self._held = np.zeros(codec.size)
        self._magnitude = np.zeros(codec.size)
        self._ramp = fade_ticks
        self._weights = fade_weights(fade_ticks)

    def offer(self, data: bytes, now_ns: int, source: str = OURS) -> bool:
        """Take one message at the tick `now_ns`; True if it is the valid command of an earlier tick.

        `source` is what :class:`~los_testbed.run.loop.source_guard.SourceGuard` says of the message; unless it is empty
        it is the reason of a rejection.
        """
        try:
            stamp = self.codec.decode(data, self._candidate)
        except CodecError as error:
            self.rejected[error.reason] += 1
            return False
        return self._judge(stamp, now_ns, source)

    def offer_values(self, stamp: int, values: FloatArray, now_ns: int, source: str = OURS) -> bool:
        """Take values (size,) that came with those of other gates in one message, as :meth:`offer`."""
        self._candidate[:] = values
        return self._judge(stamp, now_ns, source)

    def _judge(self, stamp: int, now_ns: int, source: str) -> bool:
        """Hold the candidate, or reject it."""
        reason = self._fault(stamp, now_ns, source)
        if reason:
            self.rejected[reason] += 1
            return False
        self._held[:] = self._candidate
        self.last_stamp = stamp
        self.accepted += 1
        return True

    def _fault(self, stamp: int, now_ns: int, source: str) -> str:
        """Reason to reject the candidate: its values are checked before its stamp."""
        largest = float(np.abs(self._candidate, out=self._magnitude).max())
        if not largest <= self.limit:
            return "limit" if math.isfinite(largest) else "not_finite"
        if stamp % TICK_NS:
            return "off_grid"
        if stamp >= now_ns:
            return "future"
        if source:
            return source
        if stamp == self.last_stamp:
            return "duplicate"
        if stamp < self.last_stamp or stamp < now_ns - (self.hold_ticks + 1) * TICK_NS:
            return "late"
        return ""

    def fresh(self, now_ns: int) -> bool:
        """Whether the held command is the one computed from the tick before `now_ns`."""
        return self.last_stamp == now_ns - TICK_NS

    @property
    def weights(self) -> tuple[float, ...]:
        """Factors of the held command from the end of the fade to its beginning."""
        return tuple(self._weights)

    @property
    def fading(self) -> bool:
        """Whether the output is less than the held command."""
        return self._ramp < self.fade_ticks

    def apply(self, now_ns: int, out: FloatArray) -> None:
        """Write the command of this tick into `out`; called once per tick."""
        if now_ns - self.last_stamp > (self.hold_ticks + 1) * TICK_NS:
            self._ramp = max(0, self._ramp - 1)
        elif self._ramp < self.fade_ticks:
            self._ramp += 1
        np.multiply(self._held, self._weights[self._ramp], out=out)

    def begin(self, start_ns: int, command: FloatArray | None = None) -> None:
        """Reset: a run begins at `start_ns` with a command (default zero) that counts as just received."""
        self._held[:] = 0.0 if command is None else command
        self.last_stamp = start_ns - TICK_NS
        self._ramp = self.fade_ticks
