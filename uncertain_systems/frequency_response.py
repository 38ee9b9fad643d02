"""Frequency response of large, lightly damped systems at many frequencies and parameter values.

One eigenvalue decomposition turns the resolvent into a sum over modes; complex pairs are merged into
real second-order terms::

    C (jw - A)^-1 B = sum_k (N1_k jw + N0_k) / ((jw)^2 - 2 Re(l_k) jw + |l_k|^2)

which is one matrix product for all frequencies. The result is believed only after a comparison with
direct solutions at some of the frequencies; where the eigenvectors are too ill-conditioned for that,
every frequency is solved directly.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from uncertain_systems.runtime import FloatArray
from uncertain_systems.system import StateSpaceData

ComplexArray = NDArray[np.complex128]

#: Largest relative difference from direct solutions that passes.
TOLERANCE = 1e-10


def frequency_response(system: StateSpaceData, omega: ArrayLike, *, tolerance: float = TOLERANCE) -> ComplexArray:
    """Frequency response ``C (j omega - A)^-1 B + D``.

    Parameters
    ----------
    system : StateSpaceData
        n states, m inputs, p outputs, continuous time.
    omega : array_like, shape (k,)
        Frequencies [rad/s]; none may be an eigenvalue of A on the imaginary axis.
    tolerance : float
        Relative accuracy asked of the modal sum, judged per input-output pair of each checked frequency
        against the largest entry of its row and column.

    Returns
    -------
    ndarray, shape (k, p, m), complex

    Examples
    --------
    >>> from uncertain_systems import Port
    >>> lag = StateSpaceData(*(np.array([[v]]) for v in (-2.0, 2.0, 1.0, 0.0)), (Port("u", 1),), (Port("y", 1),))
    >>> frequency_response(lag, [2.0]).round(12)
    array([[[0.5-0.5j]]])
    """
    w = np.atleast_1d(np.asarray(omega, dtype=float))
    if w.ndim != 1 or not np.all(np.isfinite(w)):
        raise ValueError(f"frequencies must be a vector of finite numbers, got shape {w.shape}")
    if system.A.shape[0] == 0:
        return np.broadcast_to(system.D.astype(complex), (w.size, *system.D.shape)).copy()
    response = _modal_sum(system, w)
    if response is not None and _agrees(system, w, response, tolerance):
        return response
    return _direct(system, w)


def singular_values(response: ComplexArray) -> FloatArray:
    """Singular values, largest first, shape (k, min(p, m))."""
    k, p, m = response.shape
    if min(p, m) == 2:  # by the quadratic of the 2 x 2 Gram matrix, far faster than a general SVD
        gram = response @ response.conj().swapaxes(1, 2) if p == 2 else response.conj().swapaxes(1, 2) @ response
        a, d, b = gram[:, 0, 0].real, gram[:, 1, 1].real, np.abs(gram[:, 0, 1])
        root = np.hypot(0.5 * (a - d), b)
        big = 0.5 * (a + d) + root
        det = np.maximum(a * d - b**2, 0.0)
        small = np.divide(det, big, out=np.zeros(k), where=big > 0)
        return np.sqrt(np.column_stack([big, small]))
    return np.asarray(np.linalg.svd(response, compute_uv=False))


def frequency_grid(
    poles: ArrayLike | Iterable[ArrayLike], low: float, high: float, *, points: int = 400, per_mode: int = 7
) -> FloatArray:
    """Logarithmic grid, refined around each lightly damped pole.

    Parameters
    ----------
    poles : array_like
        Eigenvalues; those with a damping ratio below 0.3 and a frequency between the ends are refined.
    low, high : float
        Ends [rad/s].
    points : int
        Points of the plain logarithmic grid.
    per_mode : int
        Points around each pole, within three half-power widths to each side.

    Returns
    -------
    ndarray, sorted [rad/s]
    """
    if not 0.0 < low < high:
        raise ValueError(f"expected 0 < low < high, got {low} and {high}")
    p = np.concatenate([np.ravel(np.asarray(part)) for part in np.atleast_1d(poles)]).astype(complex)
    size = np.abs(p)
    light = (p.imag > 0) & (-p.real < 0.3 * size) & (size > low) & (size < high)
    spread = np.linspace(-3.0, 3.0, per_mode)
    near = p.imag[light, None] + np.abs(p.real[light, None]) * spread
    grid = np.concatenate([np.geomspace(low, high, points), near.ravel()])
    return np.unique(np.clip(grid, low, high))


def _modal_sum(system: StateSpaceData, w: FloatArray) -> ComplexArray | None:
    """Sum over modes, or None where A has no usable eigenvectors."""
    n, (p, m) = system.A.shape[0], system.D.shape
    scaled, (scale, _) = linalg.matrix_balance(system.A, permute=False, separate=True)
    values, vectors = linalg.eig(scaled, check_finite=False)
    try:
        right = linalg.solve(vectors, system.B / scale[:, None], check_finite=False)
    except (linalg.LinAlgError, linalg.LinAlgWarning):
        return None
    left = (system.C * scale) @ vectors
    real = np.abs(values.imag) <= 1e-13 * np.abs(values)
    upper = (values.imag > 0) & ~real
    keep = real | upper
    if int(2 * upper.sum() + real.sum()) != n or not np.all(np.isfinite(right)):
        return None
    lam = values[keep]
    is_real = real[keep]
    residues = left.T[keep][:, :, None] * right[keep][:, None, :]  # (modes, p, m)
    N1 = np.where(is_real[:, None, None], residues.real, 2.0 * residues.real)
    N0 = -np.where(is_real[:, None, None], 0.0, 2.0 * (residues * lam.conj()[:, None, None]).real)
    s = 1j * w[:, None]
    denominator = np.where(is_real, s - lam.real, s**2 - 2.0 * lam.real * s + np.abs(lam) ** 2)
    weight = 1.0 / denominator
    slope = np.where(is_real, weight, s * weight)
    flat = np.hstack([weight, slope])
    table = np.vstack([N0.reshape(-1, p * m), N1.reshape(-1, p * m)])
    total = np.empty((w.size, p * m), dtype=complex)
    total.real, total.imag = flat.real @ table, flat.imag @ table
    return np.asarray(total.reshape(w.size, p, m) + system.D)


def _agrees(system: StateSpaceData, w: FloatArray, response: ComplexArray, tolerance: float) -> bool:
    """Compare with direct solutions at the largest responses and at some frequencies spread over the grid."""
    size = np.abs(response).reshape(w.size, -1).max(axis=1)
    spread = np.linspace(0, w.size - 1, min(w.size, 6)).astype(int)
    chosen = np.unique(np.concatenate([[int(size.argmax())], spread]))
    exact, trial = _direct(system, w[chosen]), response[chosen]
    rows, columns = np.abs(exact).max(axis=2, keepdims=True), np.abs(exact).max(axis=1, keepdims=True)
    allowed = tolerance * np.minimum(rows, columns) + 1e-300
    return bool(np.all(np.isfinite(trial)) and np.all(np.abs(exact - trial) <= allowed))


def _direct(system: StateSpaceData, w: FloatArray) -> ComplexArray:
    eye = np.eye(system.A.shape[0])
    return np.array(
        [system.C @ linalg.solve(1j * x * eye - system.A, system.B, check_finite=False) + system.D for x in w]
    )
