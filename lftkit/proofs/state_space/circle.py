"""Systems in discrete time as systems in continuous time, where members are searched and scalings are found.

On the unit circle ``z = exp(j omega dt)`` the sum x and the difference v of the next states and the states satisfy
``v = j tan(omega dt / 2) x``. With x as states a system in discrete time is one in continuous time, whose axis is the
circle: that of the bilinear map, with twice its states. What is found is checked with the matrices that were given
(:mod:`lftkit.proofs.trusted.cells`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy import linalg

from lftkit.errors import InputError
from lftkit.proofs.state_space.disk_search import DiskMember
from lftkit.proofs.state_space.search import Member
from lftkit.systems.sampled.bilinear import to_continuous, unwarped_frequency, warped_frequency
from lftkit.systems.system import System


def over_axis(system: System) -> System:
    """The system in continuous time whose frequency is ``tan(omega dt / 2)``; itself, if it is in continuous time.

    Raises
    ------
    ValueError
        The nominal member has a pole at z = -1, where the sum of states and next states is no state.
    """
    if not system.dt:
        return system
    try:
        A, B, C, D = to_continuous(*system.lft)
    except ValueError as error:
        raise InputError(f"nominal member of {system.name}: {error}") from None
    return system.with_lft((A, 2.0 * B, 0.5 * C, D), dt=0.0)


def static_part(system: System) -> System:
    """The channels of the parameters without states, inputs and outputs: members are well posed where it is stable."""
    q = len(system.channels)
    matrices = np.zeros((0, 0)), np.zeros((0, q)), np.zeros((q, 0)), system.D[:q, :q]
    return System(*matrices, (), (), system.name, channels=system.channels, elements=system.elements)


def band_over_axis(band: tuple[float, float], dt: float) -> tuple[float, float]:
    """The band of ``tan(omega dt / 2)`` that contains a band [rad/s], in discrete time.

    Raises
    ------
    ValueError
        The band begins above pi / dt.
    """
    if not dt:
        return band
    low, high = (warped_frequency(0.5 * dt * end) for end in band)
    if not low < math.inf:
        raise InputError(f"band must begin below pi / dt = {math.pi / dt:.6g} rad/s, got {band[0]}")
    return (1.0 - 1e-14) * low, (1.0 + 1e-14) * high  # outward, for the rounding of the tangent


def reached(system: System, member: Member) -> Member:
    """A member found over the axis, with frequency [rad/s] and gain of the system that was given."""
    if not system.dt:
        return member
    omega = 2.0 / system.dt * unwarped_frequency(member.frequency)
    if np.isinf(member.gain) and not isinstance(member, DiskMember):
        return replace(member, frequency=_least_stable(system, member, omega))
    if np.isinf(member.gain) or not (system.inputs and system.outputs) or isinstance(member, DiskMember):
        return replace(member, frequency=omega)
    values = {p.name: float(v) for p, v in zip(system.parameters, member.point)}
    response = system.at(values, beyond_range=True).response(omega)[0]
    return Member(float(linalg.norm(response, 2)), member.point, omega)


def _least_stable(system: System, member: Member, omega: float) -> float:
    """Frequency [rad/s] of the pole of a member that is farthest out; `omega` where it is not well posed or has none.

    A pole near z = -1 is a large real one over the axis, whose imaginary part says nothing.
    """
    values = {p.name: float(v) for p, v in zip(system.parameters, member.point)}
    try:
        poles = system.at(values, beyond_range=True).poles()
    except ValueError:
        return omega
    return float(abs(np.angle(poles[np.argmax(np.abs(poles))]))) / system.dt if len(poles) else omega
