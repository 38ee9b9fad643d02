"""Gains by a direct solution at one frequency, and their rounding: the modal form never has the last word."""

from __future__ import annotations

import numpy as np
from scipy.linalg import LinAlgError, lapack

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.eigenvectors import EPS
from lftkit.analysis.frequency_response import FrequencyResponse, refined_response
from lftkit.arrays import ComplexArray, FloatArray, Matrices

CANCELLATION = 100.0 * EPS  # rounding of a gain over the sum of the magnitudes of the modal terms


def direct_gain(system: Matrices, omega: float, *, refined: bool = True) -> float:
    """Largest singular value of ``C (j omega - A)^-1 B + D`` at `omega` [rad/s], also at infinity.

    Parameters
    ----------
    system : tuple of ndarray
        Balanced matrices, shapes (n, n), (n, m), (p, n), (p, m).
    omega : float
    refined : bool
        Correct the solution by residuals in twice the working precision; without, for poles far from `omega`.
    """
    if refined:
        return float(largest_gains(refined_response(*system, omega)[None])[0])
    return largest_gain(response_at(system, 1j * omega) if omega < np.inf else system[3])


def response_at(system: Matrices, point: complex) -> ComplexArray:
    """``C (point - A)^-1 B + D``, shape (p, m), by one factorisation.

    Raises
    ------
    LinAlgError
        A pole at the point.
    """
    A, B, C, D = system
    shifted = np.multiply(A, -1.0 + 0.0j, order="F")
    shifted.flat[:: len(A) + 1] += point
    *_, states, singular = lapack.zgesv(shifted, B, overwrite_a=1)
    if singular:
        raise LinAlgError(f"the response at {point} must not be that at a pole")
    return np.asarray(C @ states + D)


def largest_gain(response: FloatArray | ComplexArray) -> float:
    """Largest singular value of one matrix (p, m), in fewer calls than that of a stack."""
    if 1 in response.shape:
        return float(np.sqrt(np.vdot(response, response).real))
    return float(lapack.zgesdd(response, compute_uv=0)[1][0])


def cancellation(response: FrequencyResponse) -> float:
    """Rounding of a gain where the modal terms cancel, at any frequency; 0 in Schur form, where it is not known.

    The largest sum of the magnitudes of the terms is estimated by the terms at the distance of each pole from the axis.
    """
    if not response.modal:
        return 0.0
    poles = response.poles
    distance = np.maximum(np.abs(np.abs(poles) - poles.imag), np.abs(poles.real))
    return CANCELLATION * float(np.sum(response.residue_norms / np.maximum(distance, 1e-300)))
