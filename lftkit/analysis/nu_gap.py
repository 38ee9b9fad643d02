"""The nu-gap metric: how different two systems are in a closed loop.

Source: Vinnicombe, Uncertainty and Feedback (2001), and IEEE TAC 38 (1993).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.analysis.eigenvectors import EPS
from lftkit.analysis.frequency_response import refined_response
from lftkit.analysis.norms import hinf_norm
from lftkit.analysis.riccati import right_coprime_factors
from lftkit.arrays import ComplexArray, Matrices
from lftkit.errors import InputError
from lftkit.support.scalars import as_positive
from lftkit.support.state_units import in_balanced_units
from lftkit.systems import lft
from lftkit.systems.arguments import checked
from lftkit.systems.arithmetic import common_period
from lftkit.systems.exchange import as_system
from lftkit.systems.sampled.bilinear import unwarped_frequency
from lftkit.systems.sampled.image import continuous


@dataclass(frozen=True)
class NuGap:
    """Both sides of a nu-gap.

    Attributes
    ----------
    value, upper : float
        ``value <= nu-gap <= upper``, of at most 1; both are 1 where the winding number is another, and `upper` where
        rounding leaves it open. The upper side has the rounding of the normalised factors, which is estimated at their
        poles and between them: with gains of 1e6 and more the sides are farther apart than 1e-7 of the value.
    omega : float
        Frequency of the largest chordal distance [rad/s].
    same_winding : bool
        Whether the winding number is that of equal systems.
    """

    value: float
    upper: float
    omega: float
    same_winding: bool


@checked
def nu_gap(first: Any, second: Any, *, floor: float = 1e-12) -> NuGap:
    """Vinnicombe's nu-gap metric of two systems (the second output of gapmetric in MATLAB).

    The largest chordal distance of the frequency responses where the winding number of ``det(1 + G2~ G1)``, corrected
    by the unstable poles, is zero, and 1 otherwise. **A controller whose margin for one system is larger than the
    nu-gap stabilises the other one**, and its margin there is at least ``sin(asin(margin) - asin(gap))``.

    The winding number is not followed along the axis: with normalised coprime factors it is zero where ``G2~ G1``, of
    the graphs, has as many zeros as poles in the right half-plane.

    Parameters
    ----------
    first, second : System, or what :func:`lftkit.as_system` takes
        Certain, of equal sizes and the same period, stable or not, stabilisable and detectable. Sampled systems go
        through the bilinear map and have no pole at z = -1.
    floor : float
        Gain beside that of the difference of the two systems, whose own may be rounding alone.

    Raises
    ------
    ValueError
        Systems that do not fit, or with a mode that is not stable and not reached or not seen.

    Examples
    --------
    Zhou and Doyle, Essentials of Robust Control, chapter 17: stable or not is almost the same, where 0.02 is printed.

    >>> from lftkit import s
    >>> stable, unstable = ((100 / (2 * s + sign)).system("u", "y") for sign in (1, -1))
    >>> round(nu_gap(stable, unstable).value, 4)
    0.02
    """
    one, two = as_system(first), as_system(second)
    if one.D.shape != two.D.shape:
        raise InputError(f"systems must have the same size, got {one.D.shape} and {two.D.shape}")
    dt = common_period([one, two])
    plants = [continuous(system).matrices for system in (one, two)]
    right = right_coprime_factors(plants[0], one.name)
    flipped = right_coprime_factors(_transposed(plants[1]), two.name)
    p, m = one.D.shape
    left = _transposed(flipped)
    # N2 M1 - M2 N1 of left factors [N2, M2] and right ones [N1; M1]
    a, b, c, d = left
    swap = np.block([[np.zeros((m, p)), np.eye(m)], [-np.eye(p), np.zeros((p, m))]])
    A, B, C, D = lft.series(right, (a, b @ swap, c, d @ swap))
    # Further outputs of a small gain: of equal systems the difference is rounding alone
    norm = hinf_norm(
        A, B, np.vstack([C, np.zeros((m, len(A)))]), np.vstack([D, as_positive(floor, "floor") * np.eye(m)])
    )
    omega = unwarped_frequency(norm.omega, dt) if dt else norm.omega
    try:
        G1, G2 = (refined_response(*plant, norm.omega) for plant in plants)
        graph: ComplexArray = np.vstack([G1, np.eye(m)])
        other: ComplexArray = np.hstack([G2, np.eye(p)])
    except ValueError:  # a pole of one: the factors, with their rounding
        graph, other = (refined_response(*factor, norm.omega) for factor in (right, left))
    value = min(_chordal_distance(graph, other), 1.0)
    remains = (1.0 - _defect(right)) * (1.0 - _defect(flipped))
    upper = max(norm.upper / sqrt(remains), value) if remains > 0.0 else 1.0
    same, certain = _same_winding(*plants)
    if not (certain and upper < 1.0):
        return NuGap(value, 1.0, omega, same)
    return NuGap(value, upper, omega, True) if same else NuGap(1.0, 1.0, omega, False)


def _transposed(system: Matrices) -> Matrices:
    A, B, C, D = system
    return A.T, C.T, B.T, D.T


def _chordal_distance(graph: ComplexArray, other: ComplexArray) -> float:
    """Chordal distance of right factors ``[N1; M1]`` and left ones ``[N2, M2]`` at a frequency, normalised here."""
    p = len(other)
    swapped = np.hstack([-other[:, -p:], other[:, :-p]])
    inner, outer = linalg.qr(graph, mode="r")[0], linalg.qr(other.conj().T, mode="r")[0]
    half = linalg.solve(inner[: graph.shape[1]].T, (swapped @ graph).T).T
    return float(linalg.norm(linalg.solve(outer[:p].conj().T, half), 2))


def _defect(factors: Matrices) -> float:
    """How far ``N~N + M~M`` is from 1 at most, by twice what it is at the poles and between them.

    A plant of large gain has slow poles of the factors beside fast ones, of which rounding leaves few digits.
    """
    sizes = np.unique(np.abs(linalg.eigvals(factors[0]))) if len(factors[0]) else np.ones(1)
    between = np.sqrt(sizes[1:] * sizes[:-1])
    omega = [0.0, 0.1 * sizes[0], *sizes, *between, 10.0 * sizes[-1], np.inf]
    responses = [refined_response(*factors, w) for w in omega]
    unit = np.eye(responses[0].shape[1])
    return 2.0 * max(float(linalg.norm(U.conj().T @ U - unit, 2)) for U in responses)


def _same_winding(first: Matrices, second: Matrices) -> tuple[bool, bool]:
    """Whether ``[N2; M2]~ [N1; M1]``, regular on the axis, has as many zeros as poles in the right half-plane.

    Its zeros are those of ``1 + G2~ G1``, whose matrix is formed without the factors and without a difference of large
    numbers: of gains of 1e6 and more they leave no digits. The second value tells whether rounding leaves all zeros on
    their side of the axis.
    """
    A1, B1, C1, D1 = first
    A2, B2, C2, D2 = second
    inner = np.eye(D1.shape[1]) + D2.T @ D1
    sizes = linalg.svdvals(inner)
    if not sizes[-1] > EPS * sizes[0]:
        return False, True
    if not len(A1) + len(A2):
        return True, True
    by_states = linalg.solve(inner, np.hstack([D2.T @ C1, B2.T]))
    mixed = C2.T @ linalg.solve(np.eye(len(D1)) + D1 @ D2.T, C1)
    by_first, by_second = by_states[:, : len(A1)], by_states[:, len(A1) :]
    matrix = np.block([[A1 - B1 @ by_first, -B1 @ by_second], [-mixed, C2.T @ D1 @ by_second - A2.T]])
    matrix = in_balanced_units(matrix)[0]
    decomposition: Any = linalg.eig(matrix, left=True)
    zeros, left, right = decomposition
    moved = np.sum(np.abs(left) * (np.abs(matrix) @ np.abs(right)), axis=0)
    certain = np.all(np.abs(zeros.real * np.sum(left.conj() * right, axis=0)) > len(matrix) * EPS * moved)
    return bool(np.sum(zeros.real > 0.0) == len(A2)), bool(certain)
