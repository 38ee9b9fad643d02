"""State of a loop for /diagnostics, with the limits of ros2_control.

Mean rate off by 5 Hz is a warning, by 10 Hz an error; a mean execution time of 1000 us is a warning, of
2000 us an error; a loop without a tick since the last report is stale.
"""

from __future__ import annotations

from los_testbed.run.loop.latency_histogram import LatencyHistogram
from titop_plant.interface import RATE

OK, WARN, ERROR, STALE = range(4)

NOMINAL_HZ = float(RATE)
RATE_WARN_HZ, RATE_ERROR_HZ = 5.0, 10.0
EXECUTION_WARN_US, EXECUTION_ERROR_US = 1000.0, 2000.0


class LoopHealth:
    """Compares a loop with its last report.

    Parameters
    ----------
    paced : bool
        Whether the loop runs at 1 kHz; in lockstep its rate says nothing.

    Examples
    --------
    990 ticks in a second are 10 Hz too few:

    >>> health, busy = LoopHealth(), LatencyHistogram()
    >>> health.assess(0, 0, busy)[:2]
    (3, 'nothing done since the last report')
    >>> health.assess(989, 1_000_000_000, busy)[:2]
    (2, 'mean rate 989.0 Hz instead of 1000 Hz')
    """

    def __init__(self, paced: bool = True) -> None:
        self.paced = paced
        self._last: tuple[int, int, int, int] | None = None

    def assess(self, ticks: int, now_ns: int, execution: LatencyHistogram) -> tuple[int, str, dict[str, str]]:
        """Level, message and values since the last call.

        Parameters
        ----------
        ticks : int
            Ticks so far.
        now_ns : int
            Steady clock [ns].
        execution : LatencyHistogram
            Execution times so far.
        """
        last, self._last = self._last, (ticks, now_ns, execution.count, execution.total_ns)
        if ticks == (0 if last is None else last[0]):
            return STALE, "nothing done since the last report", {}
        if last is None:
            return OK, "running", {}
        rate = (ticks - last[0]) * 1e9 / max(now_ns - last[1], 1)
        calls = execution.count - last[2]
        mean = (execution.total_ns - last[3]) / calls / 1000 if calls else 0.0
        values = {"rate_hz": f"{rate:.1f}", "execution_mean_us": f"{mean:.1f}"}
        off = abs(rate - NOMINAL_HZ) if self.paced else 0.0
        if off > RATE_WARN_HZ:
            level = ERROR if off > RATE_ERROR_HZ else WARN
            return level, f"mean rate {rate:.1f} Hz instead of {NOMINAL_HZ:g} Hz", values
        if mean > EXECUTION_WARN_US:
            return (ERROR if mean > EXECUTION_ERROR_US else WARN), f"mean execution time {mean:.0f} us", values
        return OK, "running", values
