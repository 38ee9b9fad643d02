"""Limits of a tuning run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lftkit.errors import InputError
from lftkit.support.scalars import as_positive
from lftkit.systems.arguments import checked


@checked
@dataclass(frozen=True)
class TuningOptions:
    """Limits of a tuning run.

    Parameters
    ----------
    starts : int
        Random starts of a batch, beside the given ones: all are screened in short rounds, the best carried on. With
        more than six, batches follow until one finds nothing better. Of up to six, those that a first descent leads to
        different values run to their ends, each with an equal part of the time that is left.
    seed : int
        Same seed, same result bit for bit (as long as the wall limit, or a part of it, is not what ends a start).
    wall_limit : float
        Seconds for the whole run: a cap, after which the status is ``out_of_time``.
    workers : int
        Processes; with more than one, guard the calling script by ``if __name__ == "__main__":``.
    iterations : int
        Most quadratic programs of a start.
    tolerance : float
        See :class:`lftkit.tuning.descent.minimax.minimax.DescentOptions`.
    target : float
        Stop as soon as the worst soft value is below, hard ones kept.
    met : float
        Soft values up to this one are equally good: the larger of it and the worst soft value is minimised. A problem
        whose infimum is only approached as gains grow has a minimum with it. A run that gets there is ``converged`` if
        the certificate's upper sides say so: no controller has less, and the stationarity is zero.
    gap : float
        A run ends ``converged`` once the largest soft value is within this relative distance of what any controller of
        any order can reach (:mod:`lftkit.tuning.lower_bound`); 0: it goes on.
    lexicographic : bool
        After the most critical requirements the others are lowered, too: these are held at what they have reached,
        and the largest soft value of the others is minimised, and so on (:mod:`lftkit.tuning.lexicographic`). The
        first level takes half of the wall limit at most.
    hold : float
        Part by which a requirement that is held may rise above what it has reached.
    band : float
        Peaks above this fraction of the largest enter the quadratic programs.
    progress : bool
        Show a progress line.
    parameter_limit : float
        Magnitude of a parameter beyond which no controller is looked at, for want of a bound of its own; at least a
        thousand times that of the starts. A run that ends there, or with a value that counts as zero and falls on as
        large parameters grow, is ``unbounded``.
    """

    starts: int = 24
    seed: int = 0
    wall_limit: float = 600.0
    workers: int = 1
    iterations: int = 300
    tolerance: float = 1e-4
    target: float = -np.inf
    met: float = -np.inf
    gap: float = 1e-3
    lexicographic: bool = False
    hold: float = 1e-3
    band: float = 0.3
    progress: bool = False
    parameter_limit: float = 1e8

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise InputError(f"seed must be zero or positive, got {self.seed}")
        if self.starts < 0 or self.workers < 1 or self.iterations < 1:
            raise InputError(
                "expected starts >= 0, workers >= 1 and iterations >= 1, got "
                f"{self.starts}, {self.workers} and {self.iterations}"
            )
        if not self.wall_limit > 0:
            raise InputError(f"wall_limit must be positive [s], got {self.wall_limit}")
        if not self.parameter_limit > 0:
            raise InputError(f"parameter_limit must be positive, got {self.parameter_limit}")
        if not 0 <= self.gap < 1:
            raise InputError(f"gap must be from 0 to below 1, got {self.gap}")
        as_positive(self.hold, "hold")
        if not 0 < self.band < 1:
            raise InputError(f"band must be between 0 and 1, got {self.band}")
