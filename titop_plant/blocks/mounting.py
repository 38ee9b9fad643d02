"""Mounting a block at another point and in another frame of its parent."""

from __future__ import annotations

from numpy.typing import ArrayLike

from lftkit import System, transform
from titop_plant import ports
from titop_plant.structures.kinematics import check_rotation, rotate_twist, tau


def mounted(
    block: System,
    point: str,
    at: str,
    *,
    position: ArrayLike = (0.0, 0.0, 0.0),
    dcm: ArrayLike = ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
) -> System:
    """The same block, driven at point `at` of its parent and in the parent's frame.

    Parameters
    ----------
    block : System
        Has ``accel_<point>`` as input and ``wrench_<point>`` as output, optionally ``rate_<point>`` and
        ``angle_<point>`` as inputs.
    point, at : str
        Attachment point of the block, and the point of the parent that it is rigidly linked to.
    position : array_like, shape (3,)
        Vector from `at` to `point` in the parent's frame [m].
    dcm : array_like, shape (3, 3)
        From the parent's frame to the block's own, **v_block = dcm @ v_parent**.

    Returns
    -------
    System
        Ports ``accel_<at>``, ``wrench_<at>``, ... instead of the old ones.

    Raises
    ------
    ValueError
        `dcm` is not orthonormal; a port is missing.

    Examples
    --------
    A 2 kg point mass at a distance of 3 m has the inertia m r^2 = 18 kg m2:

    >>> import numpy as np
    >>> from titop_plant.blocks.flexible_body import rigid_body
    >>> ball = rigid_body("ball", "P", np.diag([2.0, 2.0, 2.0, 0.0, 0.0, 0.0]))
    >>> float(-mounted(ball, "P", "Q", position=[3.0, 0.0, 0.0]).nominal().D[5, 5])
    18.0
    """
    rotation = check_rotation(dcm, f"mounting of {point} at {at}: dcm")
    T = rotate_twist(rotation) @ tau(position, (0.0, 0.0, 0.0))
    inputs = {f"accel_{point}": (T, ports.accel(at))}
    names = {p.name for p in block.inputs}
    if f"rate_{point}" in names:
        inputs[f"rate_{point}"] = (rotation, ports.rate(at))
    if f"angle_{point}" in names:
        inputs[f"angle_{point}"] = (rotation, ports.angle(at))
    return transform(block, inputs=inputs, outputs={f"wrench_{point}": (T.T, ports.wrench(at))})
