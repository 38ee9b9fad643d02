"""A Stewart platform as an isolator: six soft legs carry a payload of 60 kg.

python examples/stewart_platform_isolator.py

Stiffness and damping of the platform follow from the geometry of the legs, ``K = k J J'`` with the columns
``[s; r x s]`` of J: direction s of a leg and point r where it meets the platform. The damping of the legs is a
parameter: printed are the suspension modes, and where isolation begins and how much remains at resonance for its ends.
"""

import numpy as np
from scipy import linalg

from lftkit import System
from lftkit.arrays import FloatArray
from titop_plant.blocks.isolator import Isolator, isolator
from titop_plant.structures import from_inertia

LEG_STIFFNESS, LEG_DAMPING = 4e3, (2.0, 20.0)  # N/m; N s/m
RADIUS_BELOW, RADIUS_ABOVE, HEIGHT = 0.35, 0.25, 0.25  # m; the joints stand in three pairs on each ring
PAYLOAD = from_inertia(60.0, np.diag([3.0, 3.0, 2.0]), [0.0, 0.0, 0.2])
"""Mass matrix at the centre of the upper ring, to which the legs are referred."""


def leg_matrix() -> FloatArray:
    """J, shape (6, 6): unit force of each leg as a wrench at the centre of the upper ring."""
    columns = []
    for pair in (0.0, 120.0, 240.0):
        for side in (-1.0, 1.0):
            above, below = np.deg2rad([pair + side * 10.0, pair + side * 50.0])
            r = RADIUS_ABOVE * np.array([np.cos(above), np.sin(above), 0.0])
            foot = np.array([RADIUS_BELOW * np.cos(below), RADIUS_BELOW * np.sin(below), -HEIGHT])
            s = (r - foot) / np.linalg.norm(r - foot)
            columns.append(np.concatenate([s, np.cross(r, s)]))
    return np.column_stack(columns)


def platform(damping: float) -> System:
    """Isolator with the payload, from the motion of the spacecraft to that of the payload."""
    J = leg_matrix()
    return isolator(Isolator(PAYLOAD, LEG_STIFFNESS * J @ J.T, damping * J @ J.T))


def main() -> None:
    """Print modes and transmissibility."""
    J = leg_matrix()
    modes = np.sqrt(linalg.eigh(LEG_STIFFNESS * J @ J.T, PAYLOAD, eigvals_only=True))
    print("suspension modes:", (modes / (2 * np.pi)).round(2), "Hz; condition of the legs", round(np.linalg.cond(J), 1))
    omega = np.geomspace(0.5, 2e3, 2000)
    for damping in LEG_DAMPING:
        follow = platform(damping)["accel_C", "accel_P"].nominal()
        gain = np.abs(np.array([follow(1j * w)[2, 2] for w in omega]))
        begins = omega[np.flatnonzero(gain > 1.0)[-1]] / (2 * np.pi)
        high = 20 * np.log10(gain[np.searchsorted(omega, 2 * np.pi * 100.0)])
        where = f"isolates above {begins:.2f} Hz, {high:.0f} dB at 100 Hz"
        print(f"legs of {damping:4.1f} N s/m: peak {gain.max():5.1f}, {where}")


if __name__ == "__main__":
    main()
