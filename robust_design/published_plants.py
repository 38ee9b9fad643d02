"""Small plants of the literature for static output feedback and fixed-order H-infinity design.

Data as collected in COMPleib 1.1 (F. Leibfritz 2004; F. Leibfritz and W. Lipinski 2003), each with its own source. All
have ``x' = A x + B1 w + B u, z = C1 x + D11 w + D12 u, y = C x + D21 w``; ports are w, u -> z, y.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lti.ports import Port
from lti.state_space_model import StateSpace


def _plant(
    name: str,
    A: Any,
    B: Any,
    C: Any,
    B1: Any = None,
    C1: Any = None,
    D12: Any = None,
    D11: Any = None,
    D21: Any = None,
) -> StateSpace:
    a, b, c = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (A, B, C))
    n, nu, ny = len(a), b.shape[1], len(c)
    if B1 is None:
        # COMPleib's default: every state disturbed and observed, the commands on the last nu rows
        B1, C1 = np.eye(n), np.eye(n)
        D12 = np.vstack([np.zeros((n - nu, nu)), np.eye(nu)])
    b1, c1, d12 = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (B1, C1, D12))
    nw, nz = b1.shape[1], len(c1)
    d11 = np.zeros((nz, nw)) if D11 is None else np.asarray(D11, dtype=float)
    d21 = np.zeros((ny, nw)) if D21 is None else np.asarray(D21, dtype=float)
    D = np.block([[d11, d12], [d21, np.zeros((ny, nu))]])
    inputs, outputs = (Port("w", nw), Port("u", nu)), (Port("z", nz), Port("y", ny))
    return StateSpace(a, np.hstack([b1, b]), np.vstack([c1, c]), D, inputs, outputs, name)


def _aircraft_1() -> tuple[Any, Any, Any, Any]:
    """Y. S. Hung and A. G. J. MacFarlane, Multivariable Feedback: A Quasi-Classical Approach, Springer 1982."""
    A = [
        [0, 0, 1.132, 0, -1],
        [0, -0.0538, -0.1712, 0, 0.0705],
        [0, 0, 0, 1, 0],
        [0, 0.0485, 0, -0.8556, -1.013],
        [0, -0.2909, 0, 1.0532, -0.6859],
    ]
    B = [[0, 0, 0], [-0.12, 1, 0], [0, 0, 0], [4.419, 0, -1.665], [1.575, 0, -0.0732]]
    B1 = [
        [3.593e-2, 0, 1.672e-2],
        [0, 9.89e-3, 0],
        [0, -7.548e-2, 0],
        [0, 0, 5.635e-2],
        [1.45e-3, 0, 6.743e-2],
    ]
    return A, B, np.eye(3, 5), B1


def ac1() -> StateSpace:
    """Aircraft, vertical dynamics (Hung and MacFarlane 1982)."""
    A, B, C, B1 = _aircraft_1()
    half = np.sqrt(0.5)
    return _plant("AC1", A, B, C, B1, half * np.eye(5)[1:3], half * np.eye(2, 3))


def ac2() -> StateSpace:
    """As AC1, all three commands weighted."""
    A, B, C, B1 = _aircraft_1()
    half = np.sqrt(0.5)
    C1 = np.vstack([np.eye(5)[1:3], np.zeros((3, 5))])
    return _plant("AC2", A, B, C, B1, half * C1, half * np.vstack([np.zeros((2, 3)), np.eye(3)]))


def ac3() -> StateSpace:
    """L-1011 aircraft in cruise (C. Edwards and S. K. Spurgeon, Int. J. Control 59(5), 1994)."""
    A = [
        [0, 0, 1, 0, 0],
        [0, -0.154, -0.0042, 1.54, 0],
        [0, 0.249, -1, -5.2, 0],
        [0.0386, -0.996, -0.0003, -0.117, 0],
        [0, 0.5, 0, 0, -0.5],
    ]
    B = [[0, 0], [-0.744, -0.032], [0.337, -1.12], [0.02, 0], [0, 0]]
    C = [[0, 1, 0, 0, -1], [0, 0, 1, 0, 0], [0, 0, 0, 1, 0], [1, 0, 0, 0, 0]]
    return _plant("AC3", A, B, C)


def ac4() -> StateSpace:
    """Missile autopilot (B. Fares, P. Apkarian and D. Noll, Int. J. Control 74(4), 2001)."""
    A = [[-0.876, 1, -0.1209, 0], [8.9117, 0, -130.75, 0], [0, 0, -150, 0], [-1, 0, 0, -0.05]]
    B = [[0], [0], [150], [0]]
    C = [[-1, 0, 0, 0], [0, -1, 0, 0]]
    B1 = [[0, 0], [0, 0], [0, 0], [0, 1]]
    C1 = [[-0.25, 0, 0, 3.487], [0, 0, -3, 0]]
    return _plant("AC4", A, B, C, B1, C1, [[0], [3]], [[0, 0.25], [0, 0]], [[0, 1], [0.01, 0]])


def ac6() -> StateSpace:
    """L-1011 aircraft with actuators, seven states (as collected in COMPleib)."""
    A = [
        [0, 0, 1, 0, 0, 0, 0],
        [0, -0.154, -0.0042, 1.54, 0, -0.744, -0.032],
        [0, 0.249, -1, -5.2, 0, 0.337, -1.12],
        [0.0386, -0.996, -0.0003, -2.117, 0, 0.02, 0],
        [0, 0.5, 0, 0, -4, 0, 0],
        [0, 0, 0, 0, 0, -20, 0],
        [0, 0, 0, 0, 0, 0, -25],
    ]
    B = [[0, 0], [0, 0], [0, 0], [0, 0], [0, 0], [20, 0], [0, 25]]
    C = [
        [0, -0.154, -0.0042, 1.54, 0, -0.744, -0.032],
        [0, 0.249, -1, -5.2, 0, 0.337, -1.12],
        [1, 0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 1, 0, 0],
    ]
    return _plant("AC6", A, B, C)


def _transport() -> tuple[Any, Any, Any, Any]:
    A = [
        [-0.037, 0.0123, 0.00055, -1],
        [0, 0, 1, 0],
        [-6.37, 0, -0.23, 0.0618],
        [1.25, 0, 0.016, -0.0457],
    ]
    B = [[0.00084, 0.000236], [0, 0], [0.08, 0.804], [-0.0862, -0.0665]]
    return A, B, np.eye(6, 4), np.vstack([np.zeros((4, 2)), np.eye(2)])


def ac15() -> StateSpace:
    """Supersonic transport at Mach 2.7, three measurements (IEEE Trans. Autom. Control 19, 257-258, 1974)."""
    A, B, C1, D12 = _transport()
    return _plant("AC15", A, B, np.eye(4)[1:], np.eye(4), C1, D12)


def ac16() -> StateSpace:
    """As AC15 with all four states measured."""
    A, B, C1, D12 = _transport()
    return _plant("AC16", A, B, np.eye(4), np.eye(4), C1, D12)


def ac17() -> StateSpace:
    """Lateral axis of an L-1011 (A. R. Galimidi and B. R. Barmish, IEEE Trans. Autom. Control 31(5), 1986)."""
    A = [
        [-2.98, 0.93, 0, -0.034],
        [-0.99, -0.21, 0.035, -0.0011],
        [0, 0, 0, 1],
        [0.39, -5.555, 0, -1.89],
    ]
    return _plant("AC17", A, [[-0.032], [0], [0], [-1.6]], [[0, 0, 1, 0], [0, 0, 0, 1]])


def he1() -> StateSpace:
    """VTOL helicopter, longitudinal (S. N. Singh and A. A. R. Coelho, J. Dyn. Syst. Meas. Control 106, 1984)."""
    A = [
        [-0.0366, 0.0271, 0.0188, -0.4555],
        [0.0482, -1.01, 0.0024, -4.0208],
        [0.1002, 0.3681, -0.7070, 1.42],
        [0, 0, 1, 0],
    ]
    B = [[0.4422, 0.1761], [3.5446, -7.5922], [-5.52, 4.49], [0, 0]]
    B1 = [[4.678e-2, 0], [4.572e-2, 9.88e-3], [4.369e-2, 1.11e-3], [-2.179e-2, 0]]
    half = np.sqrt(0.5)
    C1 = half * np.array([[2.0, 0, 0, 0], [0, 1, 0, 0]])
    return _plant("HE1", A, B, [[0, 1, 0, 0]], B1, C1, half * np.eye(2))


def he2() -> StateSpace:
    """AH-64 helicopter at 130 knots (P. M. Fitzsimons, Automatica 31, 1885-1887, 1995)."""
    A = [
        [-0.0649, 0.0787, 0.1705, -0.5616],
        [0.0386, -0.939, 4.2277, 0.0198],
        [0.1121, -0.4254, -0.7968, 0],
        [0, 0, 1, 0],
    ]
    B = [[-0.9454, 0.5313], [-8.6476, -10.769], [19.0824, -2.8959], [0, 0]]
    return _plant("HE2", A, B, [[1, 0, 0, 0], [0, 0, 0, 1]])


def rea1() -> StateSpace:
    """Chemical reactor (Hung and MacFarlane 1982)."""
    A = [
        [1.38, -0.2077, 6.715, -5.676],
        [-0.5814, -4.29, 0, 0.675],
        [1.067, 4.273, -6.654, 5.893],
        [0.048, 4.273, 1.343, -2.104],
    ]
    B = [[0, 0], [5.679, 0], [1.136, -3.146], [1.136, 0]]
    return _plant("REA1", A, B, [[1, 0, 1, -1], [0, 1, 0, 0], [0, 0, 1, -1]])


def rea2() -> StateSpace:
    """As REA1 (three-digit data) without the last measurement."""
    A = [
        [1.4, -0.208, 6.715, -5.676],
        [-0.581, -4.29, 0, 0.675],
        [1.067, 4.273, -6.654, 5.893],
        [0.048, 4.273, 1.343, -2.104],
    ]
    B = [[0, 0], [5.679, 0], [1.136, -3.146], [1.136, 0]]
    return _plant("REA2", A, B, [[1, 0, 1, -1], [0, 1, 0, 0]])


def dis2() -> StateSpace:
    """Two control stations (W. Q. Liu and V. Sreeram, J. Optim. Theory Appl. 93)."""
    A = [[-4, 2, 1], [3, -2, 5], [-7, 0, 3]]
    return _plant("DIS2", A, [[1, 0], [1, 0], [0, 1]], [[0, 1, 0], [0, 0, 1]])


def dis3() -> StateSpace:
    """Interconnected system (M. Saif and Y. Guan, Automatica 28(1), 215-219, 1992)."""
    A = [
        [-1, 0, 0, 0, 0, 0],
        [-1, 1, 1, 0, 0, 0],
        [1, -2, -1, -1, 1, 1],
        [0, 0, 0, -1, 0, 0],
        [-8, 1, -1, -1, -2, 0],
        [4, -0.5, 0.5, 0, 0, -4],
    ]
    B = [[0, 1, 0, 0], [1, 0, 0, 0], [1, 1, 0, 0], [0, 0, 0, -1], [0, 0, 1, 0], [0, 0, 0, 1]]
    C = [[0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]]
    return _plant("DIS3", A, B, C)


PLANTS: dict[str, Callable[[], StateSpace]] = {
    f().name: f for f in (ac1, ac2, ac3, ac4, ac6, ac15, ac16, ac17, he1, he2, rea1, rea2, dis2, dis3)
}
