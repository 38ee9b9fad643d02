"""Outcome of a tuning run."""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import ArrayLike


class TuningStatus(str, Enum):
    """Why a tuning run ended and what it promises; :attr:`advice` says what to do.

    ==================  ==============================================================================================
    ``converged``       Certificate and tuned value agree within 0.1 %, the point is stationary, and a second descent,
                        a hundred random directions and descents from 3 and 10 times the gain do not lower it by
                        0.1 %. Or the value is within ``gap`` of the lower bound, or at most ``met``, or no soft
                        requirement is left.
    ``target``          The target value was reached.
    ``stalled``         No progress and no confirmation.
    ``iterations``      Iteration limit, or the infimum is zero and only approached.
    ``rounds``          Of a robust tuning: the last round still found worse parameters.
    ``inaccurate``      Tuned value and certificate differ by more than 0.1 % after the grid was refined.
    ``not_stabilised``  No start made all models stable.
    ``unbounded``       Parameters reached the limit of their magnitude.
    ``failed``          The arithmetic failed (singular matrix, overflow); the result has the best point until then.
    ``infeasible``      No start meets the hard requirements, or a lower bound shows that no controller meets one; the
                        result has the least violation.
    ``out_of_time``     Wall limit: the best point so far, which depends on the machine.
    ``interrupted``     The best point so far.
    ==================  ==============================================================================================
    """

    CONVERGED = "converged"
    TARGET = "target"
    STALLED = "stalled"
    INACCURATE = "inaccurate"
    ITERATIONS = "iterations"
    ROUNDS = "rounds"
    NOT_STABILISED = "not_stabilised"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    FAILED = "failed"
    OUT_OF_TIME = "out_of_time"
    INTERRUPTED = "interrupted"

    def __str__(self) -> str:
        return self.value

    @property
    def advice(self) -> str:
        """What to do about it."""
        return _ADVICE[self.value]


def inaccurate(tuned: ArrayLike, certified: ArrayLike, far: float = 0.01) -> str:
    """Advice where values and certificate differ: both where they differ most, and what follows.

    Parameters
    ----------
    tuned, certified : array_like
        Values of the requirements for each model, of equal shape.
    far : float
        Relative difference from which on the result is no optimum.

    Examples
    --------
    >>> inaccurate([1.0, 3.0], [1.0, 700.0])
    'a tuned value is 3, its certificate 700: trust the certificate; the result is no optimum: try other starts'
    """
    values, right = (np.ravel(np.asarray(one, dtype=float)) for one in (tuned, certified))
    known = np.isfinite(values) & np.isfinite(right)
    if not np.any(known):
        return TuningStatus.INACCURATE.advice
    apart = np.where(known, np.abs(values - right) / np.maximum(np.abs(right), np.finfo(float).tiny), -1.0)
    k = int(np.argmax(apart))
    text = f"a tuned value is {values[k]:.6g}, its certificate {right[k]:.6g}: trust the certificate"
    return f"{text}; the result is no optimum: try other starts" if apart[k] > far else text


_ADVICE = {
    "converged": "local minimum confirmed by certificate, random directions, a second metric and larger gains; other "
    "starts may find a better one",
    "stalled": "no further progress, optimality not confirmed: try other starts or another form of the structure",
    "inaccurate": "tuned value and certificate differ by more than 0.1 %: trust the certificate",
    "iterations": "still improving when the iterations ran out: allow more",
    "rounds": "worse parameters were still found in the last round: allow more rounds",
    "target": "the target value was reached",
    "not_stabilised": (
        "no start made every model stable: raise the order, give a stabilising start, use more starts, or check that "
        "the commands and measurements reach the unstable poles"
    ),
    "infeasible": (
        "a hard requirement stays above 1: make it soft to see what is reachable, relax its bound, or raise the order"
    ),
    "unbounded": (
        "parameters grew without end: the value falls as they do, or does not depend on them; add a requirement on "
        "commands, noise or controller poles, or give bounds"
    ),
    "failed": (
        "the arithmetic of the best start failed; the best point so far is given: try other starts, or scale the model"
    ),
    "out_of_time": "the wall limit was reached; the best point so far is given: allow more time or start from it",
    "interrupted": "stopped by the user; the best point so far is given",
}
