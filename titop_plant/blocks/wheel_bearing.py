"""Reaction wheel whose rotor turns on springs and dampers inside of its housing: radial, axial and rocking modes.

The rotor, mass m_r, radial inertia J_t and axial inertia J_w, is displaced from the housing by rho and tilted by alpha
about x and y, both small. It is symmetric, with its centre of mass in the middle between the bearings. At the centre
of mass G, in the frame of the housing, which does not spin::

    m_r (a + rho'')                               = -k_r rho - d_r rho'             + w_f     (k_a, d_a along z)
    J_t (omega_x' + alpha_x'') + J_w Omega (omega_y + alpha_y') = -k_t alpha_x - d_t alpha_x' + w_tx
    J_t (omega_y' + alpha_y'') - J_w Omega (omega_x + alpha_x') = -k_t alpha_y - d_t alpha_y' + w_ty
    wrench_G = [ k_r rho + d_r rho' ; k_t alpha + d_t alpha' ; u ] - [ (m - m_r) a ; (J_r - J_t) omega' ; 0 ]

**The imbalance w acts on the rotor.** With the housing held, the whirl modes are, backward (-) and forward (+)::

    omega = +-Omega J_w / (2 J_t) + sqrt( (Omega J_w / (2 J_t))^2 + k_t / J_t )

Two states for each direction that has a stiffness: 4 radial, 4 rocking, 2 axial. A direction without one is rigid. The
gyroscopic torque needs the two lateral rates of the rotor, so the speed occurs twice as in the rigid wheel. As the
stiffness grows the block becomes the rigid wheel.

Source: Masterson (1999), "Development and validation of empirical and analytical reaction wheel disturbance models",
MIT, whose analytical model is a rotor on radial and rocking springs. Neglected: damping that turns with the rotor,
stiffness that depends on speed or load, the motor's torque on a tilted axis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic.dataclasses import dataclass

from lftkit.arrays import FloatArray
from lftkit.systems.ports import Port
from lftkit.uncertainty.elements import RealParameter
from pointing_analysis.files.settings import POSITIVE, STRICT, CheckedTable, Refused, setting, settings_class
from titop_plant import ports

if TYPE_CHECKING:
    from lftkit import System

DIRECTIONS = ("radial", "radial", "axial", "rocking", "rocking")
"""Kind of each direction of the rotor in the housing: translation x, y, z and rotation x, y."""

TRANSLATIONS = 3
LATERAL = (3, 4)
"""Places of the rotations x, y among the directions."""


@settings_class
@dataclass(frozen=True, config=STRICT)
class WheelBearing(CheckedTable):
    """Rotor of a wheel and the bearings that carry it in its housing: m_r, J_t, k_r, k_a, k_t, d_r, d_a, d_t.

    Raises
    ------
    ValueError
        A mass, inertia or stiffness that is not positive, a damping that is negative or without a stiffness, no
        stiffness at all.
    """

    rotor_mass: float = setting(..., "part of the wheel's mass", "kg", POSITIVE)
    rotor_radial_inertia: float = setting(..., "part of the wheel's radial inertia", "kg m2", POSITIVE)
    radial_stiffness: float | None = setting(None, "radial stiffness", "N/m", POSITIVE, absent="rigid")
    axial_stiffness: float | None = setting(None, "axial stiffness", "N/m", POSITIVE, absent="rigid")
    rocking_stiffness: float | None = setting(None, "rocking stiffness", "Nm/rad", POSITIVE, absent="rigid")
    radial_damping: float = setting(0.0, "radial damping", "N s/m", 0.0)
    axial_damping: float = setting(0.0, "axial damping", "N s/m", 0.0)
    rocking_damping: float = setting(0.0, "rocking damping", "Nm s/rad", 0.0)

    def __post_init__(self) -> None:
        kinds = dict.fromkeys(DIRECTIONS)
        if not self.flexible:
            names = ", ".join(f"{kind}_stiffness" for kind in kinds)
            raise Refused("", f"must have one of {names}, got none")
        for kind in kinds:
            damping = getattr(self, f"{kind}_damping")
            if damping and getattr(self, f"{kind}_stiffness") is None:
                raise Refused(f"{kind}_damping", f"must be absent without {kind}_stiffness, got {damping}")

    @property
    def flexible(self) -> tuple[int, ...]:
        """Places of the directions that have a stiffness."""
        return tuple(i for i, kind in enumerate(DIRECTIONS) if getattr(self, f"{kind}_stiffness") is not None)

    def of_directions(self, name: str) -> FloatArray:
        """Stiffness or damping of the directions `flexible`."""
        return np.array([float(getattr(self, f"{DIRECTIONS[i]}_{name}")) for i in self.flexible])

    def rotor_inertia(self) -> FloatArray:
        """Mass and inertia of the rotor in each direction, shape (5,)."""
        return np.array([self.rotor_mass] * TRANSLATIONS + [self.rotor_radial_inertia] * len(LATERAL))


@settings_class
@dataclass(frozen=True, config=STRICT)
class ReactionWheel(CheckedTable):
    """Data of a reaction wheel. A thin disc has an axial inertia of twice the radial one.

    Raises
    ------
    ValueError
        A value that is not positive, a rotor that is more than the whole wheel.
    """

    mass: float = setting(..., "mass", "kg", POSITIVE)
    axial_inertia: float = setting(..., "inertia about the spin axis", "kg m2", POSITIVE)
    radial_inertia: float = setting(..., "inertia across the spin axis", "kg m2", POSITIVE)
    bearing: WheelBearing | None = setting(None, "compliant bearing of the rotor", absent="rigid")

    def __post_init__(self) -> None:
        for key, whole in (("rotor_mass", self.mass), ("rotor_radial_inertia", self.radial_inertia)):
            if self.bearing is not None and (part := getattr(self.bearing, key)) > whole:
                raise Refused(f"bearing.{key}", f"must be at most {whole:g} of the wheel, got {part:g}")


def wheel_on_bearings(wheel: ReactionWheel, bearing: WheelBearing, speed: RealParameter, point: str = "G") -> System:
    """TITOP block of a wheel with a rotor on its bearings; ports as in :mod:`titop_plant.blocks.reaction_wheel`.

    Parameters
    ----------
    wheel : ReactionWheel
        m, J_w and J_r.
    bearing : WheelBearing
        Of the wheel.
    speed : RealParameter
        Omega [rad/s].
    point : str

    Returns
    -------
    System
        Ten states where all directions are flexible; the speed occurs twice.

    Examples
    --------
    At rest both rocking modes are at sqrt(k_t / J_t) = 500 rad/s; at speed one is lower, one higher, and their product
    stays:

    >>> bearing = WheelBearing(1.0, 0.04, rocking_stiffness=1e4)
    >>> wheel = wheel_on_bearings(ReactionWheel(1.2, 0.08, 0.05), bearing, RealParameter("speed", 0, -1000, 1000))
    >>> modes = np.abs(np.linalg.eigvals(wheel.at({"speed": 300.0}).A))
    >>> np.unique(modes.round(1)).tolist(), round(float(np.sqrt(modes.prod())))
    ([283.1, 883.1], 250000)
    """
    from lftkit import System  # loads scipy, which the tables of a telescope need not

    inputs = [
        ports.accel(point),
        ports.rate(point),
        Port("wheel_torque", 1, "Nm"),
        Port("imbalance", 5, ports.IMBALANCE_UNIT),
    ]
    outputs = [ports.wrench(point), Port("wheel_accel", 1, "rad/s2")]
    whole = np.array([wheel.mass] * TRANSLATIONS + [wheel.radial_inertia] * len(LATERAL))
    A, B, C, D = _matrices(whole, wheel.axial_inertia, bearing)
    gyro, seen = np.vstack([B[:, :2], D[:, :2]]), np.hstack([C[:2], D[:2, 2:]])
    turning = speed.nominal * gyro @ seen  # the torque of the nominal speed; that of a deviation comes through Delta
    n = len(A)
    A, C = A + turning[:n, :n], C + turning[n:, :n]
    B[:, 2:] += turning[:n, n:]
    D[:, 2:] += turning[n:, n:]
    return System(A, B, C, D, tuple(inputs), tuple(outputs), channels=(speed.name,) * 2, elements=(speed,))


def _matrices(
    whole: FloatArray, axial_inertia: float, bearing: WheelBearing
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Matrices at rest with the gyroscopic torque as the first two inputs, and what it is Omega times as outputs.

    `whole` (5,) are mass and inertia of the whole wheel in each direction. States: displacements, then their rates.
    """
    free = np.array(bearing.flexible)
    n, rotor = free.size, bearing.rotor_inertia()
    K, Dm, mu = np.diag(bearing.of_directions("stiffness")), np.diag(bearing.of_directions("damping")), rotor[free]
    ACCEL, RATE, TORQUE, LOAD = slice(2, 8), slice(8, 11), 11, slice(12, 17)
    on_rotor = np.zeros((5, 17))  # gyroscopic torque and imbalance
    on_rotor[3:, :2], on_rotor[:, LOAD] = np.eye(2), np.eye(5)
    follow = np.zeros((n, 17))
    follow[:, ACCEL] = np.eye(6)[free]
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K / mu[:, None], -Dm / mu[:, None]]])
    B = np.vstack([np.zeros((n, 17)), on_rotor[free] / mu[:, None] - follow])
    # Outputs: two of Omega, wrench 6, acceleration of the rotor about its axis.
    C, D = np.zeros((9, 2 * n)), np.zeros((9, 17))
    D[0, RATE], D[1, RATE] = [0.0, -axial_inertia, 0.0], [axial_inertia, 0.0, 0.0]
    for row, at, sign in ((0, LATERAL[1], -1.0), (1, LATERAL[0], 1.0)):
        if at in free:
            C[row, n + int(np.flatnonzero(free == at)[0])] = sign * axial_inertia
    C[2 + free] = np.hstack([K, Dm])
    rigid = np.setdiff1d(np.arange(5), free)
    D[2 + rigid] = on_rotor[rigid]
    carried = whole.copy()
    carried[free] -= mu  # the rotor's part is carried by the springs
    D[2:7, 2:7] -= np.diag(carried)
    D[7, TORQUE] = 1.0
    D[8, TORQUE], D[8, 7] = -1.0 / axial_inertia, -1.0
    return A, B, C, D
