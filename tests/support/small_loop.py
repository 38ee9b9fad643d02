"""A plant of ten states with the ports of the telescope, and controllers with a direct camera path."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from lftkit import Port, RealParameter, SampledSystem, System
from titop_plant.interface import CAMERA, DT, K_FSM_INPUTS, K_FSM_OUTPUTS, K_PMA_INPUTS, K_PMA_OUTPUTS

FREQUENCIES = (12.0, 60.0, 180.0, 420.0)
INPUTS = (Port("command", 8), Port("disturbance", 22))
OUTPUTS = (Port("measured", 22), Port("los_controlled", 2))


def small_plant(stiffness: float = 1.0) -> System:
    """Four damped modes and the camera's low-pass; the sensors feel commands and disturbances directly.

    Parameters
    ----------
    stiffness : float
        Factor on the squared frequency of the second mode; negative: that mode diverges.
    """
    rng = np.random.default_rng(5)
    squares = [w**2 * (stiffness if k == 1 else 1.0) for k, w in enumerate(FREQUENCIES)]
    A = np.zeros((10, 10))
    modes = [np.array([[0.0, 1.0], [-s, -0.1 * w]]) for s, w in zip(squares, FREQUENCIES)]
    A[:8, :8] = linalg.block_diag(*modes)
    B = np.zeros((10, 30))
    B[1:8:2] = 1e-4 * rng.standard_normal((4, 30)) * np.r_[np.ones(2), np.full(6, 50.0), np.ones(22)]
    shape = rng.standard_normal((2, 4))
    los = np.zeros((2, 10))
    los[:, 0:8:2] = shape
    mirror = np.zeros((2, 8))
    mirror[:, :2] = 0.1 * np.eye(2)
    A[8:, 8:], A[8:, :8] = -80.0 * np.eye(2), 80.0 * los[:, :8]
    B[8:, :8] = 80.0 * mirror
    C, D = np.zeros((24, 10)), np.zeros((24, 30))
    C[:18, :8] = rng.standard_normal((18, 8))
    D[:18] = 1e-3 * rng.standard_normal((18, 30))
    C[18:20, 8:] = np.eye(2)
    D[20:22, :2] = np.eye(2)
    C[22:], D[22:, :8] = los, mirror
    return System(A, B, C, D, INPUTS, OUTPUTS, "small plant")


def small_controllers() -> tuple[SampledSystem, SampledSystem]:
    """K_FSM of order 3 that passes the camera straight on, K_PMA of order 2."""
    rng = np.random.default_rng(6)
    B = 1e-2 * rng.standard_normal((3, 22))
    D = 1e-3 * rng.standard_normal((2, 22))
    D[:, CAMERA] = [[0.6, 0.1], [-0.15, 0.5]]
    D[:, 20:] = -0.05 * np.eye(2)
    A = np.diag([0.95, 0.8, 0.4])
    k_fsm = SampledSystem(
        A,
        B,
        1e-2 * rng.standard_normal((2, 3)),
        D,
        K_FSM_INPUTS,
        K_FSM_OUTPUTS,
        DT,
        "observer",
        design_basis={"los_sensitivity": 0.1},
    )
    k_pma = SampledSystem(
        np.diag([0.9, 0.5]),
        rng.standard_normal((2, 6)),
        rng.standard_normal((6, 2)),
        rng.standard_normal((6, 6)),
        K_PMA_INPUTS,
        K_PMA_OUTPUTS,
        DT,
        "force law",
    )
    return k_fsm, k_pma


def small_family() -> System:
    """The small plant as an uncertain system, with the ports' names that the loop needs: one channel."""
    plant = small_plant()
    square = FREQUENCIES[1] ** 2
    B = np.hstack([np.zeros((10, 1)), plant.B])
    B[3, 0] = -square
    C = np.vstack([np.eye(10)[2:3], plant.C])
    D = np.pad(plant.D, ((1, 0), (1, 0)))
    stiffness = RealParameter("stiffness", 1.0, -5.0, 200.0)
    return System(plant.A, B, C, D, INPUTS, OUTPUTS, channels=("stiffness",), elements=(stiffness,))
