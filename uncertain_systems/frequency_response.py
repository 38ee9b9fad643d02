"""Frequency response of large, lightly damped systems at many frequencies and parameter values.

One eigenvalue decomposition turns the resolvent into a sum over modes; complex pairs are merged into
real second-order terms::

    C (jw - A)^-1 B = sum_k (N1_k jw + N0_k) / ((jw)^2 - 2 Re(l_k) jw + |l_k|^2)

which is one matrix product for all frequencies. The result is believed only after a comparison with
direct solutions at some of the frequencies. Where it does not pass (paths in which modes cancel, such as
a torque that a spring holds back), one step of iterative refinement on the smaller side (inputs or
outputs) follows, and where even that does not pass, every frequency is solved directly.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from uncertain_systems.runtime import FloatArray, port_slices
from uncertain_systems.system import StateSpaceData

ComplexArray = NDArray[np.complex128]

#: Largest relative difference from direct solutions that passes, for the block of a pair of ports.
TOLERANCE = 1e-9


def frequency_response(system: StateSpaceData, omega: ArrayLike, *, tolerance: float = TOLERANCE) -> ComplexArray:
    """Frequency response ``C (j omega - A)^-1 B + D``.

    Parameters
    ----------
    system : StateSpaceData
        n states, m inputs, p outputs, continuous time.
    omega : array_like, shape (k,)
        Frequencies [rad/s]; none may be an eigenvalue of A on the imaginary axis.
    tolerance : float
        Relative accuracy asked of the modal sum for each pair of ports, beyond what rounding leaves open
        in a direct solution.

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
    for method in (_modal_sum, _refined):
        response = method(system, w)
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
        return np.asarray(np.sqrt(np.column_stack([big, small])))
    return np.asarray(np.linalg.svd(response, compute_uv=False), dtype=float)


def frequency_grid(poles: ArrayLike, low: float, high: float, *, points: int = 400, per_mode: int = 7) -> FloatArray:
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
    p = np.ravel(np.asarray(poles, dtype=complex))
    size = np.abs(p)
    light = (p.imag > 0) & (-p.real < 0.3 * size) & (size > low) & (size < high)
    spread = np.linspace(-3.0, 3.0, per_mode)
    near = p.imag[light, None] + np.abs(p.real[light, None]) * spread
    grid = np.concatenate([np.geomspace(low, high, points), near.ravel()])
    return np.asarray(np.unique(np.clip(grid, low, high)))


def _modal_sum(system: StateSpaceData, w: FloatArray) -> ComplexArray | None:
    """Sum over modes, or None where A has no usable eigenvectors."""
    n, (p, m) = system.A.shape[0], system.D.shape
    balanced = _balanced(system)
    values, vectors = _eigen(balanced.A)
    inverse = _inverse(vectors)
    if inverse is None:
        return None
    right = inverse @ balanced.B
    left = balanced.C @ vectors
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


def _refined(system: StateSpaceData, w: FloatArray) -> ComplexArray | None:
    """Resolvent through the eigenvectors with one step of iterative refinement.

    Works on ``X = (jw - A)^-1 B``, or on its transpose where there are fewer outputs than inputs.
    """
    balanced = _balanced(system)
    A, B, C = balanced.A, balanced.B, balanced.C
    transposed = C.shape[0] < B.shape[1]
    if transposed:
        A, B, C = A.T, C.T, B.T
    values, vectors = _eigen(A)
    inverse = _inverse(vectors)
    if inverse is None:
        return None
    parts = []
    for chunk in np.array_split(w, max(1, w.size * B.size // 4_000_000)):
        s = 1j * chunk[:, None, None]
        weight = 1.0 / (s - values[:, None])
        X = vectors @ (weight * (inverse @ B))
        X = X + vectors @ (weight * (inverse @ (B - (s * X - A @ X))))
        parts.append(C @ X)
    total = np.concatenate(parts)
    return np.asarray((total.swapaxes(1, 2) if transposed else total) + system.D)


def _agrees(system: StateSpaceData, w: FloatArray, response: ComplexArray, tolerance: float) -> bool:
    """Compare with direct solutions at the largest response and at some frequencies spread over the grid.

    Judged for each pair of ports by the norm of its block. Two direct solutions, plain and balanced,
    tell by their difference what rounding leaves open (a path that cancels to almost nothing).
    """
    size = np.abs(response).reshape(w.size, -1).max(axis=1)
    spread = np.linspace(0, w.size - 1, min(w.size, 6)).astype(int)
    chosen = np.unique(np.concatenate([[int(size.argmax())], spread]))
    exact, trial = _direct(system, w[chosen]), response[chosen]
    noise = np.abs(exact - _direct(_balanced(system), w[chosen]))
    if not np.all(np.isfinite(trial)):
        return False
    for rows in port_slices(system.outputs).values():
        for columns in port_slices(system.inputs).values():
            error, scale, floor = (
                np.sqrt(np.sum(np.abs(part[:, rows, columns]) ** 2, axis=(1, 2)))
                for part in (exact - trial, exact, noise)
            )
            if np.any(error > tolerance * scale + 10.0 * floor):
                return False
    return True


def _eigen(A: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    values, vectors = linalg.eig(A, check_finite=False)
    return np.asarray(values, dtype=complex), np.asarray(vectors, dtype=complex)


def _inverse(vectors: ComplexArray) -> ComplexArray | None:
    """Inverse of the eigenvectors, or None where they are no basis."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", linalg.LinAlgWarning)
        try:
            return np.asarray(linalg.inv(vectors), dtype=complex)
        except (linalg.LinAlgError, linalg.LinAlgWarning):
            return None


def _balanced(system: StateSpaceData) -> StateSpaceData:
    scaled, (scale, _) = linalg.matrix_balance(system.A, permute=False, separate=True)
    return replace(system, A=np.asarray(scaled, dtype=float), B=system.B / scale[:, None], C=system.C * scale)


def _direct(system: StateSpaceData, w: FloatArray) -> ComplexArray:
    eye = np.eye(system.A.shape[0])
    return np.array(
        [system.C @ linalg.solve(1j * x * eye - system.A, system.B, check_finite=False) + system.D for x in w]
    )
