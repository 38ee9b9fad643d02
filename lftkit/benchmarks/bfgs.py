"""BFGS on the H-infinity norm of a closed loop: what a user without the tuner would write.

BFGS with a weak Wolfe line search and random restarts (Lewis and Overton 2013) on the norm itself, stabilised by the
same method on the spectral abscissa. It shares no code with the tuner. The norm is SLICOT's AB13DD where Slycot is
installed, else a level iteration (Bruinsma and Steinbuch 1990).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.analysis.norms import hinf_norm
from lftkit.arrays import FloatArray, Matrices
from lftkit.benchmarks.norms import ab13dd
from lftkit.systems.system import System

STABLE = -1e-9
"""Spectral abscissa [rad/s] from which on a loop counts as unstable."""
SYSTEM = "CISD"  # AB13DD: continuous, E = I, scaled, with D

Function = Callable[[FloatArray], tuple[float, FloatArray]]
Minimiser = Callable[[Function, FloatArray, float], FloatArray]


class FixedOrderLoop:
    """Closed loop of a plant with a controller of fixed order, all entries free, as a function of their vector."""

    def __init__(self, plant: System, order: int) -> None:
        k, n = order, plant.order
        nu, nz = plant.inputs[1].size, plant.outputs[0].size
        nw, ny = plant.inputs[0].size, plant.outputs[1].size
        B, C, D = plant.B, plant.C, plant.D
        self.A = linalg.block_diag(plant.A, np.zeros((k, k)))
        self.B1 = np.vstack([B[:, :nw], np.zeros((k, nw))])
        self.B2 = np.block([[np.zeros((n, k)), B[:, nw:]], [np.eye(k), np.zeros((k, nu))]])
        self.C1 = np.hstack([C[:nz], np.zeros((nz, k))])
        self.C2 = np.block([[np.zeros((k, n)), np.eye(k)], [C[nz:], np.zeros((ny, k))]])
        self.D11, self.D12 = D[:nz, :nw], np.hstack([np.zeros((nz, k)), D[:nz, nw:]])
        self.D21 = np.vstack([np.zeros((k, nw)), D[nz:, :nw]])
        self.shape = (k + nu, k + ny)

    def closed(self, x: FloatArray) -> Matrices:
        """Matrices of the closed loop; the plants have no direct path from u to y."""
        K = x.reshape(self.shape)
        return (
            self.A + self.B2 @ K @ self.C2,
            self.B1 + self.B2 @ K @ self.D21,
            self.C1 + self.D12 @ K @ self.C2,
            self.D11 + self.D12 @ K @ self.D21,
        )

    def norm(self, x: FloatArray) -> tuple[float, FloatArray]:
        """H-infinity norm and gradient; infinite where the loop is unstable."""
        A, B, C, D = self.closed(x)
        if not np.all(np.isfinite(A)):
            return np.inf, np.zeros_like(x)
        poles = linalg.eigvals(A)
        if poles.real.max() >= STABLE:
            return np.inf, np.zeros_like(x)
        try:
            omega = peak_frequency(A, B, C, D, np.abs(poles))
        except ArithmeticError:
            return np.inf, np.zeros_like(x)
        R = linalg.inv(1j * omega * np.eye(len(A)) - A) if np.isfinite(omega) else np.zeros_like(A)
        U, s, Vh = linalg.svd(C @ R @ B + D)
        left = U[:, 0].conj() @ (C @ R @ self.B2 + self.D12)
        right = (self.C2 @ R @ B + self.D21) @ Vh[0].conj()
        return float(s[0]), np.real(np.outer(left, right)).ravel()

    def certified(self, x: FloatArray) -> float:
        """Guaranteed upper bound of the norm; infinite where the loop is unstable or the norm can't be computed."""
        try:
            return hinf_norm(*self.closed(x)).upper
        except (ValueError, ArithmeticError):
            return np.inf

    def abscissa(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Spectral abscissa and gradient."""
        A = self.closed(x)[0]
        if not np.all(np.isfinite(A)):
            return np.inf, np.zeros_like(x)
        solved: Any = linalg.eig(A, left=True, right=True)  # the stubs say two results
        values, left, right = solved
        i = int(np.argmax(values.real))
        scale = left[:, i].conj() @ right[:, i]
        slope = np.outer(left[:, i].conj() @ self.B2, self.C2 @ right[:, i]) / (scale if abs(scale) > 1e-14 else 1e-14)
        return float(values[i].real), np.real(slope).ravel()


def peak_frequency(A: Any, B: Any, C: Any, D: Any, seeds: FloatArray) -> float:
    """Frequency of the largest gain of a stable system [rad/s]; an ArithmeticError where AB13DD gives up."""
    if ab13dd is None:
        return level_iteration(A, B, C, D, seeds)
    n, (p, m) = len(A), D.shape
    return float(ab13dd(*SYSTEM, n, m, p, A, np.eye(n), B, C, D, 1e-9)[1])


def level_iteration(A: Any, B: Any, C: Any, D: Any, first: FloatArray, rtol: float = 1e-8) -> float:
    """Peak frequency: levels raised until the Hamiltonian has no imaginary eigenvalue."""

    def gain(w: float) -> float:
        response = D if not np.isfinite(w) else C @ linalg.solve(1j * w * np.eye(len(A)) - A, B) + D
        return float(linalg.svdvals(response)[0])

    best, omega = max((gain(float(w)), float(w)) for w in (0.0, np.inf, *first))
    for _ in range(30):
        level = best * (1.0 + 2.0 * rtol)
        if level <= 0.0:
            break
        R, S = level**2 * np.eye(D.shape[1]) - D.T @ D, level**2 * np.eye(len(D)) - D @ D.T
        F = A + B @ linalg.solve(R, D.T @ C)
        H = np.block([[F, level * B @ linalg.solve(R, B.T)], [-level * C.T @ linalg.solve(S, C), -F.T]])
        values = linalg.eigvals(H)
        crossings = np.unique(np.abs(values[np.abs(values.real) < 1e-8 * np.maximum(np.abs(values), 1.0)].imag))
        if len(crossings) < 2:
            break
        value, w = max((gain(float(m)), float(m)) for m in 0.5 * (crossings[1:] + crossings[:-1]))
        if value <= best:
            break
        best, omega = value, w
    return omega


def bfgs(
    function: Function, x: FloatArray, deadline: float, stop: float = -np.inf, steps: int = 1000
) -> tuple[FloatArray, float]:
    """BFGS with a weak Wolfe line search by bisection; the best point and its value."""
    f, g = function(x)
    H = np.eye(len(x))
    for step in range(steps):
        d = -H @ g
        if not g @ d < 0 or f < stop or linalg.norm(g) < 1e-14:
            break
        low, high, t, accepted = 0.0, np.inf, 1.0, False
        for _ in range(50):
            new_f, new_g = function(x + t * d)
            if not new_f < f + 1e-4 * t * (g @ d):
                high = t
            elif new_g @ d < 0.9 * (g @ d):
                low = t
            else:
                accepted = True
                break
            if time.monotonic() > deadline:
                break
            t = 0.5 * (low + high) if np.isfinite(high) else 2.0 * t
        if not accepted:
            break
        s, y = t * d, new_g - g
        x, f, g = x + s, new_f, new_g
        if time.monotonic() > deadline:
            break
        if step == 0:
            H *= (s @ y) / (y @ y)
        rho = 1.0 / (s @ y)
        V = np.eye(len(x)) - rho * np.outer(s, y)
        H = V @ H @ V.T + rho * np.outer(s, s)
    return x, f


def by_bfgs(function: Function, x: FloatArray, deadline: float) -> FloatArray:
    """Point that BFGS reaches from a stabilising `x`."""
    return bfgs(function, x, deadline)[0]


def restarted(plant: System, order: int, seconds: float, minimise: Minimiser) -> float:
    """Best certified value from random starts within the wall time."""
    loop, rng, deadline = FixedOrderLoop(plant, order), np.random.default_rng(0), time.monotonic() + seconds
    best = np.inf
    while time.monotonic() < deadline:
        x = rng.standard_normal(loop.shape).ravel() * 10.0 ** rng.uniform(-1, 1)
        x, abscissa = bfgs(loop.abscissa, x, deadline, -1e-3, 200)
        if abscissa < STABLE and np.isfinite(loop.norm(x)[0]):
            best = min(best, loop.certified(minimise(loop.norm, x, deadline)))
    return float(best)
