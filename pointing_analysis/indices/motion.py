"""Motion during a run: array angle, wheel speeds, harmonics of the wheels, modes of the structure.

A bag of such a run names its ``motion``: ``knots`` of time [s], array angle [rad] and four wheel speeds [rad/s], linear
between them; ``harmonics`` of the wheels; frequencies ``modes`` [rad/s] of the structure's lightly damped modes at the
start; ``modes_over_time``, rows of a time and such frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pointing_analysis.arrays import FloatArray
from pointing_analysis.read.recording import Recording


@dataclass(frozen=True)
class Motion:
    """Motion during a run.

    Parameters
    ----------
    time : ndarray, shape (k,)
        s from the start of the run.
    theta : ndarray, shape (k,)
        Angle of the arrays [rad].
    speed : ndarray, shape (k, 4)
        Wheel speeds [rad/s].
    harmonics : ndarray
        Multiples of the speed.
    modes : tuple of (float, ndarray)
        Times [s], and the frequencies of the structure's lightly damped modes there [rad/s].
    """

    time: FloatArray
    theta: FloatArray
    speed: FloatArray
    harmonics: FloatArray
    modes: tuple[tuple[float, FloatArray], ...]

    @property
    def wheel(self) -> int:
        """Index of the wheel whose speed changes most."""
        return int(np.argmax(np.ptp(self.speed, axis=0)))

    @property
    def turns(self) -> bool:
        """Whether a wheel changes its speed."""
        return bool(np.ptp(self.speed, axis=0).max() > 0.0)


def motion_of(run: Recording) -> Motion | None:
    """The motion that a recording names; None where nothing moves, or where the entry cannot be read."""
    return read_motion(run)[0]


def read_motion(run: Recording) -> tuple[Motion | None, str]:
    """What :func:`motion_of` returns, and what is wrong with the entry."""
    content, wrong = run.parameters.get("motion"), "the motion of the recording cannot be read"
    if content is None:
        return None, ""
    try:
        knots = np.array(content["knots"], dtype=float).reshape(-1, 6)
        harmonics = np.array(content["harmonics"], dtype=float).ravel()
        rows = content.get("modes_over_time") or [[0.0, *content["modes"]]]
        modes = tuple((float(row[0]), np.array(row[1:], dtype=float)) for row in rows)
    except (KeyError, TypeError, ValueError, IndexError):
        return None, wrong
    if not (knots.size and np.isfinite(knots).all() and (np.diff(knots[:, 0]) > 0.0).all()):
        return None, wrong
    return Motion(knots[:, 0], knots[:, 1], knots[:, 2:], harmonics, modes), ""
