"""Strips of scalings over frequency, which prove bounds of loops."""

from __future__ import annotations

from dataclasses import dataclass

from lftkit.arrays import ComplexArray, FloatArray

Interval = tuple[float, float]


@dataclass(frozen=True)
class Strip:
    """A box of the parameters and scalings at some frequencies.

    Parameters
    ----------
    box : tuple of (low, high)
        Deviations from the nominal values; of an angle theta [rad].
    nodes : ndarray, shape (k,)
        Frequencies [rad/s], ascending, two at least.
    D, G : tuple of ndarray, complex, shape (k, m, m)
        Of each parameter, Hermitian. D is positive definite, or zero for all nodes of an angle: then it is any angle.
    factor : ndarray, shape (k,)
        Of the gain's inequality, positive.
    """

    box: tuple[Interval, ...]
    nodes: FloatArray
    D: tuple[ComplexArray, ...]
    G: tuple[ComplexArray, ...]
    factor: FloatArray
