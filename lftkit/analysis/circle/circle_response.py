"""Expansions of a discrete-time response along the unit circle, with bounds of what they leave out and of rounding.

Around ``z0 = exp(j theta)`` the circle is ``z = z0 (1 + jt) / (1 - jt)`` with a real t, and a modal term is

    1 / (z - pole) = (1 + sum_k (-jt)^k (q + 1) q^(k-1)) / (z0 - pole),   q = (z0 + pole) / (z0 - pole).

The poles and residues are those of the matrices that were given: what rounding may have done to them is computed from
the residual of the eigenvectors, in twice the working precision, and is part of every bound.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from scipy.linalg import lapack

from lftkit.analysis.batched_linalg import inverses
from lftkit.analysis.compensated import matrix_product, two_product, two_sum
from lftkit.analysis.eigenvectors import (
    EPS,
    Modes,
    complex_columns,
    complex_rows,
    corrected_modes,
    eigenvector_residual,
    modes,
)
from lftkit.analysis.hinf.level_iteration import SETTINGS, NormSettings
from lftkit.arrays import ComplexArray, FloatArray, Matrices

ANGLE = 1e-15  # rounding of the angle of a pole or of a point of the circle [rad]
TWICE = 2.0**-74  # rounding of a product in twice the working precision


@dataclass(frozen=True)
class Expansion:
    """Response on intervals of the circle: ``sum_k coefficients[:, k] x^k`` with x from -1 to 1.

    Parameters
    ----------
    coefficients : ndarray, shape (N, K + 1, p, m), complex
    rest : ndarray, shape (N,)
        Norm of what the expansion leaves out, at most; infinite where it does not converge.
    rounding : ndarray, shape (N,)
        Norm of the error by rounding, at most.
    """

    coefficients: ComplexArray
    rest: FloatArray
    rounding: FloatArray


@dataclass(frozen=True)
class CircleModes:
    """Modal form of a stable discrete-time system.

    Parameters
    ----------
    angle, gap : ndarray, shape (n,)
        Of each pole the angle [rad] and the distance from the unit circle, the latter to its own rounding.
    residues : ndarray, shape (n, p m), complex
    sizes : ndarray, shape (n,)
        Norms of the residues.
    inexact : ndarray, shape (n,)
        Error of the residues, at most.
    couplings : ndarray, shape (n, n)
        Magnitudes of the residual in modal coordinates, times the norms of the factors on both sides.
    D : ndarray, shape (p, m)
    settings : NormSettings
    """

    angle: FloatArray
    gap: FloatArray
    residues: ComplexArray
    sizes: FloatArray
    inexact: FloatArray
    couplings: FloatArray
    D: FloatArray
    settings: NormSettings = SETTINGS

    def expansion(self, theta: FloatArray, half: FloatArray) -> Expansion:
        """Expansions around the angles `theta` (N,) [rad], for `half` (N,) to both sides."""
        order, inside = self.settings.order, self.settings.inside
        t = np.tan(0.5 * half)[:, None]
        phi = theta[:, None] - self.angle
        turned = np.exp(1j * phi)
        base = (self.gap - 2.0 * np.sin(0.5 * phi) ** 2) + 1j * turned.imag  # turned - radius, without cancellation
        weight = np.exp(-1j * self.angle) / base
        more = 2.0 * turned / base
        q = more - 1.0
        size, reach = np.abs(weight), np.abs(q)
        moved = t * reach
        converges = moved.max(axis=1, initial=0.0) < inside
        left = 1.0 - np.minimum(moved, inside)
        weights = np.empty((len(theta), order + 1, len(self.gap)), dtype=complex)
        weights[:, 0] = weight
        weights[:, 1] = (-1j * t) * more * weight
        for k in range(1, order):
            weights[:, k + 1] = (-1j * t) * q * weights[:, k]
        coefficients = (weights @ self.residues).reshape(*weights.shape[:2], *self.D.shape)
        coefficients[:, 0] += self.D
        rest = (t * moved**order * np.abs(more) * size / left) @ self.sizes
        # Error of the response where the poles are no farther than 1 / near
        near = size / left
        coupled = np.einsum("ki,ij,kj->k", near, self.couplings, near, optimize=False)
        turn = near * near * self.sizes  # a turn that all poles share moves a peak and keeps its height
        others = turn.sum(axis=1) - turn.max(axis=1, initial=0.0)
        rounding = np.asarray(
            8.0 * EPS * (near @ self.sizes) + near @ self.inexact + 2.0 * coupled + 2.0 * ANGLE * others
        )
        return Expansion(coefficients, np.where(converges, rest, np.inf), rounding)

    def derivatives(self, theta: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Response at the angle `theta` and its first and second derivative with respect to it."""
        phi = theta - self.angle
        turned = np.exp(1j * phi)
        more = 2.0 * turned / (self.gap - 2.0 * np.sin(0.5 * phi) ** 2 + 1j * turned.imag)
        first = -0.25j * more * more * np.exp(-1j * theta)  # t = tan(phi / 2): d/dphi is d/dt, halved
        weights = np.stack([0.5 * more * np.exp(-1j * theta), first, -1j * (more - 1.0) * first])
        G, G1, G2 = (weights @ self.residues).reshape(3, *self.D.shape)
        return G + self.D, G1, G2


def circle_modes(
    system: Matrices, limit: float, settings: NormSettings = SETTINGS
) -> tuple[CircleModes | None, bool | None]:
    """Modal form of a balanced system, and whether all poles have a magnitude below `limit`.

    The form is None where the eigenvectors do not carry it, the answer is None where rounding hides it.
    """
    A, B, C, D = system
    n = len(A)
    eigen = modes(A)
    if eigen.reciprocal_condition * settings.circle_condition < 1.0:
        return None, None
    off = _residual(A, eigen)
    gap, angle = _polar(eigen.poles, off)
    if not np.all(np.abs(off).sum(axis=1) <= settings.separate * np.abs(gap)):
        eigen = corrected_modes(A, eigen)
        vectors = eigen.vectors + eigen.low
        eigen = Modes(eigen.poles, vectors, np.zeros((n, n)), lapack.dgetrf(vectors)[:2])
        off = _residual(A, eigen)
        gap, angle = _polar(eigen.poles, off)
    # Magnitudes of what is left of the residual beside the diagonal, with its own rounding
    size = np.abs(off)
    inverse = len(A) / max(eigen.reciprocal_condition, EPS)
    doubt = inverse * (EPS * float(size.max(initial=0.0)) + TWICE * float(np.abs(A).max(initial=0.0)))
    size[np.diag_indices(len(A))] = 0.0
    couplings = size + doubt
    reach = couplings.sum(axis=1)
    band = 1.0 - limit
    if np.any(np.abs(gap - band) <= 2.0 * reach):
        return None, None
    if np.any(gap <= band):
        return None, False
    if np.any(reach > settings.settled * gap):
        return None, None
    left = complex_columns(eigen.poles, eigen.observed(C))
    # ``V^-1 B`` (n, m), complex, and the error of its rows (n,)
    first = lapack.dgetrs(*eigen.factors, B)[0]
    high, low = matrix_product(eigen.vectors, first)
    correction = lapack.dgetrs(*eigen.factors, (B - high) - low)[0]
    right = complex_rows(eigen.poles, first + correction)
    inverse = len(B) / max(eigen.reciprocal_condition, EPS)
    lost = EPS * float(np.abs(correction).max(initial=0.0)) + TWICE * float(np.abs(first).max(initial=0.0))
    rows, columns = np.sqrt(np.sum(np.abs(left) ** 2, axis=0)), np.sqrt(np.sum(np.abs(right) ** 2, axis=1))
    error = 2.0 * EPS * columns + inverse * lost
    residues = (left.T[:, :, None] * right[:, None, :]).reshape(n, -1)
    inexact = rows * error + 4.0 * EPS * rows * columns
    couplings = couplings * rows[:, None] * columns
    return CircleModes(angle, gap, residues, rows * columns, inexact, couplings, D, settings), True


def _residual(A: FloatArray, eigen: Modes) -> ComplexArray:
    """``V^-1 A V - diag(poles)`` (n, n)."""
    real = lapack.dgetrs(*eigen.factors, eigenvector_residual(A, eigen))[0]
    off = complex_columns(eigen.poles, real)
    first = np.flatnonzero(eigen.poles.imag > 0)
    x, y = off[first], off[first + 1]
    off[first], off[first + 1] = 0.5 * (x - 1j * y), 0.5 * (x + 1j * y)
    return off


def _polar(poles: ComplexArray, off: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Distance from the circle, negative outside, and angle of the poles with the diagonal of `off` added."""
    low = np.diag(off)
    total: FloatArray = np.ones(len(poles))
    error: FloatArray = np.zeros(len(poles))
    for part in (poles.real, poles.imag):
        square, rest = two_product(part, part)
        total, lost = two_sum(total, -square)
        error += lost - rest
    error -= 2.0 * (poles.real * low.real + poles.imag * low.imag) + np.abs(low) ** 2
    gap = (total + error) / (1.0 + np.abs(poles))
    return gap, np.asarray(np.angle(poles + low), dtype=float)


@dataclass(frozen=True)
class CircleResolvents:
    """A discrete-time system of few states by the inverses of ``z - A``, for matrices without a basis of eigenvectors.

    Parameters
    ----------
    A, B, C, D : ndarray, shapes (n, n), (n, m), (p, n), (p, m)
    angle, gap : ndarray, shape (n,)
        Of the computed poles; only to place intervals. That they are inside the circle is shown by the expansions:
        where all of them converge, no pole can have crossed the circle by rounding.
    settings : NormSettings
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    angle: FloatArray
    gap: FloatArray
    settings: NormSettings = SETTINGS

    @classmethod
    def of(cls, system: Matrices, settings: NormSettings = SETTINGS) -> CircleResolvents:
        """Response of a balanced system."""
        poles = modes(system[0]).poles
        return cls(*system, np.asarray(np.angle(poles), dtype=float), 1.0 - np.abs(poles), settings)

    def expansion(self, theta: FloatArray, half: FloatArray) -> Expansion:
        """Expansions around the angles `theta` (N,) [rad], for `half` (N,) to both sides."""
        step = max(1, self.settings.resolvents // self.A.size)
        parts = [self._expansion(theta[k : k + step], half[k : k + step]) for k in range(0, len(theta), step)]
        return Expansion(*(np.concatenate([getattr(x, f.name) for x in parts]) for f in fields(Expansion)))

    def derivatives(self, theta: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Response at the angle `theta` and its first and second derivative with respect to it."""
        size = 1e-3 * max(float(self.gap.min(initial=1.0)), 1e-14)
        coefficients = self._expansion(np.array([theta]), np.array([size])).coefficients[0]
        t = 2.0 * np.tan(0.5 * size)  # t = tan(phi / 2), so that d/dphi = 1/2 d/dt at 0
        return coefficients[0], coefficients[1] / t, 2.0 * coefficients[2] / (t * t)

    def _expansion(self, theta: FloatArray, half: FloatArray) -> Expansion:
        n, order, inside = len(self.A), self.settings.order, self.settings.inside
        z, t = np.exp(1j * theta)[:, None, None], np.tan(0.5 * half)
        R = inverses(z * np.eye(n) - self.A)
        Q = t[:, None, None] * (2.0 * z * R - np.eye(n))
        X = R @ self.B
        coefficients = np.empty((len(theta), order + 1, *self.D.shape), dtype=complex)
        coefficients[:, 0] = self.C @ X + self.D
        excited = np.sqrt(np.sum(np.abs(X) ** 2, axis=(1, 2)))
        X = 2.0 * t[:, None, None] * z * (R @ X)
        moved, seen = np.sqrt(np.sum(np.abs(X) ** 2, axis=(1, 2))), self.C.astype(complex) + 0.0 * z
        observed = np.sqrt(np.sum(np.abs(self.C @ R) ** 2, axis=(1, 2)))
        for k in range(1, order + 1):
            coefficients[:, k] = (-1j) ** k * (self.C @ X)
            X, seen = Q @ X, seen @ Q
        reach = np.sqrt(np.sum(np.abs(Q) ** 2, axis=(1, 2)))
        rounding = 10.0 * n * EPS * (1.0 + float(np.sqrt(np.sum(self.A**2))))
        resolvent = np.sqrt(np.sum(np.abs(R) ** 2, axis=(1, 2)))
        converges = (reach < inside) & (rounding * resolvent < self.settings.settled * (1.0 - inside))
        left = 1.0 - np.minimum(reach, inside)
        rest = np.sqrt(np.sum(np.abs(seen) ** 2, axis=(1, 2))) * moved / left
        error = 2.0 * rounding * observed * excited / left**2 + 8.0 * EPS * float(np.sqrt(np.sum(self.D**2)))
        return Expansion(coefficients, np.where(converges, rest, np.inf), error)
