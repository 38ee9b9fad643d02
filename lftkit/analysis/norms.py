"""System norms that hold for lightly damped models of hundreds of states.

The H-infinity norm is two-sided: a gain really reached (computed by a direct solution at the reported frequency),
and a level certified never to be exceeded. The gains of discrete-time systems (`dt` given) are those of the given
matrices on the unit circle; a map to continuous time tests the level of few states where it loses almost nothing.
"""

from __future__ import annotations

from cmath import exp
from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.circle.circle_norm import discrete_h2, discrete_norm
from lftkit.analysis.eigenvectors import EPS, balanced
from lftkit.analysis.frequency_response import FrequencyResponse, PoleError
from lftkit.analysis.hinf.hamiltonian_norm import HamiltonianModel
from lftkit.analysis.hinf.interval_norm import InexactModesError, IntervalModel
from lftkit.analysis.hinf.level_iteration import SETTINGS, NormBracket, NormSettings, UndecidedError, bracketed_norm
from lftkit.analysis.hinf.peak_search import largest_gain, response_at
from lftkit.analysis.hinf.small_norm import HalfPlane, SmallModel
from lftkit.arrays import FloatArray, Matrices
from lftkit.errors import InputError
from lftkit.support.scalars import as_positive, is_number
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import given_system
from lftkit.systems.matrices import checked_matrices
from lftkit.systems.sampled.bilinear import to_continuous, unwarped_frequency, warped_frequency


@dataclass(frozen=True)
class HInfNorm:
    """H-infinity norm with its certificate.

    Parameters
    ----------
    value : float
        Gain reached at `omega`: a lower bound. Infinite for an unstable system.
    upper : float
        Level that the gain exceeds nowhere.
    omega : float
        Frequency of the peak [rad/s]; of the least stable pole for an unstable system.
    certificate : str
        ``interval``, ``hamiltonian``, ``static`` or ``unstable``: the test behind `upper`. In discrete time also
        ``polynomial`` (integer arithmetic) and ``none``: rounding leaves it open whether the system is stable, `value`
        is the norm of D and `upper` infinite.
    """

    value: float
    upper: float
    omega: float
    certificate: str


@checked
def hinf_norm(
    A: Any,
    B: ArrayLike | None = None,
    C: ArrayLike | None = None,
    D: ArrayLike | None = None,
    *,
    dt: float | None = None,
    rtol: float = 1e-7,
    certificate: str = "auto",
    settings: NormSettings = SETTINGS,
) -> HInfNorm:
    """H-infinity norm of a system, or of ``x' = A x + B u, y = C x + D u`` (``x+ = ...`` with period `dt`).

    **Infinite for an unstable system**, as hinfnorm of MATLAB answers: only stable systems are in the space, and a
    finite answer would bound no energy. The largest gain on the axis, with poles on both sides of it, is
    :func:`linf_norm`.

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (n, n), (n, m), (p, n), (p, m); or a certain system (:func:`lftkit.as_system`) alone, with its period.
    dt : float, optional
        Sampling period [s] of discrete-time matrices; None or 0: continuous time.
    rtol : float
        Relative distance of the two sides.
    certificate : {"auto", "interval", "hamiltonian"}
        ``auto`` takes the Hamiltonian for up to 40 states whose damping is far from rounding; else the interval test
        where the modal form is sound and the Hamiltonian otherwise. In discrete time the Hamiltonian is that of a map
        to continuous time, for up to 40 states and where neither the map nor the damping brings anything near
        rounding; else intervals of the unit circle are used, and integer arithmetic where rounding would matter and
        there are at most 24 states.
    settings : NormSettings
        Numbers of the algorithms.

    Returns
    -------
    HInfNorm
        ``value <= norm <= upper``, and ``upper <= value (1 + rtol)``. The sides are farther apart where the terms of a
        response without a precise modal form cancel to less than 1e-4 of themselves, and in discrete time where
        rounding of a system of more than 24 states hides the difference. Poles on the unit circle to rounding,
        four roundings per state, count as unstable.

    Raises
    ------
    ValueError
        Shapes that do not fit, numbers that are not finite, an unknown certificate.
    ArithmeticError
        Continuous time, and the iteration did not settle or eigenvalues did not converge.

    Notes
    -----
    Peaks are looked for at every resonance and refined; the level test either confirms that nothing exceeds the best
    by more than `rtol` or names frequencies at which to look again (Bruinsma and Steinbuch 1990).

    Examples
    --------
    The peak of a lightly damped mode is 1 / (2 zeta sqrt(1 - zeta^2)), here zeta = 0.01:

    >>> norm = hinf_norm([[0, 1], [-1, -0.02]], [[0], [1]], [[1, 0]], [[0]])
    >>> round(norm.value, 6), round(norm.omega, 6), norm.upper > norm.value
    (50.0025, 0.9999, True)
    >>> from lftkit import s
    >>> round(hinf_norm(1 / (s**2 + 0.02 * s + 1)).value, 6)
    50.0025
    """
    if certificate not in ("auto", "interval", "hamiltonian"):
        raise InputError(f"certificate must be auto, interval or hamiltonian, got {certificate!r}")
    as_positive(rtol, "rtol")
    (A, B, C, D), dt = given_system(A, B, C, D, dt)
    dt = dt if _is_discrete(dt) else None
    system = _with_signals(checked_matrices(A, B, C, D))
    if dt is None:
        return _continuous(system, rtol, certificate, settings)
    if certificate == "hamiltonian":
        raise InputError("certificate must be auto or interval in discrete time, got 'hamiltonian'")
    A, B, C, D = system
    if len(A) == 0:
        return _norm_of_feedthrough(A, D)
    if certificate == "auto" and len(A) <= settings.small_states and B.any() and C.any():
        # By a map to continuous time, where it cannot lose what decides
        for plane in HalfPlane.of((*balanced(A, B, C), D), settings.map_condition):
            if norm := _small(plane.matrices, rtol, settings, plane):
                return HInfNorm(norm.value, norm.upper, plane.angle(norm.omega) / dt, "hamiltonian")
    peak = discrete_norm(system, rtol, settings)
    if peak is None:
        poles = linalg.eigvals(balanced(A, B, C)[0])
        worst = float(abs(np.angle(poles[np.argmax(np.abs(poles))])))
        return HInfNorm(np.inf, np.inf, worst / dt, "unstable")
    if peak.upper < np.inf and not (B.any() and C.any()):
        return _norm_of_feedthrough(A[:0, :0], D)
    return HInfNorm(peak.value, peak.upper, peak.theta / dt, peak.certificate)


@checked
def linf_norm(
    A: Any,
    B: ArrayLike | None = None,
    C: ArrayLike | None = None,
    D: ArrayLike | None = None,
    *,
    dt: float | None = None,
    rtol: float = 1e-7,
    settings: NormSettings = SETTINGS,
) -> HInfNorm:
    """L-infinity norm: the largest gain on the imaginary axis or the unit circle, of a stable system or not.

    That of a stable system is its H-infinity norm (getPeakGain of MATLAB answers this one).

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (n, n), (n, m), (p, n), (p, m); or a certain system (:func:`lftkit.as_system`) alone, with its period.
    dt : float, optional
        Sampling period [s] of discrete-time matrices; None or 0: continuous time.
    rtol : float
        Relative distance of the two sides.
    settings : NormSettings
        Numbers of the algorithm.

    Returns
    -------
    HInfNorm
        Infinite, with the certificate ``unstable``, only for poles on the axis or the circle, to rounding.

    Raises
    ------
    ValueError
        Shapes that do not fit, numbers that are not finite.
    ArithmeticError
        The iteration did not settle, or eigenvalues did not converge.

    Examples
    --------
    ``1 / (s - 2)``:

    >>> norms = [norm([[2.0]], [[1.0]], [[1.0]], [[0.0]]) for norm in (hinf_norm, linf_norm)]
    >>> [round(norm.value, 6) for norm in norms]
    [inf, 0.5]
    """
    (A, B, C, D), dt = given_system(A, B, C, D, dt)
    last = pi / dt if dt is not None and _is_discrete(dt) else np.inf
    return _band_gain(_with_signals(checked_matrices(A, B, C, D)), (0.0, last), dt, rtol, False, settings)


@checked
def hinf_norms(systems: Iterable[Any], *, rtol: float = 1e-7) -> list[HInfNorm]:
    """H-infinity norms of many systems, or of (A, B, C, D) in continuous time, for instance of parameter samples."""
    matrices = (system if isinstance(system, tuple) else (system,) for system in systems)
    return [hinf_norm(*one, rtol=rtol) for one in matrices]


def band_gain(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    band: tuple[float, float],
    *,
    dt: float | None = None,
    rtol: float = 1e-6,
    stable: bool = True,
) -> HInfNorm:
    """Largest singular value of ``C (jw I - A)^-1 B + D`` for w in a band.

    Parameters
    ----------
    A, B, C, D : array_like
        Shapes (n, n), (n, m), (p, n), (p, m).
    band : tuple of float
        Lowest and highest frequency [rad/s], the latter may be infinite.
    dt : float, optional
        Sampling period [s] of a discrete-time system, whose frequencies end at pi / dt. The level is that of its map to
        continuous time; a pole at z = -1, which has no map, gives an infinite gain.
    rtol : float
        Relative distance of the two sides.
    stable : bool
        Infinite for an unstable system; without, for poles on the imaginary axis or the unit circle only.

    Raises
    ------
    ValueError
        Shapes that do not fit, numbers that are not finite, a band that is empty.
    ArithmeticError
        The iteration did not settle, or eigenvalues did not converge.

    Examples
    --------
    A resonance at 1 rad/s, of which the band sees the flank:

    >>> found = band_gain([[0, 1], [-1, -0.1]], [[0], [1]], [[1, 0]], [[0]], (2.0, 10.0))
    >>> round(found.value, 6), found.omega
    (0.332595, 2.0)
    """
    return _band_gain(_with_signals(checked_matrices(A, B, C, D)), band, dt, rtol, stable, SETTINGS)


def _band_gain(
    system: Matrices, band: tuple[float, float], dt: float | None, rtol: float, stable: bool, settings: NormSettings
) -> HInfNorm:
    as_positive(rtol, "rtol")
    a, b, c, d = system
    last = pi / dt if dt is not None and _is_discrete(dt) else np.inf
    if not (0.0 <= band[0] < band[1] and band[0] < last):
        raise InputError(f"band must be a lower and a higher frequency [rad/s] from 0 to {last:g}, got {band}")
    if not len(a):
        return replace(_norm_of_feedthrough(a, d), omega=float(band[0]))
    if dt is not None and last < np.inf:
        # By a map to continuous time, which keeps every gain; the lower side is the gain of the system itself
        try:
            mapped = to_continuous(*system, dt)
        except ValueError:
            return HInfNorm(np.inf, np.inf, pi / dt, "unstable")
        low, high = (warped_frequency(omega, dt) for omega in band)
        norm = _band_gain(mapped, (low, high), None, rtol, stable, settings)
        omega = unwarped_frequency(norm.omega, dt)
        if not norm.value < np.inf:
            return replace(norm, omega=omega)
        value = largest_gain(response_at(system, exp(1j * omega * dt)))
        return replace(norm, value=value, upper=max(norm.upper, value), omega=omega)
    system = *balanced(a, b, c), d
    response = FrequencyResponse.of(*system, rounding=0.1 * rtol)
    poles = response.poles
    worst = int(np.argmax(poles.real))
    on_axis = float(np.abs(poles.real).min()) <= settings.on_axis * float(np.abs(poles).max())
    if (stable and poles[worst].real >= 0.0) or (not stable and on_axis):
        return HInfNorm(np.inf, np.inf, float(abs(poles[worst].imag)), "unstable")
    model = HamiltonianModel(system, response, rtol, band, settings)
    return HInfNorm(*bracketed_norm(model, settings.levels), "hamiltonian")


@checked
def h2_norm(
    A: Any,
    B: ArrayLike | None = None,
    C: ArrayLike | None = None,
    D: ArrayLike | None = None,
    *,
    dt: float | None = None,
    settings: NormSettings = SETTINGS,
) -> float:
    """H2 norm of a system or of its matrices: rms of the output for white noise of unit (two-sided) density.

    Continuous time: ``sqrt(trace(C P C'))`` with ``A P + P A' + B B' = 0``; infinite for an unstable system or D other
    than 0. Discrete time (`dt` given): rms of y for unit-variance samples, D included; the relative error is about 1e-9
    at most for up to 24 states. Numbers of the algorithms are in `settings`.

    Raises
    ------
    ValueError
        Shapes that do not fit, numbers that are not finite.
    ArithmeticError
        Discrete time, more than 24 states, and rounding hides the norm.

    Examples
    --------
    White noise through 1 / (s + a) has variance 1 / (2 a):

    >>> round(h2_norm([[-2.0]], [[1.0]], [[1.0]], [[0.0]]) ** 2, 12)
    0.25
    """
    (A, B, C, D), dt = given_system(A, B, C, D, dt)
    a, b, c, d = checked_matrices(A, B, C, D)
    if not _is_discrete(dt):
        if np.any(d != 0.0):
            return float("inf")
        if not len(a):
            return 0.0
        a, b, c = balanced(a, b, c)
        T, Q = linalg.schur(a, output="real", check_finite=False)
        if EPS * np.abs(T).max() > settings.schur_rounding * np.abs(np.diag(T)).min():
            response = FrequencyResponse.of(a, b, c, d, check=False, fine=True)
            if response.modal:
                poles, left, right = response.poles, response.left, response.right
                if poles.real.max() >= 0.0 or response.on_axis.size:
                    return float("inf")
                terms = (left.T @ left.conj()) * (right @ right.conj().T) / (poles[:, None] + poles.conj())
                return float(np.sqrt(max(-terms.sum().real, 0.0)))
        if np.diag(T).max() >= -EPS * np.abs(T).max():  # the diagonal of a real Schur form holds the real parts
            return float("inf")
        P, seen = schur_lyapunov(T, (drive := Q.T @ b) @ drive.T), c @ Q
        return float(np.sqrt(max(np.sum((seen @ P) * seen), 0.0)))
    if not len(a):
        return float(np.sqrt(np.sum(d * d)))
    norm = discrete_h2((a, b, c, d), settings)
    return float("inf") if norm is None else norm


def _is_discrete(dt: float | None) -> bool:
    """Whether there is a sampling period: None and 0, as :class:`lftkit.System` has it, are continuous time."""
    if dt is None:
        return False
    if not (is_number(dt) and 0 <= dt < np.inf):
        raise InputError(f"dt must be a sampling period, or None or 0 for continuous time, got {dt!r}")
    return dt > 0


def schur_lyapunov(T: FloatArray, W: FloatArray, *, transposed: bool = False) -> FloatArray:
    """Solution of ``T P + P T' + W = 0`` (or with T transposed) for a quasi-triangular T."""
    trana, tranb = ("T", "N") if transposed else ("N", "T")
    solution, scale, info = linalg.lapack.dtrsyl(T, T, -W, trana=trana, tranb=tranb)
    if info < 0:
        raise ArithmeticError("the Lyapunov equation could not be solved: illegal argument")
    return np.asarray(0.5 * (solution + solution.T) / scale)


@checked
def spectral_abscissa(A: ArrayLike) -> float:
    """Largest real part of the eigenvalues of `A` (n, n) [rad/s]; minus infinity for n = 0."""
    a = np.asarray(A, dtype=float)
    return float(linalg.eigvals(a).real.max(initial=-np.inf)) if a.size else float("-inf")


def is_stable(A: ArrayLike, dt: float = 0.0) -> bool:
    """Whether every pole is in the open left half-plane, or with a period `dt` in the open unit circle."""
    a = np.asarray(A, dtype=float)
    if not dt:
        return spectral_abscissa(a) < 0.0
    return not a.size or bool(np.abs(linalg.eigvals(a)).max() < 1.0)


def _small(
    system: Matrices, rtol: float, settings: NormSettings, origin: HalfPlane | None = None
) -> NormBracket | None:
    """Both sides for few states, or None where rounding could decide."""
    try:
        return bracketed_norm(SmallModel.of(system, rtol, origin, settings), settings.levels)
    except UndecidedError:
        return None


def _continuous(system: Matrices, rtol: float, certificate: str, settings: NormSettings) -> HInfNorm:
    A, B, C, D = system
    if len(A) == 0 or not (B.any() and C.any()):
        return _norm_of_feedthrough(A, D)
    system = *balanced(A, B, C), D
    if certificate == "auto" and len(A) <= settings.small_states and (norm := _small(system, rtol, settings)):
        return HInfNorm(*norm, "hamiltonian")
    response = FrequencyResponse.of(*system, rounding=0.1 * rtol, check=False)
    worst = int(np.argmax(response.poles.real))
    unstable = HInfNorm(np.inf, np.inf, float(abs(response.poles[worst].imag)), "unstable")
    if response.poles[worst].real >= 0.0 or response.on_axis.size:
        return unstable
    for fine in (False, True) if response.modal and certificate != "hamiltonian" else ():
        if fine:  # the slowest decays may be below the rounding of the poles
            response = FrequencyResponse.of(*system, rounding=0.1 * rtol, check=False, fine=True)
        try:
            model = IntervalModel(system, response, rtol, settings)
            return HInfNorm(*bracketed_norm(model, settings.levels), "interval")
        except InexactModesError:
            continue
        except (UndecidedError, PoleError):
            break
    try:
        hamiltonian = HamiltonianModel(system, response, rtol, settings=settings)
        return HInfNorm(*bracketed_norm(hamiltonian, settings.levels), "hamiltonian")
    except PoleError:  # a direct solution meets a pole that is on the axis to rounding
        return HInfNorm(np.inf, np.inf, float(abs(response.poles[worst].imag)), "unstable")


def _with_signals(system: Matrices) -> Matrices:
    """In place of no inputs or no outputs one of each without effect: LAPACK refuses matrices of size zero."""
    if system[3].size:
        return system
    n = len(system[0])
    return system[0], np.zeros((n, 1)), np.zeros((1, n)), np.zeros((1, 1))


def _norm_of_feedthrough(A: FloatArray, D: FloatArray) -> HInfNorm:
    """Norm of D; the states, if any, are not driven or not observed, but they must be stable."""
    if len(A):
        poles = linalg.eigvals(A)
        worst = poles[np.argmax(poles.real)]
        if worst.real >= 0.0:
            return HInfNorm(np.inf, np.inf, float(abs(worst.imag)), "unstable")
    value = float(largest_gains(D[None].astype(complex))[0])
    return HInfNorm(value, value, 0.0, "static")
