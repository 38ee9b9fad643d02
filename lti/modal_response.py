"""Exact frequency responses at many frequencies, O(n^2) or less for each new one.

A state-space model is brought once to a form in which a resolvent is cheap: diagonal (modal) when the
eigenvectors are well conditioned, else complex Schur. Which one was taken never changes the meaning of the answer:
the modal form is used only if it reproduces direct solutions at test frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from lti.eigenvectors import balanced, eigenpairs

sl: Any = scipy.linalg
FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

WORST_CONDITION = 1e8
MODAL_AGREEMENT = 1e-9


@dataclass(frozen=True)
class FrequencyResponse:
    """``C (jw I - A)^-1 B + D`` made ready for evaluation at any frequency.

    Parameters
    ----------
    poles : ndarray, shape (n,), complex
        Eigenvalues of A [rad/s].
    left, right : ndarray, shapes (p, n) and (n, m), complex
        ``C V`` and ``V^-1 B`` (modal form), or ``C Q`` and ``Q^H B`` (Schur form A = Q T Q^H).
    D : ndarray, shape (p, m)
    triangular : ndarray, shape (n, n), complex, or None
        Schur factor T where the modal form was refused.

    Examples
    --------
    A mass on a spring answers in phase below its resonance and in opposition above it:

    >>> g = FrequencyResponse.of([[0, 1], [-1, -0.01]], [[0], [1]], [[1, 0]], [[0]])
    >>> g.at([0.5, 2.0]).real.round(3).ravel().tolist()
    [1.333, -0.333]
    """

    poles: ComplexArray
    left: ComplexArray
    right: ComplexArray
    D: FloatArray
    triangular: ComplexArray | None

    @classmethod
    def of(cls, A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike) -> FrequencyResponse:
        """Bring (A, B, C, D), shapes (n, n), (n, m), (p, n), (p, m), to modal or Schur form."""
        a, b, c, d = (np.asarray(x, dtype=float) for x in (A, B, C, D))
        if len(a) == 0:
            empty = np.zeros(0, dtype=complex)
            return cls(empty, np.zeros((len(d), 0), complex), np.zeros((0, d.shape[1]), complex), d, None)
        a, b, c = balanced(a, b, c)
        modal = cls._modal(a, b, c, d)
        if modal is not None:
            return modal
        T, Q = sl.schur(a.astype(complex), output="complex")
        return cls(np.diag(T).copy(), c @ Q, Q.conj().T @ b, d, T)

    @classmethod
    def _modal(cls, a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FrequencyResponse | None:
        poles, V = eigenpairs(a)
        try:
            factors = sl.lu_factor(V)
        except sl.LinAlgError:  # pragma: no cover - LAPACK answers with a warning instead
            return None
        inverse_norm = sl.lapack.zgecon(factors[0], np.abs(V).sum(axis=0).max())[0]
        if inverse_norm * WORST_CONDITION < 1.0:
            return None
        form = cls(poles, c @ V, sl.lu_solve(factors, b.astype(complex)), d, None)
        return form if _reproduces(form, a, b, c, d) else None

    @property
    def modal(self) -> bool:
        """Whether the diagonal form is in use."""
        return self.triangular is None

    def at(self, omega: ArrayLike) -> ComplexArray:
        """Response at the frequencies `omega` (N,) [rad/s] (infinity allowed): shape (N, p, m), complex."""
        w = np.atleast_1d(np.asarray(omega, dtype=float))
        (p, n), m = self.left.shape, self.right.shape[1]
        out = np.broadcast_to(self.D, (len(w), p, m)).astype(complex)
        finite = np.isfinite(w)
        if n == 0 or not finite.any():
            return out
        if self.triangular is None:
            # (N p, n) times (n, m): one product with the resolvent's diagonal folded into the rows
            gain = 1.0 / (1j * w[finite][:, None] - self.poles)
            rows = (gain[:, None, :] * self.left).reshape(-1, n)
            out[finite] += (rows @ self.right).reshape(-1, p, m)
            return out
        identity = np.eye(n)
        for i in np.flatnonzero(finite):
            shifted = 1j * w[i] * identity - self.triangular
            out[i] += self.left @ sl.solve_triangular(shifted, self.right, check_finite=False)
        return out


def direct_response(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, omega: float) -> ComplexArray:
    """Response (p, m) at one frequency [rad/s] by an LU solution of the original matrices."""
    if not np.isfinite(omega) or len(A) == 0:
        return np.asarray(D, dtype=complex)
    shifted = (-A).astype(complex, order="F")
    shifted[np.diag_indices(len(A))] += 1j * omega
    _, _, resolvent, info = sl.lapack.zgesv(shifted, B.astype(complex), overwrite_a=True)
    if info > 0:
        raise ValueError(f"no frequency response at {omega} rad/s: there is a pole at this frequency")
    return np.asarray(C @ resolvent + D, dtype=complex)


def _reproduces(form: FrequencyResponse, a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> bool:
    sizes = np.abs(form.poles)
    places = np.quantile(sizes, [0.1, 0.4, 0.8])
    places = np.where(places > 0, places, 1.0) * 1.01
    for w, there in zip(places, form.at(places)):
        exact = direct_response(a, b, c, d, float(w))
        if not np.abs(exact - there).max(initial=0.0) <= MODAL_AGREEMENT * np.abs(exact).max(initial=1e-300):
            return False
    return True


def resonances(poles: ComplexArray, damping: float = 0.3) -> FloatArray:
    """Frequencies [rad/s] where poles of damping ratio below `damping` make peaks, ascending."""
    size = np.abs(poles)
    light = (poles.imag > 0) & (-poles.real < damping * size)
    chosen = poles[light]
    return np.sort(np.sqrt(np.maximum(chosen.imag**2 - chosen.real**2, 0.0)))


def refined_grid(
    poles: ComplexArray,
    lowest: float,
    highest: float,
    per_decade: int = 30,
    spread: tuple[float, ...] = (0.0, 0.4, 1.0, 2.5, 6.0, 15.0),
) -> FloatArray:
    """Frequency grid [rad/s]: logarithmic, and fine around every lightly damped pole.

    Around a pole of frequency w and decay a, points stand at w +- s a for every s in `spread`: between two of them
    the gain of that mode changes by a factor below about 2.5, so that no resonance falls between the points.
    """
    count = max(2, int(np.ceil(np.log10(highest / lowest) * per_decade)))
    points = [np.geomspace(lowest, highest, count)]
    light = poles[(poles.imag > 0) & (np.abs(poles.real) < 0.3 * np.abs(poles))]
    points += [light.imag + s * np.abs(light.real) for s in (*spread, *(-s for s in spread))]
    merged = np.unique(np.concatenate(points))
    return np.asarray(merged[(merged >= lowest) & (merged <= highest)])
