"""Samples that were never sent: those of periods that a real-time loop has lost, as its recorder counted them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from pointing_analysis.arrays import BoolArray, IntArray
from pointing_analysis.read.run_end import count_of, statistics_of

if TYPE_CHECKING:
    from pointing_analysis.read.recording import Recording
    from pointing_analysis.read.topic import Topic

UNSENT = "unsent_"
"""Statistics of the recorder: samples of a topic, whose absolute name is behind, that are missing and never were."""


MAX_GAPS, MAX_GAP = 1000, 10_000
"""Of so many gaps, and so many samples of each, it is looked up whether they were sent."""

OF_EVERY_TICK = ("truth/los", "isolator/accel")
"""Topics of the plant with a sample of every tick that was sent."""


def topics_of_every_tick(parameters: Mapping[str, Any]) -> tuple[str, ...]:
    """Topics that show which ticks were sent; a device may measure the line of sight for a part of a run."""
    return tuple(name for name in OF_EVERY_TICK if name != "truth/los" or not parameters.get("device"))


def unsent(run: Recording, name: str) -> int:
    """Samples of a topic that are missing since nothing was sent in their periods; zero if not stated.

    Parameters
    ----------
    run : Recording
    name : str
        Topic without the namespace.
    """
    statistics = statistics_of(run.parameters, "recorder").items()
    texts = [text for key, text in statistics if str(key).startswith(UNSENT) and str(key).endswith(f"/{name}")]
    return sum(count_of(text) or 0 for text in texts)


def lost_gaps(run: Recording, name: str, lost: int) -> int:
    """Gaps of a topic in which samples that were sent are missing.

    A tick of which the plant has sent a sample was no lost period. Of the other samples it is not known which
    were sent: as many of their gaps count as samples are left of those that are `lost`.

    Parameters
    ----------
    run : Recording
    name : str
        Topic without the namespace.
    lost : int
        Samples that are missing and were sent.
    """
    topic = run[name]
    if not unsent(run, name) or not lost:
        return topic.integrity.gap_count if lost else 0
    # Stamps [ns] at which the topic has no sample, and the number of the gap of each
    period, stamp = round(topic.period * 1e9), np.asarray(topic.stamp)
    steps = np.rint(np.diff(stamp) / period).astype(np.int64) if period and len(stamp) else np.zeros(0, np.int64)
    holes = np.flatnonzero(steps > 1)[:MAX_GAPS]
    sizes = np.minimum(steps[holes] - 1, MAX_GAP)
    gaps = np.repeat(np.arange(len(holes)), sizes)
    index = np.arange(len(gaps)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    stamps = np.repeat(stamp[holes], sizes) + period * (index + 1)
    sent = np.zeros(len(stamps), bool)
    for other in OF_EVERY_TICK:
        if other != name and other in run:
            sent |= _among(stamps, run[other])
    certain = np.unique(gaps[sent])
    rest = np.setdiff1d(gaps, certain)
    return len(certain) + min(len(rest), max(lost - int(sent.sum()), 0))


def _among(stamps: IntArray, topic: Topic) -> BoolArray:
    """Which of the stamps a topic has, to half of its period."""
    there = np.asarray(topic.stamp)
    if not len(there) or not topic.period > 0:
        return np.zeros(len(stamps), bool)
    after = np.searchsorted(there, stamps)
    nearest = np.minimum(
        np.abs(there[np.minimum(after, len(there) - 1)] - stamps), np.abs(there[np.maximum(after - 1, 0)] - stamps)
    )
    return np.asarray(nearest <= topic.period * 1e9 / 2)
