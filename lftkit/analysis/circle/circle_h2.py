"""H2 norm in discrete time from the matrices that were given: modal form, integer arithmetic, or sums by doubling."""

from __future__ import annotations

import numpy as np

from lftkit.analysis.circle.circle_norm import in_units, stability_limit
from lftkit.analysis.circle.circle_response import ANGLE, CircleModes, circle_modes
from lftkit.analysis.circle.exact_circle_norm import Quotient
from lftkit.analysis.eigenvectors import EPS, modes
from lftkit.analysis.riccati import stein
from lftkit.arrays import Matrices

TRUSTED = 1e-9  # relative error of the variance by rounding, at most
AGREEMENT = 1e-6  # relative difference of the sums with B and with C, at most


def discrete_h2(system: Matrices) -> float | None:
    """H2 norm of a system in discrete time with at least one state; None for an unstable one.

    Raises
    ------
    ArithmeticError
        More than 24 states, and rounding hides the norm.
    """
    given, unit = in_units(system)
    limit = stability_limit(given)
    form, stable = circle_modes(given, limit)
    if stable is False:
        return None
    if form is not None:
        variance, error = _of_modes(form)
        if error <= TRUSTED * variance:
            return unit * float(np.sqrt(variance))
    if (quotient := Quotient.of(given)) is not None:
        return unit * float(np.sqrt(quotient.variance())) if quotient.stable(limit) else None
    # Variance by both Gramians, which must agree
    A, B, C, D = given
    hidden = f"rounding hides the H2 norm of a discrete-time system of order {len(A)}"
    if np.abs(modes(A).poles).max() >= limit:
        raise ArithmeticError(hidden)
    direct = float(np.sum(D**2))
    first = direct + float(np.sum((C @ stein(A, B @ B.T)) * C))
    second = direct + float(np.sum((B.T @ stein(A.T, C.T @ C)) * B.T))
    if not abs(first - second) <= AGREEMENT * abs(first):
        raise ArithmeticError(hidden)
    return unit * float(np.sqrt(max(first, 0.0)))


def _of_modes(form: CircleModes) -> tuple[float, float]:
    """Variance of the output for white noise, and what rounding may have done to it."""
    residues = form.residues
    gap, radius = form.gap[:, None] + form.gap - form.gap[:, None] * form.gap, 1.0 - form.gap
    phi = form.angle[:, None] - form.angle
    turn = 2.0 * np.sin(0.5 * phi) ** 2 - 1j * np.sin(phi)
    apart = gap + radius[:, None] * radius * turn  # 1 - pole_i conj(pole_j)
    products = residues @ residues.conj().T
    variance = float(np.sum(form.D**2) + np.sum(products / apart).real)
    distance = np.abs(apart)
    sizes = form.sizes[:, None] * form.sizes
    turned = sizes / distance**2
    turned[np.diag_indices(len(turned))] = 0.0
    root = np.sqrt(form.gap)
    widest = np.sqrt(np.maximum(form.gap[:, None], form.gap))
    response = float(np.sum(form.inexact / root) + 2.0 * np.sum(form.couplings / (root[:, None] * root * widest)))
    rounding = 16.0 * EPS * float(np.sum(sizes / distance)) + 2.0 * ANGLE * float(turned.sum())
    return max(variance, 0.0), rounding + response * (2.0 * max(variance, 0.0) ** 0.5 + response)
