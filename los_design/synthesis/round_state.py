"""State of a design in rounds, kept in a file, and its result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.support.job import Job
from lftkit.tuning import Descent, DescentState, TuningStatus
from lftkit.tuning.responses import ResponseLook
from los_design.search.worst_points import WorstPoint


@dataclass
class RoundState:
    """State in a descent, after it, or after a search; kept in a file, so that an interrupted design goes on.

    Parameters
    ----------
    x : ndarray
    number : int
        Rounds so far, the one whose descent is there included.
    points : list of ndarray
        All parameter points, and in `added` how many of them each round added; `around`: those with their frequency.
    known : dict of str to list of WorstPoint
        The worst points of the last search.
    exceeded : list of str
        Requirements with new points in it; empty: no search yet.
    descent : Descent, optional
        Of the round whose searches are not all made.
    searched : int
        Searches after it that found nothing worse.
    watched : list of dict
        Parameter points at which the descent of a round keeps the loop stable.
    inside : DescentState, optional
        Of a descent that is not at its end.
    commits : list of str
        Of the source that it was made with: one, or all of those with which the design went on.
    hidden : list of (int, list of float)
        For each time that it went on for peaks that samples had missed: length of `added`, and their frequencies.
    """

    x: FloatArray
    number: int = 0
    points: list[FloatArray] = field(default_factory=list)
    around: list[tuple[float, FloatArray]] = field(default_factory=list)
    known: dict[str, list[WorstPoint]] = field(default_factory=dict)
    added: list[int] = field(default_factory=list)
    exceeded: list[str] = field(default_factory=list)
    descent: Descent[ResponseLook] | None = None
    searched: int = 0
    watched: list[dict[str, float]] = field(default_factory=list)
    inside: DescentState | None = None
    commits: list[str] = field(default_factory=list)
    hidden: list[tuple[int, list[float]]] = field(default_factory=list)

    def save(self, job: Job | None) -> None:
        """Write the state with what it was made for.

        A descent that the wall limit cut short is not written: it goes on from its last look at all pairs.
        """
        if job is None or (self.descent and self.descent.status == "out_of_time"):
            return
        content = {
            "x": self.x.tolist(),
            "number": self.number,
            "points": [p.tolist() for p in self.points],
            "around": [[omega, p.tolist()] for omega, p in self.around],
            "added": self.added,
            "exceeded": self.exceeded,
            "known": {
                name: [[p.stage, p.requirement, p.to_mapping()] for p in points] for name, points in self.known.items()
            },
            "descent": None if self.descent is None else _plain(self.descent),
            "searched": self.searched,
            "watched": self.watched,
            "inside": self.inside and self.inside.to_mapping(),
            "commits": self.commits,
            "hidden": self.hidden,
        }
        job.save(content)

    @classmethod
    def load(cls, job: Job | None) -> RoundState | None:
        """The state in a file; None where there is none that was made for the same."""
        content = None if job is None else job.state()
        if content is None:
            return None
        try:
            points = [np.array(p, dtype=float) for p in content["points"]]
            around = [(float(omega), np.array(p, dtype=float)) for omega, p in content["around"]]
            known = {
                name: [WorstPoint.from_mapping(*entry) for entry in entries]
                for name, entries in content["known"].items()
            }
            x, added = np.array(content["x"], dtype=float), [int(n) for n in content["added"]]
            descent = _descent(content["descent"]) if content.get("descent") else None
            inside = DescentState.from_mapping(content["inside"]) if content.get("inside") else None
            return cls(
                x,
                int(content["number"]),
                points,
                around,
                known,
                added,
                list(content["exceeded"]),
                descent,
                int(content.get("searched", 0)),
                list(content.get("watched", [])),
                inside,
                list(content.get("commits", ["unknown"])),
                [(int(after), [float(omega) for omega in peaks]) for after, peaks in content.get("hidden", [])],
            )
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return None


@dataclass(frozen=True)
class Outcome:
    """Result of a design in rounds.

    Parameters
    ----------
    x : ndarray
        Entries of both gain matrices.
    status : TuningStatus
        ``rounds``: worse points were still found in the last round, or its descent was above 1 and not at its end;
        without a search the status of the descent.
    tuned : dict of str to float
        Largest value of each requirement at the samples, noise among them.
    worst : dict of str to WorstPoint
        Worst point of every requirement by the last search.
    values : dict of str to float
        Their values, 1 being the share or limit.
    active : list of dict
        Parameter points of the samples.
    commits : list of str
        Of the source: more than one if the design went on with another.
    """

    x: FloatArray
    status: TuningStatus
    tuned: dict[str, float]
    worst: dict[str, WorstPoint]
    values: dict[str, float]
    active: list[dict[str, float]]
    commits: list[str] = field(default_factory=list)

    def worst_cases(self) -> list[dict[str, Any]]:
        """Worst value of each requirement, with frequency and parameters."""
        return [
            {
                "requirement": name,
                "value": float(f"{self.values[name]:.6g}"),
                "omega": p.omega,
                "parameters": dict(p.parameters),
            }
            for name, p in self.worst.items()
        ]


def _plain(descent: Descent[ResponseLook]) -> dict[str, Any]:
    """For JSON, which keeps every bit of a finite number."""
    look = descent.point
    arrays = {name: getattr(look, name).tolist() for name in ("x", "values", "noise")}
    return {**arrays, "merit": look.merit, "status": str(descent.status), "iterations": descent.iterations}


def _descent(content: Mapping[str, Any]) -> Descent[ResponseLook]:
    """As :func:`_plain` made it."""
    x, values, noise = (np.array(content[name], dtype=float) for name in ("x", "values", "noise"))
    violation, value = content["merit"]
    look = ResponseLook(x, (violation, value), values, noise)
    return Descent(look, TuningStatus(content["status"]), int(content["iterations"]))
