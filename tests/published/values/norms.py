"""Norms, Hankel singular values and Riccati solutions of the page of published values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import linalg
from scipy.signal import cont2discrete

from lftkit import System, h2_norm, hankel_singular_values, hinf_norm, linf_norm, matrix, nu_gap, s, z
from lftkit.analysis.norms import HInfNorm
from lftkit.analysis.riccati import riccati
from lftkit.arrays import FloatArray, Matrices

Values = Any


def blocks(*given: Any) -> FloatArray:
    return np.asarray(linalg.block_diag(*map(np.array, given)), dtype=float)


LAG = tuple(np.array([[x]]) for x in (-1.0, 1.0, 1.0, 0.0))
THREE = (
    np.array(
        [
            [-1.017041847539126, -0.224182952826418, 0.042538079149249],
            [-0.310374015319095, -0.516461581407780, -0.119195790221750],
            [-1.452723568727942, 1.7995860837102088, -1.491935830615152],
        ]
    ),
    np.array(
        [
            [0.312858596637428, -0.164879019209038],
            [-0.864879917324456, 0.627707287528727],
            [-0.030051296196269, 1.093265669039484],
        ]
    ),
    np.array(
        [
            [1.109273297614398, 0.077359091130425, -1.113500741486764],
            [-0.863652821988714, -1.214117043615409, -0.006849328103348],
        ]
    ),
    np.zeros((2, 2)),
)
TWO = np.array([[-5.0, -3.0], [2.0, -9.0]])
ON_SAMPLES = np.array([[0.2, -0.8], [-0.8, 0.07]])
SEVEN = (
    np.array(
        [
            [-0.81, 0.47, -0.43, 1.58, 0.25, -0.40, 0.92],
            [-0.61, -1.89, 0.80, -1.59, 2.01, 0.98, -0.90],
            [0.50, -1.18, -2.12, -1.56, -1.14, 0.14, -0.87],
            [-1.28, 2.12, 0.47, -1.16, 3.65, -1.23, -1.26],
            [-0.24, -0.08, 1.58, -3.58, -1.26, 1.72, -2.59],
            [1.28, -0.96, -1.28, -0.57, -2.43, -2.43, -0.36],
            [-0.16, 1.53, -0.99, 1.47, 0.61, -2.22, -3.27],
        ]
    ),
    np.array(
        [
            [0.49, -0.18, 0, 1.42, 0, 0, 0],
            [-0.8, 0.7, 0.83, 0, 0.22, 0, -1.15],
            [0.1, 0.72, 2.58, 0, 0.19, -0.08, -1.93],
        ]
    ).T,
    np.array([[0, 0.84, 0.1, 0.3, 0.49, 1.71, 0], [-1.79, -0.89, -0.54, -0.6, 0.74, -0.19, 0]]),
    np.array([[1.36, 0.96, 1.44], [-1.07, 0, -1.96]]),
)
UNSTABLE = (
    blocks([[-0.08, 0.83], [-0.83, -0.08]], [[-0.7, 9.0], [-9.0, -0.7]]),
    np.array([[1.0, 1.0], [0, 0], [1, -1], [0, 0]]),
    np.array([[0.4, 0, 0.4, 0], [0.6, 0, 1, 0]]),
    np.diag([0.3, -0.15]),
)
COUPLED = np.array([[-0.21, 0.2], [0.2, -0.21]])


def held(matrices: Matrices) -> Matrices:
    A, B, C, D, _ = cont2discrete(matrices, 0.1)
    return A, B, C, D


def tight(matrices: Matrices, dt: float | None = None) -> HInfNorm:
    return hinf_norm(*matrices, dt=dt, rtol=1e-12)


def peak(matrices: Matrices, dt: float | None = None) -> Values:
    found = tight(matrices, dt)
    return found.value, found.omega


def scalar(pole: float, B: float = 1.0, D: float = 0.0) -> Matrices:
    A, C = np.array([[pole]]), np.eye(1)
    return A, np.array([[B]]), C, np.array([[D]])


def hankel(number: int) -> float:
    given = System([[1.0, -2.0], [3.0, -4.0]], [[5.0], [7.0]], [[6.0, 8.0]], [[9.0]], [("u", 1)], [("y", 1)])
    return float(hankel_singular_values(given)[number])


def slicot_reduction() -> System:
    """Seven states of SLICOT's documentation of AB09AD."""
    A = np.array(
        [
            [-0.04165, 0.0, 4.92, -4.92, 0.0, 0.0, 0.0],
            [-5.21, -12.5, 0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 3.33, -3.33, 0.0, 0.0, 0.0, 0.0],
            [0.545, 0.0, 0.0, 0.0, -0.545, 0.0, 0.0],
            [0.0, 0.0, 0.0, 4.92, -0.04165, 0.0, 4.92],
            [0.0, 0.0, 0.0, 0.0, -5.21, -12.5, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 3.33, -3.33],
        ]
    )
    B = np.zeros((7, 2))
    B[1, 0] = B[5, 1] = 12.5
    return System(A, B, np.eye(7)[[0, 3, 4]], np.zeros((3, 2)), [("u", 2)], [("y", 3)])


def entries(A: list[list[float]], B: list[list[float]], Q: np.ndarray, R: float) -> Values:
    X = riccati(np.array(A), np.array(B), Q, np.array([[R]]))
    assert X is not None
    return float(X[0, 0]), float(X[0, 1]), float(X[1, 1])


def gap() -> float:
    return nu_gap((1 / (s - 0.001)).system("u", "y"), (1 / (s + 0.001)).system("u", "y")).value


def resonances(driven: float) -> Values:
    A = np.block(
        [[-0.1 * np.eye(10), -np.diag(np.arange(1.0, 11.0))], [np.diag(np.arange(1.0, 11.0)), np.zeros((10, 10))]]
    )
    B = 0.1 * np.r_[np.ones(4), driven, np.ones(5), np.zeros(10)][:, None]
    return peak((A, B, np.r_[np.zeros(10), np.ones(10)][None], np.zeros((1, 1))))


def slicot_modes() -> Values:
    A = blocks([[0, 1], [-0.5, -2e-4]], [[0, 1], [-1, -2e-5]], [[0, 1], [-2, -2e-6]])
    one = np.array([[1.0, 0, 1, 0, 1, 0]])
    return peak((A, one.T, one, np.zeros((1, 1))))


def variance(*, samples: bool) -> float:
    B, C = 0.01 * np.eye(2), np.array([[1.0, 0.0]])
    return h2_norm(COUPLED, B, C, C if samples else 0.0 * C, dt=1.0 if samples else None) ** 2


def manual_third_order() -> float:
    q = z(0.1)
    num, den = q**3 - 2.841 * q**2 + 2.875 * q - 1.004, q**3 - 2.417 * q**2 + 2.003 * q - 0.5488
    return h2_norm(*(num / den).system().matrices, dt=0.1)


def manual_variance() -> float:
    q = z(0.1)
    return 5.0 * h2_norm(*((2 * q + 1) / (q**2 + 0.2 * q + 0.5)).system().matrices, dt=0.1) ** 2


def three_poles_on_samples() -> Matrices:
    q = z(0.05)
    return (q**3 / ((q + 0.5) * (q**2 - 1.4 * q + 0.72801))).system().matrices


def unstable_peak() -> Values:
    found = linf_norm(*UNSTABLE, dt=0.2)
    return found.value, found.omega


def static(D: list[list[float]]) -> float:
    return hinf_norm(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), D).value


FRACTIONS = matrix([[0, 3 * s / (s**2 + s + 10)], [(s + 1) / (s + 5), 2 / (s + 6)]])
BAND_PASS = (s / 520.0) / ((s / 52.0) ** 2 + s / 520.0 + 1)

COMPUTED: dict[str, Callable[[], Values]] = {
    "H2 norm, lag": lambda: h2_norm(*LAG),
    "H-infinity norm, unstable lag": lambda: linf_norm(-LAG[0], -LAG[1], *LAG[2:]).value,
    "H-infinity norm, three states": lambda: tight(THREE).value,
    "H2 norm, three states": lambda: h2_norm(*THREE),
    "H-infinity norm, three states with hold, 0.1 s": lambda: tight(held(THREE), 0.1).value,
    "H2 norm, three states with hold, 0.1 s": lambda: h2_norm(*held(THREE), dt=0.1),
    "first Hankel singular value, two states": lambda: hankel(0),
    "second Hankel singular value, two states": lambda: hankel(1),
    "entries of the Riccati solution, double integrator": lambda: entries(
        [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], np.diag([1.0, 2.0]), 1.0
    ),
    "nu-gap, poles at 0.001 and -0.001": gap,
    "H2 norm, two states, two inputs": lambda: h2_norm(TWO, np.diag([1.0, 2.0]), np.eye(2), np.zeros((2, 2))),
    "H2 norm, two states, one input": lambda: h2_norm(TWO, [[1.0], [2.0]], np.eye(2), np.zeros((2, 1))),
    "H2 norm, two states on samples, two outputs": lambda: h2_norm(
        ON_SAMPLES, np.diag([1.0, 2.0]), np.eye(2), np.zeros((2, 2)), dt=0.005
    ),
    "H2 norm, two states on samples, one output": lambda: h2_norm(
        ON_SAMPLES, np.diag([1.0, 2.0]), [[1.0, 0.0]], np.zeros((1, 2)), dt=0.005
    ),
    "H-infinity norm, two states": lambda: tight((TWO, np.diag([1.0, 2.0]), np.eye(2), np.zeros((2, 2)))).value,
    "H-infinity norm and peak, seven states": lambda: peak(SEVEN),
    "H-infinity norm and peak, band pass of quality 10": lambda: peak(BAND_PASS.system().matrices),
    "H-infinity norm, two lags and two leads": lambda: (
        tight(((s + 2) * (s + 3) / ((s + 4) * (s + 5))).system().matrices).value
    ),
    "H-infinity norm and peak, two by two fractions": lambda: peak(FRACTIONS.system().matrices),
    "H-infinity norm and peak, 1 / (s^2 + s + 1)": lambda: peak((1 / (s**2 + s + 1)).system().matrices),
    "H-infinity norm and peak, ten resonances": lambda: resonances(1.0),
    "H-infinity norm and peak, the fifth of ten resonances driven twice": lambda: resonances(2.0),
    "L-infinity norm and peak, four states on samples, two of them unstable": unstable_peak,
    "H-infinity norm, two states on samples": lambda: (
        tight((ON_SAMPLES, np.diag([1.0, 2.0]), np.array([[1.0, 0.0]]), np.zeros((1, 2))), 0.005).value
    ),
    "H-infinity norm and peak, three states on samples": lambda: peak(three_poles_on_samples(), 0.05),
    "H-infinity norm and peak, pole at 0.8": lambda: peak(scalar(0.8), 1.0),
    "H-infinity norm and peak, pole at -0.8": lambda: peak(scalar(-0.8), 1.0),
    "L-infinity norm, pole at 2 on samples": lambda: linf_norm(*scalar(2.0, 3.0, 1.0), dt=1.0).value,
    "L-infinity norm, 1 / (s^2 - 1)": lambda: linf_norm([[-1.0, 1], [0, 1]], [[0.0], [1]], [[1.0, 0]], [[0.0]]).value,
    "norm, gain matrix": lambda: static([[-0.78593, -1.2707], [0.2638, -1.13143]]),
    "norm, another gain matrix": lambda: static([[0.704473, 1.56483], [-1.6661, -2.16041]]),
    "variance of an output, two coupled lags": lambda: variance(samples=False),
    "variance of an output on samples, with a direct path": lambda: variance(samples=True),
    "entries of the Riccati solution, two states": lambda: entries(
        [[-3.0, 2.0], [1.0, 1.0]], [[0.0], [1.0]], np.array([[1.0, -1.0], [-1.0, 1.0]]), 3.0
    ),
    "H-infinity norm and peak, three modes": slicot_modes,
    "Hankel singular values, seven states": lambda: tuple(hankel_singular_values(slicot_reduction())),
    "peak of 90 / (s^2 + 1.5 s + 90)": lambda: tight((90 / (s**2 + 1.5 * s + 90)).system().matrices).value,
    "peak in dB of (10 s + 21) / (s^2 + 1.4 s + 26)": lambda: (
        20.0 * float(np.log10(tight(((10 * s + 21) / (s**2 + 1.4 * s + 26)).system().matrices).value))
    ),
    "H2 norm, three states, 0.1 s": manual_third_order,
    "variance for intensity 5, two states, 0.1 s": manual_variance,
}
