"""The last seconds of a run as arrays, and their indices and spectrum for a viewer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from los_testbed.bags.cdr import Codec, codec_for
from los_testbed.config.topics import FSM_COMMAND, LOS_ESTIMATE, PMA_COMMAND, TRUTH_LOS, TopicDefinition
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.indices.metrics import radial, windows
from pointing_analysis.requirements.verdict import Requirement
from pointing_analysis.spectra.spectra import psd
from titop_plant.interface import TICK_NS

CAPACITY = 16_384
"""Ticks that are stored."""

SPAN_TICKS = 5_000
"""Ticks over which the indices are computed."""

SEGMENT_S = 0.5
"""Segment of the spectrum [s]."""

MAX_POINTS = 100
"""Points of a signal in one frame; a viewer that is behind gets every second, third ... tick."""

URAD = 1e-6
DT = TICK_NS * 1e-9


@dataclass(frozen=True)
class ShownTopic:
    """A topic that is shown: its name on the page and the size of the page's unit in SI."""

    name: str
    topic: TopicDefinition
    unit: float


SIGNALS = (
    ShownTopic("los", TRUTH_LOS, RAD_PER_MAS),
    ShownTopic("estimate", LOS_ESTIMATE, RAD_PER_MAS),
    ShownTopic("fsm", FSM_COMMAND, URAD),
    ShownTopic("pma", PMA_COMMAND, 1.0),
)
"""Line of sight and its estimate [mas], mirror command [urad], forces [N]."""


class History:
    """Ring of the last ticks of :data:`SIGNALS`.

    Examples
    --------
    >>> history, codec = History(), codec_for(TRUTH_LOS)
    >>> for tick in range(4):
    ...     history.put(TRUTH_LOS.name, bytes(codec.encode(10**12 + tick * TICK_NS, np.full(2, tick * RAD_PER_MAS))))
    >>> history.samples(1)["los"], history.tick
    ([[2.0, 3.0], [2.0, 3.0]], 3)
    """

    def __init__(self) -> None:
        self._signals: dict[str, tuple[ShownTopic, Codec]] = {s.topic.name: (s, codec_for(s.topic)) for s in SIGNALS}
        self._values = {s.name: np.full((CAPACITY, s.topic.size), np.nan) for s in SIGNALS}
        self.clear()

    def clear(self) -> None:
        """Another run begins."""
        self.start = 0
        self.tick = -1
        for values in self._values.values():
            values[:] = np.nan

    def put(self, name: str, data: bytes) -> None:
        """Process a message of a topic by its relative name; topics that are not shown are ignored."""
        if name not in self._signals:
            return
        signal, codec = self._signals[name]
        numbers = np.empty(signal.topic.size)
        stamp = codec.decode(data, numbers)
        if not self.start:
            self.start = stamp
        tick = (stamp - self.start) // TICK_NS
        if tick < 0 or tick <= self.tick - CAPACITY:
            return
        for k in range(max(self.tick, tick - CAPACITY) + 1, tick + 1):
            for values in self._values.values():
                values[k % CAPACITY] = np.nan
        self.tick = max(self.tick, tick)
        self._values[signal.name][tick % CAPACITY] = numbers / signal.unit

    def _ticks(self, after: int) -> NDArray[np.int64]:
        """Ticks after this one that are kept."""
        return np.arange(max(after + 1, self.tick - CAPACITY + 1, 0), self.tick + 1)

    def samples(self, after: int) -> dict[str, Any]:
        """Ticks after this one, at most :data:`MAX_POINTS` at equal distances, and each signal by columns."""
        ticks = self._ticks(after)
        stride = -(-len(ticks) // MAX_POINTS) or 1
        chosen = ticks[ticks % stride == 0]
        rows = {s.name: self._values[s.name][chosen % CAPACITY] for s in SIGNALS}
        return {"ticks": chosen.tolist(), "stride": stride, **{n: _columns(v) for n, v in rows.items()}}

    def recent(self) -> FloatArray:
        """Line of sight of the last :data:`SPAN_TICKS` ticks (n, 2) [mas]; n is a whole number of exposures."""
        ticks = self._ticks(max(self.tick - SPAN_TICKS, -1))
        return np.asarray(self._values["los"][ticks % CAPACITY])

    def spectrum(self) -> dict[str, Any]:
        """Power spectral density [mas2/Hz], both axes together, over frequency [Hz]; a `reason` where there is none."""
        error = self.recent()
        if len(error) < 1.5 * SEGMENT_S / DT:
            return {"reason": f"shown after {1.5 * SEGMENT_S:g} s"}
        try:
            estimate = psd(error, DT, SEGMENT_S)
        except InputError as refusal:  # a sample is missing in every segment
            return {"reason": str(refusal)}
        kept = slice(1, None)
        density = estimate.density.sum(axis=1)
        return {"frequency": _short(estimate.frequency[kept]), "density": _short(density[kept])}


def indices(error: FloatArray, stage: str, requirements: Sequence[Requirement]) -> list[dict[str, Any]]:
    """Each requirement of the stage on a line of sight (n, 2) [mas]: largest value, limit, share within the limit.

    A requirement on the RPE has one value for each exposure, one on the APE one for each tick; others are left out.
    """
    rows = []
    for requirement in requirements:
        if (requirement.loops and stage not in requirement.loops) or requirement.axis:
            continue
        if requirement.index == "APE":
            values = radial(error)
        elif requirement.index == "RPE" and requirement.of_windows and len(error) * DT >= requirement.times[0]:
            values = np.sqrt(windows(error, DT, requirement.times[0]).variance.sum(axis=1))
        else:
            continue
        values = values[~np.isnan(values)]
        limit = requirement.limit / RAD_PER_MAS
        if len(values):
            rows.append(
                {
                    "name": requirement.name,
                    "text": str(requirement),
                    "index": requirement.index,
                    "quantity": requirement.quantity,
                    "limit": float(f"{limit:.6g}"),
                    "largest": float(f"{values.max():.6g}"),
                    "rms": float(f"{np.sqrt(np.mean(np.square(values))):.6g}"),
                    "within": float(f"{np.mean(values < limit):.6g}"),
                    "probability": requirement.probability,
                }
            )
    return rows


def _short(values: FloatArray) -> list[float]:
    return [float(f"{value:.6g}") for value in values]


def _columns(rows: FloatArray) -> list[list[float | None]]:
    """Columns of a table with six digits; a missing value is None."""
    return [[float(f"{value:.7g}") if value == value else None for value in column] for column in rows.T.tolist()]
