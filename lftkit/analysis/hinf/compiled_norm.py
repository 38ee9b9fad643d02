"""The level iteration of a `SmallModel` of few states in compiled code, where Python calls are the cost.

Seeds, steps to the peak and test of the level are those of :mod:`lftkit.analysis.hinf.small_norm`; only the eigenvalues
come from the complex routine of LAPACK, which numba reaches. numba is optional (extra ``fast``) and is imported with
this module. All compiled code is in this file, since its cache follows the changes of one file only. It is written in
loops: each method of an array, each assignment of a slice with the message of its error, is compiled as well, once,
for a second or more.
"""

from __future__ import annotations

import numpy as np

from lftkit.analysis.eigenvectors import EPS
from lftkit.analysis.hinf.half_plane import MAX_CONDITION
from lftkit.analysis.hinf.level_iteration import AGREEMENT, MAX_LEVELS
from lftkit.analysis.hinf.peak_search import FALL, MAX_STEPS
from lftkit.analysis.hinf.small_norm import (
    AT_CIRCLE,
    CANCELLED,
    CLIMB,
    DIRECT,
    DIRECT_OF_MAP,
    LARGE,
    SEPARATION,
    SMALL_GAP,
)
from lftkit.arrays import ComplexArray, FloatArray, Matrices
from lftkit.support.compiled import compiled

Found = tuple[float, float, float]
REFUSED = (-1.0, -1.0, 0.0)


@compiled
def _gram(X: ComplexArray, Y: ComplexArray) -> ComplexArray:
    """``X Y^H`` for wide or square matrices, else ``(Y^H X)^T``: of the smaller of the two sizes."""
    p, m = X.shape
    wide = p <= m
    size, inner = min(p, m), max(p, m)
    out = np.zeros((size, size), dtype=np.complex128)
    for i in range(size):
        for j in range(size):
            for k in range(inner):
                out[i, j] += X[i, k] * np.conj(Y[j, k]) if wide else X[k, i] * np.conj(Y[k, j])
    return out


@compiled
def _gain(G: ComplexArray) -> float:
    """Largest singular value."""
    gram = _gram(G, G)
    if len(gram) == 1:
        return float(np.sqrt(gram[0, 0].real))
    if len(gram) == 2:
        half, middle = 0.5 * (gram[0, 0] - gram[1, 1]).real, 0.5 * (gram[0, 0] + gram[1, 1]).real
        return float(np.sqrt(middle + np.hypot(half, abs(gram[0, 1]))))
    return float(np.sqrt(max(np.linalg.eigh(gram)[0][-1], 0.0)))


@compiled
def _modal(weights: ComplexArray, residues: ComplexArray) -> ComplexArray:
    """Sum of the residues (n, p, m) with `weights` (n,)."""
    n, p, m = residues.shape
    out = np.zeros((p, m), dtype=np.complex128)
    for k in range(n):
        for i in range(p):
            for j in range(m):
                out[i, j] += weights[k] * residues[k, i, j]
    return out


@compiled
def _squared_gain(G: ComplexArray, G1: ComplexArray, G2: ComplexArray) -> Found:
    """As :func:`lftkit.analysis.hinf.peak_search.squared_gain`."""
    gram, first, second, own = _gram(G, G), _gram(G1, G), _gram(G2, G), _gram(G1, G1)
    k = len(gram)
    if k == 1:
        curvature = 2.0 * (second[0, 0].real + own[0, 0].real)
        return gram[0, 0].real, 2.0 * first[0, 0].real, curvature
    values, vectors = np.linalg.eigh(gram)
    slope, curvature = 0.0, 0.0
    for other in range(k - 1, -1, -1):
        along, turned = 0.0j, 0.0
        for i in range(k):
            for j in range(k):
                left, right = np.conj(vectors[i, other]), vectors[j, k - 1]
                along += left * (first[i, j] + np.conj(first[j, i])) * right
                if other == k - 1:
                    turned += (left * (2.0 * second[i, j] + 2.0 * own[i, j]) * right).real
        if other == k - 1:
            slope, curvature = along.real, turned
        else:
            size = abs(along)
            curvature += 2.0 * size * size / max(values[k - 1] - values[other], 1e-300)
    return values[k - 1], slope, curvature


@compiled
def _distance(poles: ComplexArray, omega: float) -> float:
    """Distance from j omega to the nearest pole [rad/s]."""
    best = np.inf
    for pole in poles:
        best = min(best, abs(pole - 1j * omega))
    return best


@compiled
def _climbed(
    poles: ComplexArray, residues: ComplexArray, D: FloatArray, omega: float, gain: float, rtol: float
) -> tuple[float, float]:
    """As :func:`lftkit.analysis.hinf.peak_search.climb`, on the modal form."""
    if omega == np.inf or omega == 0.0:
        return omega, gain
    limit = _distance(poles, omega)
    best, low, high = omega, 0.0, np.inf
    for _ in range(MAX_STEPS):
        term = 1.0 / (1j * omega - poles)
        once = -1j * term * term
        G = _modal(term, residues) + D
        square, slope, curvature = _squared_gain(G, _modal(once, residues), _modal(-2j * once * term, residues))
        if square > gain * gain:
            best, gain = omega, np.sqrt(square)
        if slope * slope <= -4.0 * FALL * rtol * square * curvature:
            break
        if slope > 0.0:
            low = omega
        else:
            high = omega
        step = limit if slope > 0.0 else -limit
        if curvature < 0.0:
            step = min(max(-slope / curvature, -limit), limit)
        omega += step
        if not low < omega < high:
            omega = 0.5 * (low + high)
    return best, gain


@compiled
def _best(poles: ComplexArray, residues: ComplexArray, D: FloatArray, seeds: FloatArray) -> tuple[float, float]:
    """Frequency of the largest gain at the `seeds` and at infinity, and that gain."""
    omega, gain = np.inf, _gain(D.astype(np.complex128))
    for seed in seeds:
        found = _gain(_modal(1.0 / (1j * seed - poles), residues) + D)
        if found >= gain:
            omega, gain = seed, found
    return omega, gain


@compiled
def _seeds(poles: ComplexArray) -> FloatArray:
    """Zero, resonances, magnitudes of the poles."""
    seeds = np.zeros(1 + 2 * len(poles))
    count = 1
    for pole in poles:
        x, y, size = -pole.real, pole.imag, abs(pole)
        if y >= -4.0 * EPS * size:
            seeds[count] = size
            count += 1
            if y > x:
                seeds[count] = np.sqrt((y - x) * (y + x))
                count += 1
    return seeds[:count]


@compiled
def _solved(matrix: ComplexArray, right: ComplexArray) -> ComplexArray:
    """``matrix^-1 right`` by elimination with partial pivoting, in the place of both."""
    n, columns = right.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(k, n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for j in range(columns):
                right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        if matrix[k, k] == 0.0:
            raise np.linalg.LinAlgError("singular matrix")
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, n):
                matrix[i, j] -= factor * matrix[k, j]
            for j in range(columns):
                right[i, j] -= factor * right[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(columns):
            for i in range(k + 1, n):
                right[k, j] -= matrix[k, i] * right[i, j]
            right[k, j] /= matrix[k, k]
    return right


@compiled
def _direct(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, point: complex) -> float:
    """Gain of ``D + C (point I - A)^-1 B``."""
    shifted = -A.astype(np.complex128)
    for k in range(len(A)):
        shifted[k, k] += point
    return _gain(C.astype(np.complex128) @ _solved(shifted, B.astype(np.complex128)) + D.astype(np.complex128))


@compiled
def _hamiltonian(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, level: float) -> ComplexArray:
    """Eigenvalues of the Hamiltonian matrix, imaginary where the gain equals `level`."""
    n, m = len(A), D.shape[1]
    b, c, d = B / np.sqrt(level), C / np.sqrt(level), D / level
    turned = np.ascontiguousarray(d.T)
    across, square, outputs = turned @ c, turned @ d, np.ascontiguousarray(c.T) @ c
    gap, both = np.empty((m, m), dtype=np.complex128), np.empty((m, 2 * n), dtype=np.complex128)
    for i in range(m):
        for j in range(m):
            gap[i, j] = (1.0 if i == j else 0.0) - square[i, j]
        for j in range(n):
            both[i, j], both[i, n + j] = across[i, j], b[j, i]
    solved = _solved(gap, both)
    above, below = b.astype(np.complex128) @ solved, np.ascontiguousarray(across.T).astype(np.complex128) @ solved
    H = np.empty((2 * n, 2 * n), dtype=np.complex128)
    for i in range(n):
        for j in range(n):
            H[i, j], H[i, n + j] = above[i, j] + A[i, j], above[i, n + j]
            H[n + i, j], H[n + i, n + j] = -below[i, j] - outputs[i, j], -below[i, n + j] - A[j, i]
    return np.linalg.eigvals(H)  # type: ignore[return-value]


@compiled
def _crossings(values: ComplexArray, poles: ComplexArray, rounding: float) -> FloatArray:
    """Frequencies of the eigenvalues that may be imaginary, ascending, and the middles between them."""
    places = np.empty(2 * len(values))
    count = 0
    for value in values:
        off, height = abs(value.real), abs(value.imag)
        reach = min(abs(value), _distance(poles, height))
        if off <= 2.0 * np.sqrt(rounding * reach) + rounding:
            at = count
            while at > 0 and places[at - 1] > height:
                places[at] = places[at - 1]
                at -= 1
            places[at] = height
            count += 1
    for k in range(count - 1):
        places[count + k] = 0.5 * (places[k + 1] + places[k])
    return places[: max(2 * count - 1, 0)]


@compiled
def _largest(matrix: ComplexArray) -> float:
    """Largest modulus of an entry; NaN where one is."""
    best = 0.0
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            size = abs(matrix[i, j])
            if np.isnan(size):
                return size  # type: ignore[no-any-return]
            best = max(best, size)
    return best


@compiled
def _column_norm(matrix: ComplexArray) -> float:
    """Largest sum of the moduli of a column; NaN where one is."""
    best = 0.0
    for j in range(matrix.shape[1]):
        size = 0.0
        for i in range(matrix.shape[0]):
            size += abs(matrix[i, j])
        if np.isnan(size):
            return size
        best = max(best, size)
    return best


@compiled
def _residues(left: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Residues (n, p, m) of the modes with the outputs `left` (p, n) and the inputs `right` (n, m)."""
    (p, n), m = left.shape, right.shape[1]
    residues = np.empty((n, p, m), dtype=np.complex128)
    for k in range(n):
        for i in range(p):
            for j in range(m):
                residues[k, i, j] = left[i, k] * right[k, j]
    return residues


@compiled
def norm(system: Matrices, rtol: float, given: Matrices, sign: float, lost: float) -> Found:
    """Gain reached, level not exceeded and frequency [rad/s]; `REFUSED` where this way is not sound.

    The `system` is balanced and in continuous time. With a `sign` other than 0 it is the map of `given`, a
    discrete-time system, exact to `lost` roundings: see :class:`lftkit.analysis.hinf.half_plane.HalfPlane`.
    """
    A, B, C, D = system
    n = len(A)
    poles, vectors = np.linalg.eig(A.astype(np.complex128))
    decay, fastest = np.inf, 0.0
    for pole in poles:
        if not pole.real < 0.0 or (sign != 0.0 and -4.0 * pole.real / abs(1.0 - pole) ** 2 < AT_CIRCLE * n):
            return REFUSED
        decay, fastest = min(decay, -pole.real), max(fastest, abs(pole))
    inverse = np.linalg.inv(vectors)
    condition = n**0.5 * _column_norm(inverse)
    if not condition * n * EPS < 1.0:
        return REFUSED
    residues = _residues(C.astype(np.complex128) @ vectors, inverse @ B.astype(np.complex128))
    rounding = EPS * (max(lost, 1.0) * fastest + lost) * condition
    terms = 0.0
    for k in range(n):
        terms += _largest(residues[k]) / -poles[k].real
    least = max((CANCELLED * EPS / rtol) ** 0.5 * terms, 1.0 / LARGE)
    if rounding > SEPARATION * rtol**0.5 * decay or not terms + _largest(D.astype(np.complex128)) < LARGE:
        return REFUSED
    omega, gain = _best(poles, residues, D, _seeds(poles))
    direct = _gain(D.astype(np.complex128))
    for _ in range(MAX_LEVELS):
        omega, gain = _climbed(poles, residues, D, omega, gain, CLIMB * rtol)
        if omega == np.inf and sign == 0.0:
            value = direct
        elif omega < np.inf and rounding > (DIRECT if sign == 0.0 else DIRECT_OF_MAP) * rtol * _distance(poles, omega):
            return REFUSED
        elif sign == 0.0:
            value = _direct(A, B, C, D, 1j * omega)
        else:
            point = -sign + 0.0j if omega == np.inf else sign * (1.0 + 1j * omega) / (1.0 - 1j * omega)
            value = _direct(given[0], given[1], given[2], given[3], point)
        if abs(value - gain) > AGREEMENT * rtol * value or value <= least:
            return REFUSED
        upper = value * (1.0 + rtol)
        gap = 1.0 - (direct / upper) ** 2
        values = _hamiltonian(A, B, C, D, upper)
        size = 0.0
        for root in values:
            size = max(size, abs(root))
        places = _crossings(values, poles, EPS * (max(lost, 1.0) * size + lost) * condition / gap)
        if not len(places):
            return value, upper, omega
        omega, gain = _best(poles, residues, D, places)
        if gain <= upper:
            sound = rounding <= AGREEMENT * rtol * decay and gap > SMALL_GAP
            return (value, upper, omega) if sound else REFUSED
    return REFUSED


@compiled
def mapped(given: Matrices, sign: float) -> tuple[Matrices, float]:
    """Matrices in continuous time and the condition of ``sign A + I``, as `HalfPlane` has them.

    What :func:`lftkit.systems.sampled.bilinear.to_continuous` says of ``sign A, sign B, C, D``, in compiled code.
    """
    A, B, C, D = given
    n = len(A)
    shifted = sign * A.astype(np.complex128)
    for k in range(n):
        shifted[k, k] += 1.0
    inverse = np.linalg.inv(shifted).real.copy()
    condition = _column_norm(shifted) * _column_norm(inverse.astype(np.complex128))
    own, driven = -2.0 * inverse, inverse @ B
    for k in range(n):
        own[k, k] += 1.0
    matrices = own, driven * sign, 2.0 * (C @ inverse), D - (C @ driven) * sign
    return matrices, condition  # type: ignore[return-value]


def circle_norm(given: Matrices, rtol: float) -> Found:
    """As :func:`norm`, for a balanced system in discrete time, by the maps of `HalfPlane`: the angle [rad] is the last.

    See :class:`lftkit.analysis.hinf.half_plane.HalfPlane`.
    """
    sign = 1.0 if np.trace(given[0]) >= 0.0 else -1.0
    for _ in range(2):
        system, condition = mapped(given, sign)
        if condition <= MAX_CONDITION:
            value, upper, omega = norm(system, rtol, given, sign, condition)
            if value >= 0.0:
                turn = 2.0 * np.arctan(omega)
                return value, upper, turn if sign > 0.0 else np.pi - turn
        sign = -sign
    return REFUSED
