"""Frequency response of large, lightly damped systems at many frequencies and parameter values.

A state-space model is brought once to a form in which a resolvent is cheap: modal where the eigenvectors are well
conditioned, else complex Schur. Where modes cancel (a torque that a spring opposes) eigenvectors of working precision
lose digits; here eigenvectors and modal factors are corrected with residuals in twice the working precision, once for
all frequencies. The modal form is used only if it reproduces direct solutions at test frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from lftkit.analysis.compensated import matrix_product, refined_solution
from lftkit.analysis.eigenvectors import (
    EPS,
    Modes,
    balanced,
    complex_columns,
    complex_rows,
    corrected_modes,
    finely_corrected,
    modes,
)
from lftkit.analysis.modal_form import ModalForm
from lftkit.arrays import BoolArray, ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.support.settings import AlgorithmSettings
from lftkit.systems.matrices import frequencies
from lftkit.systems.ports import port_slices
from lftkit.systems.system import System


@dataclass(frozen=True)
class ResponseSettings(AlgorithmSettings):
    """Numbers of the evaluation of frequency responses.

    Attributes
    ----------
    condition : largest condition number of the eigenvectors with which the modal form is used
    agreement : largest relative difference from direct solutions, for the block of a pair of ports
    converged : relative change of the eigenvectors by the last correction
    sampled_converged : the same for a sampled system
    entries : entries of the numerators that are held at once
    block : entries of the arrays of one product, so that they stay in the cache
    few : frequencies up to which the factors are multiplied anew
    large : entries of the numerators above which they are multiplied anew
    """

    condition: float = 1e8
    agreement: float = 1e-9
    converged: float = 1e-9
    sampled_converged: float = 1e-7
    entries: int = 2_000_000
    block: int = 15_000
    few: int = 3
    large: int = 600_000


SETTINGS = ResponseSettings()


class PoleError(InputError):
    """A response was asked for at a pole."""


@dataclass(frozen=True)
class FrequencyResponse:
    """``C (jw I - A)^-1 B + D`` prepared for evaluation at any frequency.

    Parameters
    ----------
    poles : ndarray, shape (n,), complex
        Eigenvalues of A [rad/s]; in the modal form conjugate pairs stand side by side.
    left, right : ndarray, shapes (p, n) and (n, m), complex
        ``C V`` and ``V^-1 B`` (modal form), or ``C Q`` and ``Q^H B`` (Schur form A = Q T Q^H).
    D : ndarray, shape (p, m)
    triangular : ndarray, shape (n, n), complex, or None
        Schur factor T where the modal form was refused.
    settings : ResponseSettings

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
    settings: ResponseSettings = SETTINGS

    @classmethod
    def of(
        cls,
        A: ArrayLike,
        B: ArrayLike,
        C: ArrayLike,
        D: ArrayLike,
        *,
        rounding: float = 0.0,
        check: bool = True,
        fine: bool = False,
        settings: ResponseSettings = SETTINGS,
    ) -> FrequencyResponse:
        """Bring (A, B, C, D), shapes (n, n), (n, m), (p, n), (p, m), to modal or Schur form.

        Parameters
        ----------
        rounding : float
            Largest relative change of a peak by rounding that may pass; above it, eigenvectors and poles are corrected
            in twice the working precision.
        check : bool
            Compare the modal form with direct solutions at three frequencies; leave it out only where the caller
            compares.
        fine : bool
            Correct eigenvectors and poles by residuals with seven digits more: for decays that are below the rounding
            of twice the precision.
        settings : ResponseSettings
        """
        a, b, c, d = (np.asarray(x, dtype=float) for x in (A, B, C, D))
        if len(a) == 0:
            empty = np.zeros(0, dtype=complex)
            return cls(empty, np.zeros((len(d), 0), complex), np.zeros((0, d.shape[1]), complex), d, None, settings)
        a, b, c = balanced(a, b, c)
        eigen = modes(a)
        if EPS * np.abs(eigen.poles).max() > rounding * eigen.reciprocal_condition * np.abs(eigen.poles.real).min():
            eigen = corrected_modes(a, eigen, max(settings.converged, 0.01 * np.sqrt(rounding)))
        if fine:
            eigen = finely_corrected(a, eigen)
        form = cls._with_modes(eigen, a, b, c, d, settings)
        if not (form.modal and check):
            return form
        sizes = np.quantile(np.abs(form.poles), [0.1, 0.4, 0.8])
        omega, tolerance = 1.01 * np.where(sizes > 0, sizes, 1.0), settings.agreement
        exact = (refined_response(a, b, c, d, float(w))[None] for w in omega)
        reproduced = all(_agree(direct, form.at(w), tolerance) for direct, w in zip(exact, omega))
        return form if reproduced else cls._with_schur(a, b, c, d, settings)

    @classmethod
    def of_sampled(
        cls, A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, settings: ResponseSettings = SETTINGS
    ) -> FrequencyResponse:
        """As :meth:`of`, for a sampled system, whose poles are near the unit circle: for :meth:`at_points` alone."""
        a, b, c, d = (np.asarray(x, dtype=float) for x in (A, B, C, D))
        a, b, c = balanced(a, b, c)
        eigen = corrected_modes(a, modes(a), settings.sampled_converged)
        return cls._with_modes(eigen, a, b, c, d, settings)

    @classmethod
    def of_modal_form(
        cls, form: ModalForm, excited: FloatArray, observed: FloatArray, D: FloatArray
    ) -> FrequencyResponse:
        """Response of a system that is known in modal coordinates: nothing is computed twice.

        Parameters
        ----------
        form : ModalForm
        excited, observed : ndarray, shapes (n, m) and (p, n)
            Inputs and outputs in these coordinates.
        D : ndarray, shape (p, m)
        """
        if len(form.block):
            return cls.of(form.matrix, excited, observed, D, check=False)
        m, r = len(form.pairs), len(form.real)
        poles = np.empty(2 * m + r, dtype=complex)
        left, right = np.empty((len(observed), poles.size), complex), np.empty((poles.size, excited.shape[1]), complex)
        poles[: 2 * m : 2], poles[1 : 2 * m : 2], poles[2 * m :] = form.pairs, form.pairs.conj(), form.real
        left[:, : 2 * m : 2] = observed[:, :m] + 1j * observed[:, m : 2 * m]
        right[: 2 * m : 2] = 0.5 * (excited[:m] - 1j * excited[m : 2 * m])
        left[:, 1 : 2 * m : 2], right[1 : 2 * m : 2] = left[:, : 2 * m : 2].conj(), right[: 2 * m : 2].conj()
        left[:, 2 * m :], right[2 * m :] = observed[:, 2 * m :], excited[2 * m :]
        return cls(poles, left, right, D, None)

    @classmethod
    def _with_modes(
        cls, eigen: Modes, a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray, settings: ResponseSettings
    ) -> FrequencyResponse:
        """Modal form where the eigenvectors are a good basis, else Schur form."""
        if not eigen.reciprocal_condition * settings.condition >= 1.0:
            return cls._with_schur(a, b, c, d, settings)
        left, right = complex_columns(eigen.poles, eigen.observed(c)), complex_rows(eigen.poles, eigen.excited(b))
        return cls(eigen.poles, left, right, d, None, settings)

    @classmethod
    def _with_schur(
        cls, a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray, settings: ResponseSettings
    ) -> FrequencyResponse:
        T, Q = linalg.schur(a.astype(complex), output="complex")
        return cls(np.diag(T).copy(), c @ Q, Q.conj().T @ b, d, T, settings)

    @property
    def modal(self) -> bool:
        """Whether the diagonal form is in use."""
        return self.triangular is None

    @cached_property
    def residue_norms(self) -> FloatArray:
        """Norm of the residue at each pole, shape (n,), of the modal form."""
        return np.asarray(
            np.sqrt(np.sum(np.abs(self.left) ** 2, axis=0) * np.sum(np.abs(self.right) ** 2, axis=1)), dtype=float
        )

    def at(self, omega: ArrayLike) -> ComplexArray:
        """Response at the frequencies `omega` (N,) [rad/s] (infinity allowed): shape (N, p, m), complex.

        Raises
        ------
        ValueError
            A frequency at which there is a pole on the imaginary axis.
        """
        w = np.atleast_1d(np.asarray(omega, dtype=float))
        (p, n), m = self.left.shape, self.right.shape[1]
        out = np.empty((len(w), p, m), dtype=complex)
        out[:] = self.D
        finite = np.isfinite(w)
        if n == 0 or p == 0 or m == 0 or not finite.any():
            return out
        if not finite.all():
            out[finite] = self.at(w[finite])
            return out
        # Raise where a frequency is that of a pole on the imaginary axis, to rounding
        for pole, width in zip(self.on_axis, _rounding(self.on_axis, np.abs(self.poles).max())):
            hit = np.abs(np.abs(w) - pole) <= width
            if hit.any():
                raise PoleError(_at_pole(float(w[hit][0])))
        if self.triangular is not None:
            return self.at_points(1j * w)
        if len(w) <= self.settings.few or n * p * m > self.settings.large:
            for i, x in enumerate(w):
                out[i] += (self.left / (1j * x - self.poles)) @ self.right
            return out
        rows = max(1, self.settings.entries // (n * m))
        for start in range(0, p, rows):
            part = slice(start, start + rows)
            numerators = self._numerators if p <= rows else _numerators(self.poles, self.left[part], self.right)
            self._modal_sum(w, numerators, out[:, part])
        return out

    def at_points(self, s: ComplexArray) -> ComplexArray:
        """``C (s I - A)^-1 B + D`` at complex points `s` (N,), none of them a pole: shape (N, p, m)."""
        out = np.empty((s.size, *self.D.shape), dtype=complex)
        out[:] = self.D
        if self.triangular is None:
            flat, step = out.reshape(s.size, -1), max(1, self.settings.block // max(len(self.poles), 1))
            for start in range(0, s.size, step):
                part = slice(start, start + step)
                flat[part] += (1.0 / (s[part, None] - self.poles)) @ self.residues
            return out
        for i, x in enumerate(s):
            shifted = x * np.eye(len(self.poles)) - self.triangular
            out[i] += self.left @ linalg.solve_triangular(shifted, self.right, check_finite=False)
        return out

    def part(self, outputs: slice | list[int], inputs: slice | list[int]) -> FrequencyResponse:
        """The same for some of the outputs and inputs."""
        D = self.D[outputs][:, inputs]
        return FrequencyResponse(
            self.poles, self.left[outputs], self.right[:, inputs], D, self.triangular, self.settings
        )

    def between(self, omega: FloatArray, rows: ComplexArray, columns: ComplexArray) -> ComplexArray:
        """``row G(w) column`` at N finite frequencies [rad/s] without the responses G: shape (N,).

        Parameters
        ----------
        omega : ndarray, shape (N,)
        rows : ndarray, shape (p,) or (N, p)
            One for all frequencies, or one for each.
        columns : ndarray, shape (m, N)
            One for each frequency.
        """
        observed, excited = rows @ self.left, self.right @ columns
        direct = np.sum((rows @ self.D) * columns.T, axis=1)
        if self.triangular is None:
            return np.asarray(direct + np.sum(observed * excited.T / (1j * omega[:, None] - self.poles), axis=1))
        shifted = (1j * w * np.eye(len(self.poles)) - self.triangular for w in omega)
        solved = [linalg.solve_triangular(s, x, check_finite=False) for s, x in zip(shifted, excited.T)]
        return np.asarray(direct + np.sum(np.array(solved).reshape(-1, len(self.poles)) * observed, axis=1))

    @cached_property
    def residues(self) -> ComplexArray:
        """Residue of each pole as a row, shape (n, p m), of the modal form."""
        products = self.left.T[:, :, None] * self.right[:, None, :]
        return np.asarray(products.reshape(len(self.poles), -1), dtype=complex)

    def with_derivatives(self, omega: float) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Response (p, m) at a finite frequency [rad/s] and its first and second derivative with respect to it."""
        if self.triangular is None:
            powers = np.empty((3, len(self.poles)), dtype=complex)
            powers[0] = 1.0 / (1j * omega - self.poles)
            np.multiply(powers[0], powers[0], out=powers[1])
            np.multiply(powers[1], powers[0], out=powers[2])
            G, G1, G2 = (powers @ self.residues).reshape(3, *self.D.shape)
        else:
            shifted = 1j * omega * np.eye(len(self.poles)) - self.triangular
            X = [self.right]
            for _ in range(3):
                X.append(linalg.solve_triangular(shifted, X[-1], check_finite=False))
            G, G1, G2 = (self.left @ x for x in X[1:])
        return G + self.D, -1j * G1, -2.0 * G2

    @cached_property
    def on_axis(self) -> FloatArray:
        """Frequencies of the poles that lie on the imaginary axis to rounding [rad/s]."""
        size = np.abs(self.poles)
        return np.asarray(size[np.abs(self.poles.real) <= _rounding(size)])

    @cached_property
    def _numerators(self) -> FloatArray:
        return _numerators(self.poles, self.left, self.right)

    def _modal_sum(self, w: FloatArray, numerators: FloatArray, out: ComplexArray) -> None:
        """Add the modal terms to `out` (N, p, m) by two products of real matrices.

        A pair gives ``(b + jw a) / ((jw - pole)(jw - conjugate))``, a real pole ``b / (jw - pole)``.
        """
        real, pairs = self.poles[self.poles.imag == 0].real, self.poles[self.poles.imag > 0]
        r, n = len(real), len(self.poles)
        k, shape = r + len(pairs), (-1, *out.shape[1:])
        step = max(1, self.settings.block // max(numerators.shape))
        for start in range(0, len(w), step):
            x = w[start : start + step, None]
            cosine, sine = np.empty((len(x), n)), np.empty((len(x), n))  # parts of the weights of b, then of a
            scale = 1.0 / (real**2 + x**2)
            cosine[:, :r], sine[:, :r] = -real * scale, -x * scale
            re, im = pairs.real**2 - (x - pairs.imag) * (x + pairs.imag), -2.0 * pairs.real * x
            scale = 1.0 / (re**2 + im**2)
            np.multiply(re, scale, out=cosine[:, r:k])
            np.multiply(im, -scale, out=sine[:, r:k])
            np.multiply(x, -sine[:, r:k], out=cosine[:, k:])
            np.multiply(x, cosine[:, r:k], out=sine[:, k:])
            out.real[start : start + step] += (cosine @ numerators).reshape(shape)
            out.imag[start : start + step] += (sine @ numerators).reshape(shape)


def frequency_response(system: System, omega: ArrayLike, *, tolerance: float = SETTINGS.agreement) -> ComplexArray:
    """Frequency response ``C (j omega - A)^-1 B + D``.

    Parameters
    ----------
    system : System
        n states, m inputs, p outputs, continuous time.
    omega : array_like, shape (k,)
        Frequencies [rad/s], finite.
    tolerance : float
        Largest relative difference between the modal sum and direct solutions that passes, for the block of each pair
        of ports, at the largest response and at four frequencies over the grid. Where it is exceeded, each frequency
        is solved directly.

    Returns
    -------
    ndarray, shape (k, p, m), complex

    Raises
    ------
    ValueError
        Frequencies that are no vector of finite numbers, or one at which there is a pole on the imaginary axis.

    Examples
    --------
    >>> from lftkit import Port
    >>> lag = System(*(np.array([[v]]) for v in (-2.0, 2.0, 1.0, 0.0)), (Port("u", 1),), (Port("y", 1),))
    >>> frequency_response(lag, [2.0]).round(12)
    array([[[0.5-0.5j]]])
    """
    w = frequencies(omega)
    system.require_certain()
    system.require_continuous()
    if system.A.shape[0] == 0 or w.size == 0:
        return np.broadcast_to(system.D.astype(complex), (w.size, *system.D.shape)).copy()
    form = FrequencyResponse.of(*system.matrices, check=False)
    A, B, C = balanced(system.A, system.B, system.C)
    if form.modal:
        response = form.at(w)
        size = np.abs(response).reshape(w.size, -1).max(axis=1, initial=0.0)
        spread = np.linspace(0, w.size - 1, min(w.size, 4)).astype(int)
        chosen = np.unique(np.concatenate([[int(size.argmax())], spread]))
        exact = np.array([refined_response(A, B, C, system.D, x) for x in w[chosen]])
        rows, columns = port_slices(system.outputs).values(), port_slices(system.inputs).values()
        if all(_agree(exact[:, r, c], response[chosen][:, r, c], tolerance) for r in rows for c in columns):
            return response
    return np.array([refined_response(A, B, C, system.D, x) for x in w])


def direct_response(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, omega: float) -> ComplexArray:
    """Response (p, m) at one frequency [rad/s] by an LU solution of the matrices as they are.

    Raises
    ------
    ValueError
        A pole at this frequency.
    """
    if not np.isfinite(omega) or len(A) == 0:
        return np.asarray(D, dtype=complex)
    resolvent = linalg.lapack.zgetrs(*_factors(A, omega), B.astype(complex))[0]
    return np.asarray(C @ resolvent + D, dtype=complex)


def refined_response(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, omega: float) -> ComplexArray:
    """As :func:`direct_response`, with iterative refinement.

    The residuals are computed in twice the working precision, so that the solution has the digits that the matrices
    determine, up to a condition of about 1e14. Where the LU factors are too coarse for that, near poles of little
    decay, eigenvectors and poles with seven digits more take their place. The matrices should be balanced.
    """
    if not np.isfinite(omega) or len(A) == 0:
        return np.asarray(D, dtype=complex)
    factors, m = _factors(A, omega), B.shape[1]
    right = np.hstack([B, np.zeros_like(B)])
    X, correction, settled = refined_solution(A, omega, right, lambda rest: _solved(factors, rest))
    if not settled:
        eigen = finely_corrected(A, corrected_modes(A, modes(A)))
        if eigen.reciprocal_condition > EPS:
            with np.errstate(all="ignore"):  # what is not finite does not settle
                other = refined_solution(A, omega, right, lambda rest: eigen.resolvent(omega, rest), fine=True)
            X, correction = other[:2] if other[2] else (X, correction)
    high, low = matrix_product(C, X)
    value = high + (low + C @ correction)
    return np.asarray(value[:, :m] + 1j * value[:, m:] + D, dtype=complex)


def _solved(factors: tuple[ComplexArray, NDArray[np.int32]], right: FloatArray) -> FloatArray:
    """Solution for ``right[:, :m] + j right[:, m:]``, in the same form."""
    m = right.shape[1] // 2
    X = linalg.lapack.zgetrs(*factors, right[:, :m] + 1j * right[:, m:], overwrite_b=True)[0]
    return np.hstack([X.real, X.imag])


def resonances(poles: ComplexArray, damping: float = 0.3) -> FloatArray:
    """Frequencies [rad/s] where poles of damping ratio below `damping` make peaks, ascending."""
    size = np.abs(poles)
    light = (poles.imag > 0) & (-poles.real < damping * size)
    chosen = poles[light]
    return np.sort(np.sqrt(np.maximum(chosen.imag**2 - chosen.real**2, 0.0)))


def _rounding(size: FloatArray, largest: float | None = None) -> FloatArray:
    """Rounding error of corrected poles of the magnitudes `size`, the largest of all being `largest`."""
    return 4.0 * EPS * size + 1e-4 * EPS * (size.max(initial=0.0) if largest is None else largest)


def _numerators(poles: ComplexArray, left: ComplexArray, right: ComplexArray) -> FloatArray:
    """Real numerators b of the real poles, b and a of the pairs, stacked, shape (n, p m)."""
    real, pairs = poles.imag == 0, poles.imag > 0

    def residues(which: BoolArray) -> ComplexArray:
        return (left.T[which, :, None] * right[which, None, :]).reshape(-1, left.shape[0] * right.shape[1])

    of_pairs = residues(pairs)
    constant = -2.0 * (of_pairs * poles[pairs, None].conj()).real
    return np.vstack([residues(real).real, constant, 2.0 * of_pairs.real])


def _factors(A: FloatArray, omega: float) -> tuple[ComplexArray, NDArray[np.int32]]:
    shifted = (-A).astype(complex, order="F")
    shifted[np.diag_indices(len(A))] += 1j * omega
    lu, pivots, info = linalg.lapack.zgetrf(shifted, overwrite_a=True)
    if info > 0:
        raise PoleError(_at_pole(omega))
    return lu, pivots


def _at_pole(omega: float) -> str:
    return f"omega must not be the frequency of a pole on the imaginary axis, got {omega} rad/s"


def _agree(exact: ComplexArray, other: ComplexArray, tolerance: float) -> bool:
    """Whether each matrix of the stack (k, p, m) agrees to `tolerance` times its norm."""
    difference, size = (np.sum(np.abs(x) ** 2, axis=(1, 2)) for x in (exact - other, exact))
    return bool(np.all(difference <= tolerance**2 * size))
