"""The outer loop of every design: tune on what is active, look for what is worse, make it active, repeat.

What is active is a finite part of what is asked: frequencies of a grid (the exact norm of the certificate is what may
be worse), models at parameter values, sampled responses. The set stays small because only what is really worse enters
it (Apkarian, Dao and Noll 2015); a design is ``converged`` when nothing worse is found.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from lftkit.tuning.status import TuningStatus

CUT = (TuningStatus.OUT_OF_TIME, TuningStatus.INTERRUPTED, TuningStatus.NOT_STABILISED)
"""Ends of a tuning after which there is no other round."""


class Tuned(Protocol):
    """Result of the tuning in a round."""

    @property
    def status(self) -> TuningStatus:
        """Why it ended."""
        ...


T = TypeVar("T", bound=Tuned)
N = TypeVar("N")


@dataclass(frozen=True)
class Worse(Generic[N]):
    """What a round found beyond what was active, and whether its tuning goes on also without that."""

    new: Sequence[N]
    unfinished: bool = False

    @property
    def goes_on(self) -> bool:
        """There is something to do in another round."""
        return bool(self.new) or self.unfinished


class Design(Protocol[T, N]):
    """What differs between designs: what is active, how it is tuned, where worse is looked for."""

    def tuned(self, number: int) -> T:
        """The best point for what is active; `number` rounds were before."""
        ...

    def worse(self, number: int, tuned: T, last: bool) -> Worse[N]:
        """What is worse than what the tuning reached; in the last round everything is looked at."""
        ...

    def add(self, tuned: T, worse: Worse[N]) -> None:
        """Make it active."""
        ...


@dataclass(frozen=True)
class Rounds(Generic[T, N]):
    """Outcome of :func:`in_rounds`: the last tuning, what was worse after it, and the status of the whole."""

    tuned: T
    worse: Worse[N]
    status: TuningStatus


def in_rounds(design: Design[T, N], rounds: int, done: int = 0, deadline: float = np.inf) -> Rounds[T, N]:
    """Rounds until nothing worse is found.

    Parameters
    ----------
    design : Design
    rounds : int
        Most rounds.
    done : int
        Those made before, by a design that goes on.
    deadline : float
        Value of ``time.monotonic()`` after which no other round begins.

    Returns
    -------
    Rounds
        ``converged``: nothing worse was found after a tuning that was ``converged`` or reached its target; else the
        status of the tuning; ``rounds`` or ``out_of_time``: something worse was found in the last round.
    """
    number = done
    while True:
        tuned = design.tuned(number)
        last = number + 1 >= rounds or tuned.status in CUT
        worse = design.worse(number, tuned, last)
        late = time.monotonic() > deadline
        if last or late or not worse.goes_on:
            return Rounds(tuned, worse, _status(tuned.status, worse.goes_on, late))
        design.add(tuned, worse)
        number += 1


def _status(tuned: TuningStatus, goes_on: bool, late: bool) -> TuningStatus:
    if goes_on and tuned not in CUT:
        return TuningStatus.OUT_OF_TIME if late else TuningStatus.ROUNDS
    return TuningStatus.CONVERGED if tuned is TuningStatus.TARGET else tuned
