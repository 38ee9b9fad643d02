"""Signs of rounding and repetition in the rows of a record, and the limits of what is a chance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lftkit.support.settings import AlgorithmSettings
from pointing_analysis.arrays import BoolArray, FloatArray
from pointing_analysis.read.mapped_arrays import parts


@dataclass(frozen=True)
class LiveRowSettings(AlgorithmSettings):
    """Limits of what is a chance.

    Attributes
    ----------
    fewest : rows of a record, and runs of a regular length, below which nothing is said
    regular : share of the rows in runs of a regular length from which the record is a held or interpolated one
    spread : part of the regular length by which a run may miss a multiple of it
    single : share of steps of one quantum from which runs of equal values come from quantisation
    fine : part of the typical step below which the quantum is that of the number format
    chance : probability of a run of repeated rows, in the whole record, below which it is not one of chance
    beside : times the rows just below the extreme value that may be at it
    margin : rows more that may be there
    apart : distance of rows that are equal by chance, as the digits of a number make them
    band : part of the range that is just below the extreme value
    touching : times the rounding of values along an edge that are beside it, too
    rounding : part of the largest norm by which norms miss it in rounding
    smooth : change of the typical step, a part of it, up to which a motion is one without noise
    straight : part of the rms of the steps by which a row may miss the line between its neighbours
    corners : share of the rows that are not straight, in runs of more than two, beyond which a motion is a curve
    cubic : part of the rms of the third differences by which a fourth one may miss zero within a polynomial
    left : times the rounding of the fourth differences that the third ones of a polynomial have at least
    turned : times the allowed bend of a line, or the typical step of a motion, from which a change is one
    format : largest part of the largest norm that is the rounding of a number format
    tilted : times the quantum of both axes by which values along another direction miss an edge, half of it its corners
    edge : largest part of that in the largest norm, for which edges are looked at
    straightened : times that the direction of an edge is taken anew from all corners along it
    around : times the length of a run, to either side, in which a signal is as slow as in it
    turning : share of steps in the direction against the one before, from which a quantised signal is no slow motion
    multiple : part of a quantum by which the steps of a rounded record miss a multiple of it
    growing : times that a quantum is fitted to more of the steps
    same : part by which the rows for a sample may differ in the two axes
    decimated : rows that are taken together where rounding hides a polynomial between single ones
    coarse : part of a limit up to which the values may be rounded
    at_rows : share of interpolated samples that are a whole number of rows apart, if they are at rows
    long : rows of a sample from which a corner may be seen a row late
    certain : standard errors beyond which more values at the largest level are no chance
    near : changes of the velocity before, and after, a rest beside which it is small
    short, even, stretches : most rows of a run, and variance of their number in equal stretches over its mean, in a
        record that was brought to another rate by lines or cubic splines (1 at random), and fewest stretches
    sampled : rows of a record in which a value is looked for that comes again and again
    rest : part of the typical step beyond which a step to such a value is a jump
    digits : largest rounding of a value to the digits of a file, a part of it: seven digits, or single precision
    clear : times the rounding beyond which a difference is one of the motion
    """

    fewest: int = 32
    regular: float = 0.9
    spread: float = 0.25
    single: float = 0.95
    fine: float = 1e-3
    chance: float = 1e-3
    beside: float = 3.0
    margin: int = 8
    apart: int = 7
    band: float = 0.01
    touching: float = 4.0
    rounding: float = 1e-12
    smooth: float = 0.7
    straight: float = 1e-3
    corners: float = 0.1
    cubic: float = 0.05
    left: float = 4.0
    turned: float = 3.0
    format: float = 1e-3
    tilted: float = 3.0
    edge: float = 1.2e-2
    straightened: int = 3
    around: int = 4
    turning: float = 0.5
    multiple: float = 1e-3
    growing: int = 16
    same: float = 0.02
    decimated: int = 4
    coarse: float = 0.5
    at_rows: float = 0.95
    long: int = 8
    certain: float = 4.0
    near: int = 1
    short: int = 3
    even: float = 0.1
    stretches: int = 16
    sampled: int = 4096
    rest: float = 0.5
    digits: float = 5e-7
    clear: float = 10.0


SETTINGS = LiveRowSettings()


def quantum_of(steps: FloatArray, settings: LiveRowSettings) -> FloatArray:
    """Quantum (2,) of which all steps (n, 2) between rows are multiples; zero in an axis that is not rounded."""
    quanta = np.zeros(steps.shape[1])
    for k, column in enumerate(np.abs(steps).T):
        sizes = np.sort(column[column > 0.0])
        if not sizes.size:
            continue
        # Greatest common divisor of the smallest ones by Euclid's algorithm: of many decimals no step needs to have
        # the last one alone. Then its value by larger and larger multiples.
        quantum, least, few = float(sizes[0]), settings.rounding * float(sizes[-1]), sizes[: settings.fewest]
        others = few
        while others.size and quantum > least:
            left = np.abs(few - quantum * np.rint(few / quantum))
            others = left[left > settings.multiple * quantum]
            quantum = float(others.min(initial=quantum))
        if quantum <= least:
            continue
        for most in np.geomspace(few[-1], sizes[-1], settings.growing):
            some = sizes[: np.searchsorted(sizes, (1.0 + settings.multiple) * most)]
            counts = np.rint(some / quantum)
            quantum = float(counts @ some / (counts @ counts))
        places = sizes / quantum
        if (np.abs(places - np.rint(places)) <= settings.multiple).all():
            quanta[k] = quantum
    return quanta


def marks(e: FloatArray, function: Callable[[FloatArray], BoolArray], beside: int = 1) -> BoolArray:
    """Rows (n,) that a function of them with so many rows before and behind marks; the first ones are marked."""
    marks = np.ones(len(e), bool)
    for part in parts(len(e) - beside):
        rows = e[part.start : part.stop + 2 * beside]
        short = part.stop + 2 * beside - len(e)
        rows = np.concatenate([rows, *[rows[-1:]] * short]) if short > 0 else rows
        marks[part.start + beside : part.stop + beside] = function(rows)
    return marks


def of_quantisation(steps: FloatArray, settings: LiveRowSettings, rounded: FloatArray | float = 0.0) -> bool:
    """Whether the steps (m, 2) between runs of equal rows are of one quantum, which also a smooth motion has.

    Those of values that are `rounded` differ by four times that quantum at most.
    """
    for column, quantum in zip(np.abs(steps).T, np.broadcast_to(rounded, steps.shape[1])):
        moving = column[column > 0.0]
        if moving.size and np.mean(moving <= 1.001 * moving.min() + 4.001 * quantum) < settings.single:
            return False
    return True


def typical_step(values: FloatArray) -> float:
    """Median of the steps between rows (n,) that differ; 0 where none do."""
    steps = np.abs(np.diff(values))
    moving = steps[steps > 0.0]
    return float(np.median(moving)) if moving.size else 0.0
