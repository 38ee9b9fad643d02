"""Kinds of ports that all blocks share: one name and one unit for each."""

from __future__ import annotations

from lftkit.systems.ports import Port

TWIST_UNIT = ",".join(["m/s2"] * 3 + ["rad/s2"] * 3)
WRENCH_UNIT = ",".join(["N"] * 3 + ["Nm"] * 3)
IMBALANCE_UNIT = ",".join(["N"] * 3 + ["Nm"] * 2)

LOAD = "load_"
"""Beginning of the names of inputs for a wrench from outside on a node."""

AXES = ("x translation", "y translation", "z translation", "x rotation", "y rotation", "z rotation")
"""Names of the six directions of a twist or a wrench."""


def accel(point: str) -> Port:
    """Acceleration twist ``[a; omega_dot]`` of a point, 6 signals."""
    return Port(f"accel_{point}", 6, TWIST_UNIT)


def wrench(point: str) -> Port:
    """Wrench ``[F; T]`` at a point, 6 signals."""
    return Port(f"wrench_{point}", 6, WRENCH_UNIT)


def rate(point: str) -> Port:
    """Angular rate of the structure at a point, 3 signals."""
    return Port(f"rate_{point}", 3, "rad/s")


def angle(point: str) -> Port:
    """Small rotation of the structure at a point against inertial space, 3 signals."""
    return Port(f"angle_{point}", 3, "rad")


def deflection(point: str) -> Port:
    """Elastic deflection (translation, rotation) of a point against the rigid body at its parent, 6 signals."""
    return Port(f"deflection_{point}", 6, ",".join(["m"] * 3 + ["rad"] * 3))
