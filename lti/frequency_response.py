"""Frequency response of large, lightly damped systems at many frequencies and parameter values.

One eigenvalue decomposition, corrected once in balanced units, makes the resolvent diagonal; all frequencies are
then one matrix product. Where modes cancel (a torque that a spring holds back) the eigenvectors alone lose digits: a
step of iterative refinement with the residual of the given matrices, taken at every twelfth frequency, measures how
many, and frequencies near those that lost too much are refined too. The result is believed only after a comparison
with direct solutions at some of the frequencies; a system without a usable basis of eigenvectors is solved directly
at every one.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from lti.eigenvectors import balanced, eigenpairs
from lti.ports import FloatArray, port_slices
from lti.state_space_model import StateSpace

ComplexArray = NDArray[np.complex128]

#: Every so many frequencies the loss of digits is measured.
PROBE = 12

#: Largest relative difference from direct solutions that passes, for the block of a pair of ports.
TOLERANCE = 1e-9


def frequency_response(system: StateSpace, omega: ArrayLike, *, tolerance: float = TOLERANCE) -> ComplexArray:
    """Frequency response ``C (j omega - A)^-1 B + D``.

    Parameters
    ----------
    system : StateSpace
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
    >>> from lti import Port
    >>> lag = StateSpace(*(np.array([[v]]) for v in (-2.0, 2.0, 1.0, 0.0)), (Port("u", 1),), (Port("y", 1),))
    >>> frequency_response(lag, [2.0]).round(12)
    array([[[0.5-0.5j]]])
    """
    w = np.atleast_1d(np.asarray(omega, dtype=float))
    if w.ndim != 1 or not np.all(np.isfinite(w)):
        raise ValueError(f"frequencies must be a vector of finite numbers, got shape {w.shape}")
    if system.A.shape[0] == 0:
        return np.broadcast_to(system.D.astype(complex), (w.size, *system.D.shape)).copy()
    response = _modal(system, w, tolerance)
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


@dataclass(frozen=True)
class _Modes:
    """``A = vectors diag(values) inverse`` of a system or, with fewer outputs than inputs, of its transpose."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    values: ComplexArray
    vectors: ComplexArray
    inverse: ComplexArray

    def plain(self, w: FloatArray) -> ComplexArray:
        """``C (jw - A)^-1 B`` through the eigenvectors, shape (k, p, m)."""
        weight = 1.0 / (1j * w - self.values[:, None])
        left, right = self.C @ self.vectors, self.inverse @ self.B
        k, (n, m) = w.size, right.shape  # the resolvent goes with the inputs: there are fewer of them than outputs
        both = left @ (weight[:, :, None] * right[:, None, :]).reshape(n, k * m)
        return np.asarray(both.reshape(-1, k, m).swapaxes(0, 1))

    def refined(self, w: FloatArray) -> ComplexArray:
        """The same with one step of iterative refinement on ``X = (jw - A)^-1 B``."""
        n, m = self.B.shape
        start, seen = (self.inverse @ self.B)[:, None, :], self.C @ self.vectors
        parts = []
        for chunk in np.array_split(w, max(1, w.size * self.B.size // 2_000_000)):
            k = chunk.size
            weight = 1.0 / (1j * chunk - self.values[:, None])[:, :, None]
            X = self.vectors @ (weight * start).reshape(n, k * m)
            residual = np.empty((n, k, m), dtype=complex)
            residual.real = (self.A @ X.real).reshape(n, k, m)
            residual.imag = (self.A @ X.imag).reshape(n, k, m)
            residual += self.B[:, None, :] - 1j * chunk[:, None] * X.reshape(n, k, m)
            correction = weight * (self.inverse @ residual.reshape(n, k * m)).reshape(n, k, m)
            parts.append((self.C @ X + seen @ correction.reshape(n, k * m)).reshape(-1, k, m).swapaxes(0, 1))
        return np.concatenate(parts)


def _modal(system: StateSpace, w: FloatArray, tolerance: float) -> ComplexArray | None:
    """Resolvent through the eigenvectors, refined where they lose digits; None where they are no basis."""
    A, B, C = balanced(system.A, system.B, system.C)
    transposed = C.shape[0] < B.shape[1]
    if transposed:
        A, B, C = A.T, C.T, B.T
    A = np.ascontiguousarray(A)
    values, vectors = (np.asarray(part, dtype=complex) for part in eigenpairs(A))
    inverse = _inverse(vectors)
    if inverse is None:
        return None
    modes = _Modes(A, np.asarray(B), np.asarray(C), values, vectors, inverse)

    def outer(inner: ComplexArray) -> ComplexArray:
        return np.asarray((inner.swapaxes(1, 2) if transposed else inner) + system.D)

    order = np.argsort(w)
    response = outer(modes.plain(w))
    if not np.all(np.isfinite(response)):
        return None
    probes = order[:: max(1, min(PROBE, w.size // 8))]
    better = outer(modes.refined(w[probes]))
    poor = np.zeros(probes.size, dtype=bool)
    for _, r, c in _port_pairs(system):
        size = _norms(better[:, r, c])
        poor |= _norms(better[:, r, c] - response[probes][:, r, c]) > 0.5 * tolerance * size
    response[probes] = better
    # a frequency is as doubtful as the probes on either side of it
    place = np.searchsorted(w[probes], w)
    doubtful = poor[np.minimum(place, probes.size - 1)] | poor[np.maximum(place - 1, 0)]
    doubtful[probes] = False
    if np.any(doubtful):
        response[doubtful] = outer(modes.refined(w[doubtful]))
    return response


def _port_pairs(system: StateSpace) -> list[tuple[slice, slice, slice]]:
    rows, columns = port_slices(system.outputs).values(), port_slices(system.inputs).values()
    return [(slice(None), r, c) for r in rows for c in columns]


def _norms(block: ComplexArray | FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.sum(np.abs(block) ** 2, axis=(1, 2))))


def _agrees(system: StateSpace, w: FloatArray, response: ComplexArray, tolerance: float) -> bool:
    """Compare with direct solutions at the largest response and at some frequencies spread over the grid.

    Judged for each pair of ports by the norm of its block. Where that fails, a second direct solution with
    balanced matrices tells by its difference what rounding leaves open in any.
    """
    if not np.all(np.isfinite(response)):
        return False
    size = np.abs(response).reshape(w.size, -1).max(axis=1)
    spread = np.linspace(0, w.size - 1, min(w.size, 4)).astype(int)
    chosen = np.unique(np.concatenate([[int(size.argmax())], spread]))
    exact, trial = _direct(system, w[chosen]), response[chosen]
    pairs = _port_pairs(system)
    if all(np.all(_norms((exact - trial)[b]) <= tolerance * _norms(exact[b])) for b in pairs):
        return True
    A, B, C = balanced(system.A, system.B, system.C)
    other = _direct(replace(system, A=A, B=B, C=C), w[chosen])
    return all(
        np.all(_norms((exact - trial)[b]) <= tolerance * _norms(exact[b]) + 10.0 * _norms((exact - other)[b]))
        for b in pairs
    )


def _inverse(vectors: ComplexArray) -> ComplexArray | None:
    """Inverse of the eigenvectors, or None where they are no basis."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", linalg.LinAlgWarning)
        try:
            return np.asarray(linalg.inv(vectors), dtype=complex)
        except (linalg.LinAlgError, linalg.LinAlgWarning):
            return None


def _direct(system: StateSpace, w: FloatArray) -> ComplexArray:
    minus, rows = -system.A.astype(complex), np.arange(system.A.shape[0])
    response = np.empty((w.size, *system.D.shape), dtype=complex)
    for i, x in enumerate(w):
        shifted = minus.copy()
        shifted[rows, rows] += 1j * x
        lu = linalg.lu_factor(shifted, overwrite_a=True, check_finite=False)
        response[i] = system.C @ linalg.lu_solve(lu, system.B, check_finite=False) + system.D
    return response
