"""Reaction wheel with imbalance disturbance, and an assembly of wheels.

Newton and Euler at the wheel's centre of mass G in the wheel's frame (spin along z, disc of radial
inertia J_r and axial inertia J_w, rigid mount)::

    wrench_G = -[ m a ; J_r omega_dot_x ; J_r omega_dot_y ; 0 ]  + [ w_f ; w_t ; u ]
               - J_w Omega [ 0 ; omega_y ; -omega_x ; 0 ]
    Omega'   = -u / J_w - omega_dot_z

The gyroscopic term needs the angular *rate* of the hub; with the rate as an input the speed Omega occurs
twice and no integrator is added. **u > 0 is a torque on the structure along +z (-u acts on the wheel).**

======================  ====  ==============================================================
port                    size  meaning
======================  ====  ==============================================================
in ``accel_<G>``        6     acceleration twist of the hub
in ``rate_<G>``         3     its angular rate
in ``wheel_torque``     1     u [Nm]
in ``imbalance``        5     force x, y, z [N] and torque x, y [Nm] on the structure, wheel frame
out ``wrench_<G>``      6     by the wheel on its parent
out ``wheel_accel``     1     Omega' [rad/s2]
======================  ====  ==============================================================

Source: the paper, "Modeling of micro-vibration sources". Neglected: products of the small structural rates. A wheel
with a `WheelBearing` has a rotor on springs instead of the rigid mount, and ten states more
(:mod:`titop_plant.blocks.wheel_bearing`); **its imbalance acts on the rotor.**
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lftkit import Connection, Port, RealParameter, System, connect, static_gain
from lftkit.arrays import FloatArray
from titop_plant import ports
from titop_plant.blocks.mounting import mounted
from titop_plant.blocks.rotation import _unit
from titop_plant.blocks.wheel_bearing import ReactionWheel, wheel_on_bearings


@dataclass(frozen=True)
class MountedWheel:
    """A wheel of an assembly.

    Parameters
    ----------
    wheel : ReactionWheel
    axis : ndarray, shape (3,)
        Spin axis in the parent's frame; normalised to a unit vector.
    position : ndarray, shape (3,)
        Wheel centre from the assembly's point [m].
    speed : RealParameter
        Omega [rad/s]; where both ends of its range are equal it is no element of the assembly.
    """

    wheel: ReactionWheel
    axis: FloatArray
    position: FloatArray
    speed: RealParameter

    @property
    def turns(self) -> bool:
        """Whether it is not always at rest."""
        return bool(self.speed.lower or self.speed.upper)


def reaction_wheel(data: ReactionWheel, speed: RealParameter, point: str = "G") -> System:
    """TITOP block of one wheel in its own frame (ports and equations: see the module).

    Examples
    --------
    The gyroscopic torque is perpendicular to the rate of the base, so it does no work:

    >>> wheel = reaction_wheel(ReactionWheel(1.0, 0.096, 0.047), RealParameter("speed", 0, -1000, 1000))
    >>> G = wheel["wrench_G", "rate_G"].at({"speed": 500.0}).D[3:]
    >>> bool(np.all(G + G.T == 0.0)), float(G[1, 0])
    (True, 48.0)
    """
    Jw = data.axial_inertia
    if data.bearing is not None:
        return wheel_on_bearings(data, data.bearing, speed, point)
    inputs = [
        ports.accel(point),
        ports.rate(point),
        Port("wheel_torque", 1, "Nm"),
        Port("imbalance", 5, ports.IMBALANCE_UNIT),
    ]
    outputs = [ports.wrench(point), Port("wheel_accel", 1, "rad/s2")]
    D = np.zeros((7, 15))
    D[:6, :6] = -np.diag([data.mass] * 3 + [data.radial_inertia] * 2 + [0.0])
    D[:5, 10:15] = np.eye(5)
    D[5, 9] = 1.0
    D[6, 9], D[6, 5] = -1.0 / Jw, -1.0
    gyro = np.zeros((2, 15))
    gyro[0, 7], gyro[1, 6] = -Jw, Jw
    D[3:5] += speed.nominal * gyro
    feed = np.zeros((7, 2))
    feed[3:5] = np.eye(2)
    full = np.block([[np.zeros((2, 2)), gyro], [feed, D]])
    empty = np.zeros((0, 0))
    return System(
        empty, empty, empty, full, tuple(inputs), tuple(outputs), channels=(speed.name,) * 2, elements=(speed,)
    )


def spin_frame(axis: ArrayLike) -> FloatArray:
    """DCM from the parent's frame to a wheel frame whose z is `axis`: **v_wheel = dcm @ v_parent**.

    The wheel's x is perpendicular to the parent's z; if the axis is parallel to it, x is the parent's x.
    """
    z = _unit(axis)
    across = np.cross([0.0, 0.0, 1.0], z)
    x = _unit(across) if np.sqrt(across @ across) > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.vstack([x, np.cross(z, x), z])


def wheel_assembly(wheels: Sequence[MountedWheel], point: str = "Iw") -> System:
    """Several wheels on one interface.

    A wheel whose range of speeds is zero has no uncertain element, and one that stays at rest is a mass.

    Returns
    -------
    System
        Ports ``accel_<point>``, ``rate_<point>``, ``wheel_torque`` (one signal a wheel that turns), ``imbalance`` (5 of
        each of them, in its wheel's frame) -> ``wrench_<point>``, ``wheel_accel``.
    """
    turning = [i for i, one in enumerate(wheels) if one.turns]
    n = len(turning)
    torque, imbalance = Port("wheel_torque", n, "Nm"), Port("imbalance", 5 * n, ",".join([ports.IMBALANCE_UNIT] * n))
    spin = Port("wheel_accel", n, "rad/s2")
    torques = [Port(f"torque_{i}", 1, "Nm") for i in turning]
    imbalances = [Port(f"imbalance_{i}", 5, ports.IMBALANCE_UNIT) for i in turning]
    spins = [Port(f"spin_{i}", 1, "rad/s2") for i in turning]
    accel, rate, wrench = (port(point).name for port in (ports.accel, ports.rate, ports.wrench))
    systems = {
        "torques": static_gain(np.eye(n), [torque], torques),
        "imbalances": static_gain(np.eye(5 * n), [imbalance], imbalances),
        "spins": static_gain(np.eye(n), spins, [spin]),
    }
    wires: list[Connection] = [
        ("wheel_torque", "torques.wheel_torque"),
        ("imbalance", "imbalances.imbalance"),
    ]
    for i, one in enumerate(wheels):
        block = reaction_wheel(one.wheel, one.speed)
        if one.speed.lower == one.speed.upper:
            block = block.nominal()
        if not one.turns:
            block = _at_rest(block, one.wheel.axial_inertia)
        systems[f"wheel{i}"] = mounted(block, "G", point, position=one.position, dcm=spin_frame(one.axis))
        wires += [(accel, f"wheel{i}.{accel}"), (rate, f"wheel{i}.{rate}")]
        if one.turns:
            wires += [
                (f"torques.torque_{i}", f"wheel{i}.wheel_torque"),
                (f"imbalances.imbalance_{i}", f"wheel{i}.imbalance"),
                (f"wheel{i}.wheel_accel", f"spins.spin_{i}"),
            ]
    return connect(
        systems,
        wires,
        inputs=[ports.accel(point), ports.rate(point), torque, imbalance],
        outputs={wrench: tuple(f"wheel{i}.{wrench}" for i in range(len(wheels))), spin.name: "spins.wheel_accel"},
    )


def _at_rest(wheel: System, axial_inertia: float) -> System:
    """A wheel whose rotor does not turn against its housing: **friction gives it the torque -J_w omega_dot_z**."""
    accel, rate, torque = (wheel.input_port(name) for name in ("accel_G", "rate_G", "wheel_torque"))
    friction = static_gain([[0.0] * 5 + [-axial_inertia]], [accel], [torque])
    return connect(
        {"wheel": wheel["wrench_G", (accel.name, rate.name, torque.name)], "friction": friction},
        [
            (accel.name, f"wheel.{accel.name}"),
            (accel.name, f"friction.{accel.name}"),
            (rate.name, f"wheel.{rate.name}"),
            (f"friction.{torque.name}", f"wheel.{torque.name}"),
        ],
        inputs=[accel, rate],
        outputs={"wrench_G": "wheel.wrench_G"},
    )


__all__ = ["MountedWheel", "ReactionWheel", "reaction_wheel", "wheel_assembly"]
