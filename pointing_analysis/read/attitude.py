"""Line of sight of an attitude: small angles of one axis of the body, from quaternions.

A quaternion ``q`` is that of ROS: the vector ``v`` of the body is ``R(q) v`` in the frame of reference. The line of
sight is the axis ``b`` of the body relative to the mean attitude, ``d = R(mean)' R(q) b``; roll about ``b`` does not
move it. A recording of attitudes has no target: **the mean is the target, a constant error is not seen**.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from scipy.linalg import eigh

from pointing_analysis.arrays import BoolArray, FloatArray
from pointing_analysis.read.mcap.records import BagError

NORM = 1e-3
"""Largest difference of the norm of a quaternion from one."""
SMALL = 0.5
"""Largest angle of a line of sight about its mean [rad]."""


def turned_about(axis: str) -> tuple[str, str]:
    """Axes about which the line of sight along `axis` turns: the next two in the order x, y, z, x, y.

    Examples
    --------
    >>> turned_about("z"), turned_about("x")
    (('x', 'y'), ('y', 'z'))
    """
    k = "xyz".index(axis)
    return "xyz"[(k + 1) % 3], "xyz"[(k + 2) % 3]


def unit_quaternions(quaternions: FloatArray) -> BoolArray:
    """Which rows (n, 4) are attitudes, of norm 1; drivers without an attitude send zeros.

    Examples
    --------
    >>> unit_quaternions(np.array([[0.0, 0.0, 0.6, 0.8], [0.0, 0.0, 0.0, 0.0]])).tolist()
    [True, False]
    """
    return np.asarray(np.abs(np.sqrt(np.sum(np.square(quaternions), axis=1)) - 1.0) <= NORM)


def quaternion_of(columns: Mapping[str, FloatArray], pair: tuple[str, str]) -> tuple[str, ...]:
    """Four columns of one length that are a unit quaternion with a pair of them in it; empty where there are none.

    They have names that differ in the last character (``q1`` to ``q4``, ``qx`` to ``qw``), or each of them varies.

    Examples
    --------
    >>> half = 0.5 * np.linspace(-0.1, 0.3, 100)
    >>> turn = {"q1": np.sin(half), "q2": 0.0 * half, "q3": 0.0 * half, "q4": np.cos(half), "t": np.arange(100.0)}
    >>> quaternion_of(turn, ("q1", "q2"))
    ('q1', 'q2', 'q3', 'q4')
    >>> quaternion_of({"x": 1e-6 * half, "y": 1e-6 * half, "valid": np.ones(100), "mode": np.zeros(100)}, ("x", "y"))
    ()
    """
    others = [name for name in columns if name not in pair and np.isfinite(columns[name]).any()]
    rest = 1.0 - sum(np.square(columns[name]) for name in pair)
    for two in combinations(others, 2):
        four = tuple(name for name in columns if name in (*pair, *two))
        norm = np.abs(rest - np.square(columns[two[0]]) - np.square(columns[two[1]]))
        alike = len({name[:-1] for name in four}) == 1
        if np.nanmax(norm, initial=0.0) <= 2.0 * NORM and (alike or all(np.nanstd(columns[c]) > NORM for c in four)):
            return four
    return ()


def line_of_sight(quaternions: FloatArray, axis: str) -> FloatArray:
    """Angles of an axis of the body about its mean direction.

    Parameters
    ----------
    quaternions : (n, 4), x, y, z, w; of norm 1, q and -q are the same
    axis : ``x``, ``y`` or ``z`` of the body

    The mean is that of Markley, Cheng, Crassidis and Oshman, "Averaging Quaternions", Journal of Guidance, Control, and
    Dynamics 30(4), 2007, equation 12.

    Returns
    -------
    ndarray, shape (n, 2)
        **Positive rotations about the two axes of `turned_about`** [rad].

    Raises
    ------
    BagError
        An angle of more than `SMALL` from the mean: a slew is no error.

    Examples
    --------
    A turn of 1 mrad to both sides about the body's x moves the axes y and z, not x:

    >>> q = np.array([[sign * 5e-4, 0.0, 0.0, 1.0] for sign in (-1.0, 1.0)])
    >>> bool(np.allclose(line_of_sight(q, "z"), [[-1e-3, 0.0], [1e-3, 0.0]]))
    True
    >>> bool(np.allclose(line_of_sight(q, "x"), 0.0))
    True
    """
    if not len(quaternions):
        return np.zeros((0, 2))
    q = quaternions / np.sqrt(np.sum(np.square(quaternions), axis=1))[:, None]
    mean = eigh(q.T @ q)[1][:, -1]  # of q q', whose sign does not count
    # Quaternions (n, 4) of the rotations from the mean: its conjugate times each
    a, b = -mean[:3], mean[3]
    vector = b * q[:, :3] + q[:, 3:] * a + np.cross(np.broadcast_to(a, (len(q), 3)), q[:, :3])
    x, y, z, w = np.column_stack([vector, b * q[:, 3] - q[:, :3] @ a]).T
    columns = {  # of the rotation matrix
        "x": (1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
        "y": (2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
        "z": (2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
    }
    first, second = turned_about(axis)
    direction = dict(zip("xyz", columns[axis]))
    angles = np.column_stack(
        [np.arctan2(-direction[second], direction[axis]), np.arctan2(direction[first], direction[axis])]
    )
    largest = float(np.abs(angles).max())
    if largest > SMALL:
        raise BagError(f"line of sight must stay within {SMALL} rad of its mean attitude, got {largest:.3g} rad")
    return np.asarray(angles)
