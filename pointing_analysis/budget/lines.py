r"""Pointing error budgets after ECSS-E-ST-60-10C: combine the contributions of many sources.

Independent contributions add in the root sum of squares, biases add as they are, and the total at a level of
probability is :math:`|\sum \mu_i| + n_P \sqrt{\sum \sigma_i^2}` (central limit: :math:`n_P = 2` stands for 95 %, 3
for 99.7 %). What is constant within an exposure (a bias, a misalignment, slow thermal bending) is part of the APE and
not of the RPE.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lftkit.errors import InputError
from pointing_analysis.arrays import FloatArray
from pointing_analysis.read.topic import read_only


def uniform(half_range: ArrayLike) -> FloatArray:
    r"""Standard deviation of an error anywhere within plus or minus `half_range`: :math:`C/\sqrt 3`."""
    return np.asarray(half_range, dtype=float) / math.sqrt(3)


def periodic(amplitude: ArrayLike) -> FloatArray:
    r"""Standard deviation over time of a sinusoid: :math:`A/\sqrt 2`."""
    return np.asarray(amplitude, dtype=float) / math.sqrt(2)


@dataclass(frozen=True)
class Contribution:
    """One error source.

    Attributes
    ----------
    name : what it is
    sigma : (k,) standard deviation on each axis, any one unit
    mean : (k,) mean, the same unit; zero by default
    within_exposure : whether it varies within an exposure and so is part of the RPE
    """

    name: str
    sigma: FloatArray
    mean: FloatArray
    within_exposure: bool


def contribution(name: str, sigma: ArrayLike, *, mean: ArrayLike = 0.0, within_exposure: bool = True) -> Contribution:
    """Make a contribution; a single number stands for all three axes.

    Raises
    ------
    ValueError
        A negative or infinite standard deviation.
    """
    s = np.asarray(sigma, dtype=float)
    s = np.full(3, float(s)) if s.ndim == 0 else s.copy()
    if s.ndim != 1 or not np.all(np.isfinite(s)) or np.any(s < 0):
        raise InputError(f"{name}: sigma must be zero or more on each axis, got {sigma!r}")
    m = np.broadcast_to(np.asarray(mean, dtype=float), s.shape).copy()
    return Contribution(name, read_only(s), read_only(m), within_exposure)


@dataclass(frozen=True)
class Total:
    """Combined error of an index.

    Attributes
    ----------
    rss : (k,) root sum of squares of the standard deviations
    mean : (k,) sum of the means
    level : (k,) absolute mean plus factor times rss
    """

    rss: FloatArray
    mean: FloatArray
    level: FloatArray


def combine(contributions: Sequence[Contribution], index: str = "APE", factor: float = 2.0) -> Total:
    """Total of the contributions for an index.

    Parameters
    ----------
    contributions : independent of one another
    index : ``APE`` (all of them) or ``RPE`` (those that vary within an exposure, without means)
    factor : number of standard deviations for the required probability

    Raises
    ------
    ValueError
        Another index, no contribution, or different numbers of axes.

    Examples
    --------
    >>> noise = contribution("star tracker", [3.0, 0.0, 0.0])
    >>> bias = contribution("alignment", [4.0, 0.0, 0.0], within_exposure=False)
    >>> [float(combine([noise, bias], index).level[0]) for index in ("APE", "RPE")]
    [10.0, 6.0]
    """
    if index not in ("APE", "RPE"):
        raise InputError(f"index must be APE or RPE, got {index!r}")
    chosen = [c for c in contributions if index == "APE" or c.within_exposure]
    sizes = {c.sigma.size for c in contributions}
    if len(sizes) != 1:
        raise InputError(f"contributions must have the same number of axes, got {sorted(sizes) or 'none'}")
    k = sizes.pop()
    rss = np.sqrt(sum((np.square(c.sigma) for c in chosen), np.zeros(k)))
    mean = sum((c.mean for c in chosen if index == "APE"), np.zeros(k))
    return Total(read_only(rss), read_only(np.array(mean)), read_only(np.abs(mean) + factor * rss))
