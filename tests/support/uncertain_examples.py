"""Uncertain systems of the literature and by construction, for bounds of gain and stability."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from lftkit import Port, RealParameter, System

FIXTURES = Path(__file__).parents[1] / "fixtures"


def de_gaston_safonov() -> System:
    """``800 (1 + 0.1 d1) (s + 2) / (s (s + 4 + 0.2 d2) (s + 6 + 0.3 d3) (s + 10))`` under unit feedback.

    de Gaston and Safonov, IEEE Trans. AC 33 (1988), 156-171: km = 3.41740.
    """
    A = np.array([[-10.0, 0, 0, -1], [-6400, -4, 0, -800], [0, 1, -6, 0], [0, 0, 1, 0]])
    B = np.array([[0.0, 0, 0], [80, -0.2, 0], [0, 0, -0.3], [0, 0, 0]])
    C = np.array([[-8.0, 0, 0, -1], [0, 1, 0, 0], [0, 0, 1, 0]])
    names = ("d1", "d2", "d3")
    parameters = tuple(RealParameter(name, 0.0, -1.0, 1.0) for name in names)
    return System(A, B, C, np.zeros((3, 3)), (), (), channels=names, elements=parameters)


def two_mass_benchmark(masses: bool = True) -> System:
    """Two masses and a spring, all 1 +- 20 %, under ``100 (s + 1)^3 / (0.001 s + 1)^3`` from the second position.

    The benchmark of Wie and Bernstein (ACC 1990) with the controller of the Robust Control Toolbox's manual, "Robust
    Stability and Worst-Case Gain of Uncertain System": margin between 2.8826 and 2.8864, at 575.0339 rad/s, with
    k = 1.5773. Without `masses` the spring alone is uncertain.
    """
    plant = np.array([[0.0, 1, 0, 0], [-1, 0, 1, 0], [0, 0, 0, 1], [1, 0, -1, 0]])
    w_in = np.array([[0.0, 0, 0], [1, -1, 0], [0, 0, 0], [-1, 0, -1]])
    u_in = np.array([[0.0], [1], [0], [0]])
    z_out, y_out = np.array([[-1.0, 0, 1, 0], [-1, 0, 1, 0], [1, 0, -1, 0]]), np.array([[0.0, 0, 1, 0]])
    z_w, z_u = np.array([[0.0, 0, 0], [1, -1, 0], [-1, 0, -1]]), np.array([[0.0], [1], [0]])
    # each factor is 1000 - 999000 / (s + 1000); the three follow one another
    a, g, d = 1000.0, 999.0, 1000.0
    K_A = np.array([[-a, 0, 0], [-g * a, -a, 0], [-g * d * a, -g * a, -a]])
    K_B = np.array([[a], [a * d], [a * d * d]])
    K_C, K_D = 100.0 * np.array([[-g * d * d, -g * d, -g]]), np.array([[100.0 * d**3]])
    A = np.block([[plant - u_in @ K_D @ y_out, u_in @ K_C], [-K_B @ y_out, K_A]])
    B = np.vstack([w_in, np.zeros((3, 3))])
    C = np.hstack([z_out - z_u @ K_D @ y_out, z_u @ K_C])
    names = ("k", "m1", "m2")
    keep = 3 if masses else 1
    parameters = tuple(RealParameter(name, 1.0, 0.8, 1.2) for name in names[:keep])
    return System(A, B[:, :keep], C[:keep], z_w[:keep, :keep], (), (), channels=names[:keep], elements=parameters)


def aligned_modes(count: int, damping: float) -> System:
    """Sum of the velocities of oscillators of unit mass under one force, each with an uncertain stiffness.

    At resonance each has the gain 1 / (2 damping) in phase with the force, and 2.2 is in all the intervals.
    """
    A, B = np.zeros((2 * count, 2 * count)), np.zeros((2 * count, count + 1))
    C = np.zeros((count + 1, 2 * count))
    parameters = []
    for i in range(count):
        position, velocity = 2 * i, 2 * i + 1
        stiffness = (1.0 + 0.3 * i) ** 2
        A[position, velocity], A[velocity, position], A[velocity, velocity] = 1.0, -stiffness, -2.0 * damping
        B[velocity, i], B[velocity, count] = -1.0, 1.0
        C[i, position], C[count, velocity] = 1.0, 1.0
        parameters.append(RealParameter(f"k{i}", stiffness, 0.8, 2.6))
    names = tuple(p.name for p in parameters)
    ports = (Port("force", 1),), (Port("velocity", 1),)
    return System(A, B, C, np.zeros((count + 1, count + 1)), *ports, channels=names, elements=tuple(parameters))


def tangent_crossing(excess: float) -> System:
    """``x'' + ((delta - 1)^2 + excess) x' + x = 0`` with delta in [-1, 1]: poles touch the axis at 1 without excess."""
    A = np.array([[0.0, 1.0], [-1.0, -1.0 - excess]])
    # -(d^2 - 2 d) v = w1 with w1 = d (2 v - w2), w2 = d v
    B, C = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[0.0, 2.0], [0.0, 1.0]])
    D = np.array([[0.0, -1.0], [0.0, 0.0]])
    return System(A, B, C, D, (), (), channels=("delta", "delta"), elements=(RealParameter("delta", 0.0, -1.0, 1.0),))


def transport_aircraft() -> System:
    """Lateral motion of a transport aircraft under its controller, 14 coefficients uncertain by 10 %.

    Ferreres (1999), with the numbers of the Robust Control Toolbox's manual, "Real Mu Analysis".
    """
    table = json.loads((FIXTURES / "transport_aircraft_14_parameters.json").read_text("utf-8"))
    parameters = []
    for entry in table["parameters"]:
        nominal, part = entry["nominal"], 0.01 * entry["percent"] * abs(entry["nominal"])
        parameters.append(RealParameter(entry["name"], nominal, nominal - part, nominal + part))
    A, B, C = (np.array(table[key]) for key in ("A", "B_delta", "C_delta"))
    names = tuple(p.name for p in parameters)
    return System(A, B, C, np.zeros((14, 14)), (), (), channels=names, elements=tuple(parameters))


def chain_of_masses(
    count: int, part: float, stiffness: float = 1.0, damping: float = 0.1, *, measured: int = -1
) -> System:
    """Unit masses in a row, each held to the one before by a spring, uncertain by a part of it, and a damper.

    From a force on the last mass to the position of mass `measured`.
    """
    n = count
    stretch = np.eye(n) - np.eye(n, k=-1)
    pull = -stretch.T  # force on the masses by the forces in the springs
    A = np.block([[np.zeros((n, n)), np.eye(n)], [stiffness * pull @ stretch, damping * pull @ stretch]])
    B = np.vstack([np.zeros((n, n + 1)), np.hstack([pull, np.eye(n)[:, -1:]])])
    C = np.hstack([np.vstack([stretch, np.eye(n)[measured]]), np.zeros((n + 1, n))])
    names = tuple(f"k{i}" for i in range(n))
    low, high = stiffness * (1.0 - part), stiffness * (1.0 + part)
    parameters = tuple(RealParameter(name, stiffness, low, high) for name in names)
    ports = (Port("force", 1),), (Port("position", 1),)
    return System(A, B, C, np.zeros((n + 1, n + 1)), *ports, channels=names, elements=parameters)
