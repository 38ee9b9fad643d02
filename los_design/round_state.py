"""State of a design between its rounds, kept in a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from los_design.worst_points import WorstPoint
from lti.ordinary_file import read_ordinary_file
from pointing_analysis.atomic_output import write_text

FloatArray = NDArray[np.float64]


@dataclass
class RoundState:
    """State between rounds; kept in a file, so that an interrupted design goes on.

    Parameters
    ----------
    x : ndarray
    number : int
        Rounds so far.
    points : list of ndarray
        All parameter points, and in `added` how many of them each round added; `around`: those with their frequency.
    known : dict of str to list of WorstPoint
        The worst points of the last search.
    exceeded : list of str
        Requirements with new points in it; empty: no search yet.
    """

    x: FloatArray
    number: int = 0
    points: list[FloatArray] = field(default_factory=list)
    around: list[tuple[float, FloatArray]] = field(default_factory=list)
    known: dict[str, list[WorstPoint]] = field(default_factory=dict)
    added: list[int] = field(default_factory=list)
    exceeded: list[str] = field(default_factory=list)

    def save(self, path: Path, key: Mapping[str, Any]) -> None:
        """Write the state with what it was made for."""
        content = {
            "key": dict(key), "x": self.x.tolist(), "number": self.number,
            "points": [p.tolist() for p in self.points],
            "around": [[omega, p.tolist()] for omega, p in self.around],
            "added": self.added, "exceeded": self.exceeded,
            "known": {name: [[p.stage, p.requirement, p.to_mapping()] for p in found]
                      for name, found in self.known.items()},
        }  # fmt: skip
        write_text(path, json.dumps(content))

    @classmethod
    def load(cls, path: Path, key: Mapping[str, Any]) -> RoundState | None:
        """The state in a file; None where there is none that was made for the same."""
        try:
            content = json.loads(read_ordinary_file(path))
            if content["key"] != dict(key):
                return None
            points = [np.array(p, dtype=float) for p in content["points"]]
            around = [(float(omega), np.array(p, dtype=float)) for omega, p in content["around"]]
            known = {name: [WorstPoint.from_mapping(*entry) for entry in found]
                     for name, found in content["known"].items()}  # fmt: skip
            x, added = np.array(content["x"], dtype=float), [int(n) for n in content["added"]]
            return cls(x, int(content["number"]), points, around, known, added, list(content["exceeded"]))
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return None
