"""Norms on the unit circle with 100 digits (mpmath), and systems in discrete time that are hard in double precision."""

from __future__ import annotations

import warnings

import mpmath as mp
import numpy as np
import scipy.linalg
from scipy import signal

Matrices = tuple[np.ndarray, ...]
EDGES = (0.001, 0.003, 0.01, 0.02, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.97, 0.98, 0.99, 0.995, 0.999)
GOLDEN = (mp.sqrt(5) - 1) / 2


def chebyshev(order: int, edge: float) -> Matrices:
    """Ripple of 0.5 dB, in the coordinates of scipy's tf2ss."""
    return state_space(*signal.cheby1(order, 0.5, edge))


def butterworth(order: int, edge: float) -> Matrices:
    """In the coordinates of scipy's tf2ss."""
    return state_space(*signal.butter(order, edge))


def state_space(b: np.ndarray, a: np.ndarray) -> Matrices:
    """As tf2ss, also where it takes the smallest leading coefficients for zero and leaves D out."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", signal.BadCoefficients)
        A, B, C, D = (np.asarray(x, dtype=float) for x in signal.tf2ss(b, a))
    return A, B, C, D if D.size else np.zeros((len(C), B.shape[1]))


def near_the_circle(rng: np.random.Generator) -> Matrices:
    """Up to nine states in mixed coordinates, poles 1e-9 to 0.1 from the circle, half of them with one near 1 or -1."""
    n = int(rng.integers(1, 9))
    inputs, outputs = rng.integers(1, 4, 2)
    gap, side = 10 ** rng.uniform(-9, -1), int(rng.integers(-1, 2))
    A = rng.normal(size=(n, n))
    A *= (1 - gap) / np.abs(scipy.linalg.eigvals(A)).max()
    if side:
        A = scipy.linalg.block_diag(A, np.array([[side * (1 - gap)]]))
    n = len(A)
    T = rng.normal(size=(n, n)) + 2 * np.eye(n)
    shapes = (n, inputs), (outputs, n), (outputs, inputs)
    return T @ A @ scipy.linalg.inv(T), *(rng.normal(size=shape) for shape in shapes)


def filtered(rng: np.random.Generator) -> Matrices:
    """Butterworth or Chebyshev filter of order 4 to 12."""
    order, edge = int(rng.integers(4, 13)), float(rng.choice(EDGES))
    return (butterworth if rng.random() < 0.5 else chebyshev)(order, edge)


def delayed(rng: np.random.Generator) -> Matrices:
    """Up to four states after a shift register of up to 13."""
    n, k = int(rng.integers(1, 5)), int(rng.integers(1, 14))
    A, B, C, D = (rng.normal(size=shape) for shape in ((n, n), (n, 1), (1, n), (1, 1)))
    A *= 0.95 / np.abs(scipy.linalg.eigvals(A)).max()
    last = np.eye(k)[-1:]
    whole = np.block([[A, B @ last], [np.zeros((k, n)), np.eye(k, k=-1)]])
    return whole, np.vstack([np.zeros((n, 1)), np.eye(k)[:, :1]]), np.hstack([C, D @ last]), np.zeros((1, 1))


def exact_norm(system: Matrices, digits: int = 120) -> tuple[mp.mpf, mp.mpf]:
    """H-infinity norm (infinite if unstable) and largest magnitude of a pole, of the doubles as they are."""
    with mp.workdps(digits):
        A, B, C, D = (mp.matrix(np.atleast_2d(x).tolist()) for x in system)
        own, parts = _leverrier(A, B, C)
        numerator = [[_entry(own, parts, D, i, j) for j in range(D.cols)] for i in range(D.rows)]
        stripped = own[: max(k for k, c in enumerate(own) if c != 0) + 1]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # the order of coefficients has no option before 1.4
            roots = mp.polyroots(stripped, maxsteps=500, extraprec=4 * digits) if len(stripped) > 1 else []
        radius = max((abs(root) for root in roots), default=mp.mpf(0))
        if radius >= 1:
            return mp.inf, radius

        def gain(theta: mp.mpf) -> mp.mpf:
            z = mp.expj(theta)
            q = _value(own, z)
            return _largest([[_value(entry, z) / q for entry in row] for row in numerator])

        return _highest(gain, roots), radius


def exact_h2(system: Matrices, digits: int = 200) -> mp.mpf:
    """H2 norm of a stable system: the sum over the impulse response by doubling."""
    with mp.workdps(digits):
        A, B, C, D = (mp.matrix(np.atleast_2d(x).tolist()) for x in system)
        P, power = B * B.T, A
        for _ in range(60):
            step = power * P * power.T
            P, power = P + step, power * power
            if mp.mnorm(step, "f") < mp.mpf(10) ** (-60) * mp.mnorm(P, "f"):
                break
        covariance = C * P * C.T + D * D.T
        return mp.sqrt(sum(covariance[i, i] for i in range(covariance.rows)))


def _leverrier(A: mp.matrix, B: mp.matrix, C: mp.matrix) -> tuple[list[mp.mpf], list[mp.matrix]]:
    power, own, parts = mp.eye(A.rows), [mp.mpf(1)], []
    for k in range(1, A.rows + 1):
        parts.append(C * power * B)
        product = A * power
        own.append(-sum(product[i, i] for i in range(A.rows)) / k)
        power = product + own[-1] * mp.eye(A.rows)
    return own, parts


def _entry(own: list[mp.mpf], parts: list[mp.matrix], D: mp.matrix, i: int, j: int) -> list[mp.mpf]:
    return [D[i, j] * own[0], *(D[i, j] * c + part[i, j] for c, part in zip(own[1:], parts))]


def _value(coefficients: list[mp.mpf], z: mp.mpc) -> mp.mpc:
    """Polynomial with descending coefficients (Horner)."""
    total = mp.mpc(0)
    for c in coefficients:
        total = total * z + c
    return total


def _largest(G: list[list[mp.mpc]]) -> mp.mpf:
    if min(len(G), len(G[0])) == 1:
        return mp.sqrt(sum(abs(x) ** 2 for row in G for x in row))
    return mp.svd_c(mp.matrix(G), compute_uv=False)[0]


def _highest(gain: object, roots: list[mp.mpc]) -> mp.mpf:
    """Largest gain over half the circle: all local maxima of a grid that is fine at the poles."""
    points = {mp.pi * k / 40 for k in range(41)}
    for root in roots:
        angle, reach = abs(mp.arg(root)), (1 - abs(root)) / 4
        points.add(angle)
        while reach < mp.pi:
            points.update(x for x in (angle - reach, angle + reach) if 0 <= x <= mp.pi)
            reach *= 2
    grid = sorted(points)
    gains = [gain(theta) for theta in grid]  # type: ignore[operator]
    top = max(gains)
    padded = [mp.mpf(0), *gains, mp.mpf(0)]
    for i, value in enumerate(gains):
        if value >= max(padded[i], padded[i + 2]) and value >= 0.7 * max(gains):
            top = max(top, _golden(gain, grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]))
    return top


def _golden(gain: object, low: mp.mpf, high: mp.mpf) -> mp.mpf:
    a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    ga, gb = gain(a), gain(b)  # type: ignore[operator]
    for _ in range(55):
        if ga >= gb:
            high, b, gb = b, a, ga
            a = high - GOLDEN * (high - low)
            ga = gain(a)  # type: ignore[operator]
        else:
            low, a, ga = a, b, gb
            b = low + GOLDEN * (high - low)
            gb = gain(b)  # type: ignore[operator]
    return max(ga, gb)
