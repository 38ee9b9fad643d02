"""How a recorded run ended, by its plan or before, and which part of its ticks was missed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pointing_analysis.files.structured_text import is_number

PLANNED = "planned_ticks"
"""Statistic of the plant: ticks that the run was to have."""

BY_NODES = ("realtime", "lockstep")
"""Modes in which the plant reports its ticks while the run goes on."""


def early_end(parameters: Mapping[str, Any]) -> str:
    """What is said of a run that did not end by its plan; empty where it did, or where nothing is known of a plan.

    The plant counts its ticks: of a run that was killed, too, its last report has what was done and what was to be.

    Parameters
    ----------
    parameters : what the recorder wrote about the run (:attr:`pointing_analysis.read.run.Run.parameters`)

    Examples
    --------
    >>> early_end({"duration": 10.0, "rate_hz": 1000, "statistics": {"plant": {"ticks": "3214"}}})
    'the run ended before its plan: after 3214 of 10000 ticks'
    >>> early_end({"duration": 10.0, "rate_hz": 1000, "statistics": {"plant": {"ticks": "10000"}}})
    ''
    """
    statistics = parameters.get("statistics")
    if not isinstance(statistics, dict):
        return ""
    plant = statistics.get("plant")
    counts = plant if isinstance(plant, dict) else {}
    done, planned = _count(counts.get("ticks")), _count(counts.get(PLANNED))
    if planned is None:
        planned = _by_duration(parameters.get("duration"), parameters.get("rate_hz"))
    if done is None:
        ours = planned is not None and parameters.get("mode") in BY_NODES
        return "the plant has reported no tick: how the run ended is not known" if ours else ""
    if planned is None or done >= planned:
        return ""
    return f"the run ended before its plan: after {done} of {planned} ticks"


def missed_share(plant: Mapping[str, Any]) -> float:
    """Missed ticks of a run in real time, of all of its periods [%].

    A missed tick is one with an older command, or a period that the plant lost: at most all.

    Parameters
    ----------
    plant : statistics of the plant

    Raises
    ------
    ValueError
        A count that is none.

    Examples
    --------
    >>> missed_share({"ticks": "9990", "missed_ticks": "129", "skipped_periods": "10"})
    1.29
    """
    names = "missed_ticks", "ticks", "skipped_periods"
    counts = {name: _count(plant.get(name, 0)) for name in names}
    missed, ticks, skipped = (counts[name] for name in names)
    if missed is None or ticks is None or skipped is None:
        raise ValueError(f"counts of ticks must be whole numbers, got {[str(plant.get(name))[:20] for name in names]}")
    return 100.0 * missed / max(ticks + skipped, 1)


def _by_duration(duration: object, rate: object) -> int | None:
    """Ticks of a duration [s] at a rate [Hz]; None where one of them is no number."""
    if not is_number(duration) or not is_number(rate):
        return None
    ticks = duration * rate
    return round(ticks) if 0 < ticks < 1e15 else None


def _count(value: object) -> int | None:
    """A number of ticks in a statistic; None for anything else."""
    text = str(value)
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 16 else None
