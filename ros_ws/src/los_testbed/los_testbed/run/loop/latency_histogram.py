"""Histogram of durations of fixed size: count, mean, quantiles and maximum without keeping single values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray


class LatencyHistogram:
    """Histogram of durations with 1 microsecond cells up to 20 ms; longer ones share the last cell.

    Examples
    --------
    >>> durations = LatencyHistogram()
    >>> for microseconds in (100, 200, 300):
    ...     durations.add(microseconds * 1000)
    >>> durations.quantiles_us((0.5, 0.9)), durations.maximum_us
    ([200.0, 300.0], 300.0)
    """

    CELLS = 20_000

    def __init__(self) -> None:
        self.cells: NDArray[np.int64] = np.zeros(self.CELLS, np.int64)
        self._cells = memoryview(self.cells)  # type: ignore[arg-type, unused-ignore]
        self.count = 0
        self.total_ns = 0
        self.maximum_ns = 0
        self._window = (0, 0)
        self._window_maximum_ns = 0

    def add(self, duration_ns: int) -> None:
        """Count one duration [ns]; negative ones (a stepped clock) count as zero."""
        cell = duration_ns // 1000
        self._cells[0 if cell < 0 else cell if cell < self.CELLS else self.CELLS - 1] += 1
        self.count += 1
        self.total_ns += duration_ns
        if duration_ns > self.maximum_ns:
            self.maximum_ns = duration_ns
        if duration_ns > self._window_maximum_ns:
            self._window_maximum_ns = duration_ns

    def window(self, name: str) -> dict[str, float]:
        """Mean and longest [us] of those that were added since the last call, NaN if there were none.

        Examples
        --------
        >>> durations = LatencyHistogram()
        >>> durations.add(3000), durations.window("execution")
        (None, {'execution_mean_us': 3.0, 'execution_max_us': 3.0})
        >>> durations.window("execution")
        {'execution_mean_us': nan, 'execution_max_us': nan}
        """
        count, total = self.count - self._window[0], self.total_ns - self._window[1]
        longest = self._window_maximum_ns / 1000 if count else float("nan")
        self._window, self._window_maximum_ns = (self.count, self.total_ns), 0
        return {f"{name}_mean_us": total / count / 1000 if count else float("nan"), f"{name}_max_us": longest}

    @property
    def maximum_us(self) -> float:
        """Longest one [us]."""
        return self.maximum_ns / 1000

    @property
    def mean_us(self) -> float:
        """Mean [us]; NaN without data."""
        return self.total_ns / self.count / 1000 if self.count else float("nan")

    def quantiles_us(self, probabilities: Sequence[float]) -> list[float]:
        """For each probability the smallest cell that this share of the durations does not exceed [us], or NaN."""
        if not self.count:
            return [float("nan")] * len(probabilities)
        last = min(self.maximum_ns // 1000, self.CELLS - 1)
        below = self.cells[: last + 1].cumsum()
        ranks = [max(1, math.ceil(probability * self.count)) for probability in probabilities]
        cells = below.searchsorted(ranks).tolist()
        return [float(cell) if cell < self.CELLS - 1 else self.maximum_us for cell in cells]

    def histogram(self) -> dict[int, int]:
        """Cells [us] that are not empty, and how many durations fell into each."""
        return {int(cell): int(self.cells[cell]) for cell in np.flatnonzero(self.cells)}

    def summary(self, name: str) -> dict[str, str]:
        """Median, tail and extreme as diagnostic values."""
        median, p99, p999 = self.quantiles_us((0.5, 0.99, 0.999))
        return {
            f"{name}_median_us": f"{median:g}",
            f"{name}_p99_us": f"{p99:g}",
            f"{name}_p999_us": f"{p999:g}",
            f"{name}_max_us": f"{self.maximum_us:g}",
        }


def text_of_shares(shares: Iterable[float]) -> str:
    """Shares of the ticks by a whole number of ticks, as statistics of a run hold them; rare ones are left out.

    Examples
    --------
    >>> text_of_shares([0.0, 0.00001, 0.75, 0.25])
    '2:0.7500 3:0.2500'
    """
    return " ".join(f"{ticks}:{share:.4f}" for ticks, share in enumerate(shares) if share >= 5e-5)


def shares_of_text(text: str) -> dict[int, float]:
    """Shares by number of ticks from what :func:`text_of_shares` wrote.

    Raises
    ------
    ValueError
        Another form.

    Examples
    --------
    >>> shares_of_text("2:0.75 3:0.25")
    {2: 0.75, 3: 0.25}
    """
    pairs = (word.split(":") for word in text.split())
    return {int(ticks): float(share) for ticks, share in pairs}
