"""End of a recorded run, as planned or early, and its missed ticks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lftkit.errors import InputError
from pointing_analysis.files.structured_text import is_number

PLANNED = "planned_ticks"
"""Statistic of the plant: ticks that the run was to have."""

FAILURE = "failure"
"""Statistic of the plant: why the run failed."""

OUTSIDE = "unsent_outside"
"""Statistic of the plant: ticks before the first and after the last one of which it has sent samples."""

AFTER = "unsent_after"
"""Statistic of the plant: those of them after the last one."""

BY_NODES = ("realtime", "lockstep")
"""Modes in which the plant reports its ticks during the run."""


@dataclass(frozen=True)
class RunEnd:
    """End of a run, in ticks; None if a number is not known.

    Attributes
    ----------
    planned : by the plan of the run
    done : by the last report of its plant
    sent : of these, from the first to the last one of which the plant has sent samples
    covered : from the first to the last one of which the recording has samples, those that are known to be lost counted
    unreported : whether the plant must have reported and has not
    unsent : after the last one of which the plant has sent samples: periods that a loop in real time has lost, and of a
        run that failed those up to its planned end
    """

    planned: int | None
    done: int | None
    sent: int | None
    covered: int | None
    unreported: bool = False
    unsent: int = 0

    @property
    def text(self) -> str:
        """Sentence about a run that did not end as planned, or whose messages do not show it; else empty."""
        if self.unreported:
            return "the plant has reported no tick: the end of the run is not known"
        unplanned = self.planned is not None and self.done is not None and self.done < self.planned
        early = f"the run ended early: after {self.done} of {self.planned} ticks" if unplanned else ""
        if self.covered is None or self.sent is None or (self.covered >= self.sent and not self.longer):
            return early
        if self.longer:
            return f"the messages cover {self.covered} ticks, more than the {self.sent} in the run's record"
        if early:
            return f"{early}; the messages cover {self.covered} of the {self.sent} ticks in the run's record"
        plan = "" if self.planned is None else "by its plan, "
        return (
            f"the run's record says that it ended {plan}after {self.sent} ticks, "
            f"but the messages cover {self.covered} of them"
        )

    @property
    def longer(self) -> bool:
        """Whether there are messages of more ticks than the run had; one that ended early may lack its last report."""
        if self.planned is None or self.covered is None:
            return False
        return self.done == self.planned < self.covered

    @property
    def by_plan(self) -> bool:
        """Whether plan, record and messages are there and agree."""
        return None not in (self.planned, self.done, self.covered) and not self.text


def statistics_of(parameters: Mapping[str, Any], node: str) -> Mapping[str, Any]:
    """Last statistics of a node in what the recorder wrote about a run; empty if there are none, or another type."""
    statistics = parameters.get("statistics")
    of_node = statistics.get(node) if isinstance(statistics, Mapping) else None
    return of_node if isinstance(of_node, Mapping) else {}


def run_end(parameters: Mapping[str, Any], covered: int | None = None) -> RunEnd:
    """End of a run.

    The plant counts its ticks: of a run that was killed, too, its last report has what was done and what was to be.

    Parameters
    ----------
    parameters : what the recorder wrote about the run (``parameters`` of a :class:`pointing_analysis.read.run.Run`)
    covered : ticks that the messages cover, see :class:`RunEnd`

    Examples
    --------
    >>> known = {"duration": 10.0, "rate_hz": 1000, "statistics": {"plant": {"ticks": "10000"}}}
    >>> run_end(known, covered=10000).by_plan
    True
    >>> run_end({**known, "statistics": {"plant": {"ticks": "3214"}}}).text
    'the run ended early: after 3214 of 10000 ticks'
    >>> run_end(known, covered=7500).text
    "the run's record says that it ended by its plan, after 10000 ticks, but the messages cover 7500 of them"
    """
    if not isinstance(parameters.get("statistics"), Mapping):
        return RunEnd(None, None, None, covered)
    counts = statistics_of(parameters, "plant")
    done, planned = count_of(counts.get("ticks")), count_of(counts.get(PLANNED))
    if planned is None:
        planned = _by_duration(parameters.get("duration"), parameters.get("rate_hz"))
    if done is None:
        ours = planned is not None and parameters.get("mode") in BY_NODES
        return RunEnd(planned, None, None, covered, unreported=ours)
    unsent = count_of(counts.get(AFTER)) or 0
    if FAILURE in counts and planned is not None:
        unsent += max(planned - done, 0)
    return RunEnd(planned, done, done - (count_of(counts.get(OUTSIDE)) or 0), covered, unsent=unsent)


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
    counts = {name: count_of(plant.get(name, 0)) for name in names}
    missed, ticks, skipped = (counts[name] for name in names)
    if missed is None or ticks is None or skipped is None:
        raise InputError(f"counts of ticks must be whole numbers, got {[str(plant.get(name))[:20] for name in names]}")
    return 100.0 * missed / max(ticks + skipped, 1)


def _by_duration(duration: object, rate: object) -> int | None:
    """Ticks of a duration [s] at a rate [Hz]; None where one of them is no number."""
    if not is_number(duration) or not is_number(rate):
        return None
    ticks = duration * rate
    return round(ticks) if 0 < ticks < 1e15 else None


def count_of(value: object) -> int | None:
    """A whole number in a statistic; None for anything else."""
    text = str(value)
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 16 else None
