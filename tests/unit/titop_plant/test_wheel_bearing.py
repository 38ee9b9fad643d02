"""A wheel on compliant bearings: equations of motion of its own, conservation laws, whirl modes, limits, order."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from lftkit import RealParameter, System
from titop_plant.blocks.reaction_wheel import ReactionWheel, reaction_wheel
from titop_plant.blocks.wheel_bearing import WheelBearing

MASS, AXIAL, RADIAL = 1.0, 0.096, 0.05
ROTOR, TILTING = 0.8, 0.045
SPRINGS = {"radial_stiffness": 1.5e6, "axial_stiffness": 1.0e6, "rocking_stiffness": 6.0e3}
DAMPERS = {"radial_damping": 30.0, "axial_damping": 20.0, "rocking_damping": 0.3}
SPEED = RealParameter("speed", 0.0, -1000.0, 1000.0)
OMEGA = np.array([3.0, 120.0, 365.0, 900.0, 1370.0, 4000.0])


def wheel(speed: RealParameter = SPEED, **bearing: float) -> System:
    return reaction_wheel(ReactionWheel(MASS, AXIAL, RADIAL, WheelBearing(ROTOR, TILTING, **bearing)), speed)


def response(system: System, w: float) -> np.ndarray:
    """From acceleration (6), motor and load (5) to wrench and Omega', the rate of the base being the integral."""
    A, B, C, D = system.matrices
    found = C @ linalg.solve(1j * w * np.eye(len(A)) - A, B.astype(complex)) + D
    found[:, 3:6] += found[:, 6:9] / (1j * w)
    return np.delete(found, [6, 7, 8], axis=1)


def newton_euler(w: float, spin: float, springs: dict[str, float], dampers: dict[str, float]) -> np.ndarray:
    """The same by the momentum of two bodies: unknown is the absolute acceleration of the rotor (x, y, z, x, y)."""
    s, kinds = 1j * w, ("radial", "radial", "axial", "rocking", "rocking")
    stiffness, damping = (
        np.array([of[f"{kind}_{what}"] for kind in kinds])
        for of, what in ((springs, "stiffness"), (dampers, "damping"))
    )
    bearing = (stiffness + s * damping) / s**2  # force on the rotor for each unit of relative acceleration
    rotor = np.diag([ROTOR] * 3 + [TILTING] * 2).astype(complex)
    rotor[3, 4], rotor[4, 3] = AXIAL * spin / s, -AXIAL * spin / s  # the spin's momentum tilts with the rotor
    housing = np.diag([MASS - ROTOR] * 3 + [RADIAL - TILTING] * 2)
    found = np.zeros((7, 12), complex)
    moved, loaded = np.hstack([np.eye(5), np.zeros((5, 7))]), np.hstack([np.zeros((5, 7)), np.eye(5)])
    motion = linalg.solve(rotor + np.diag(bearing), loaded + np.diag(bearing) @ moved)
    found[:5] = np.diag(bearing) @ (motion - moved) - housing @ moved
    found[5, 6], found[6, 6], found[6, 5] = 1.0, -1.0 / AXIAL, -1.0
    return found


@pytest.mark.parametrize("nominal", [0.0, 150.0])
def test_two_bodies_by_newton_and_euler(nominal: float) -> None:
    system = wheel(RealParameter("speed", nominal, -1000.0, 1000.0), **SPRINGS, **DAMPERS)
    for spin in (0.0, 230.0, -870.0):
        for w in OMEGA:
            ours, theirs = response(system.at({"speed": spin}), w), newton_euler(w, spin, SPRINGS, DAMPERS)
            assert np.abs(ours - theirs).max() < 1e-10 * np.abs(theirs).max()


def test_whirl_modes_split_with_the_speed() -> None:
    """Backward and forward whirl of a symmetric rotor on springs; the other modes stay; one pair at rest."""
    system, rocking = wheel(**SPRINGS), SPRINGS["rocking_stiffness"] / TILTING
    others = [np.sqrt(SPRINGS[f"{kind}_stiffness"] / ROTOR) for kind in ("axial", "radial", "radial")]
    for spin in (0.0, 40.0, -400.0, 1000.0):
        half = abs(spin) * AXIAL / (2.0 * TILTING)
        whirl = [sign * half + np.hypot(half, np.sqrt(rocking)) for sign in (-1.0, 1.0)]
        found = np.sort(linalg.eigvals(system.at({"speed": spin}).A).imag)[5:]
        np.testing.assert_allclose(found, np.sort([*whirl, *others]), rtol=1e-7)
        assert (whirl[0] < whirl[1]) == (spin != 0.0)


def test_energy_and_momentum_are_conserved_without_damping() -> None:
    """Power into the base per period is zero at any speed; with all of it free the wheel has its whole mass."""
    system = wheel(**SPRINGS)
    for spin in (0.0, 555.0, -1000.0):
        for w in OMEGA:
            impedance = 1j * w * response(system.at({"speed": spin}), w)[:6, :6]  # force for each unit of velocity
            assert np.abs(impedance + impedance.conj().T).max() < 1e-9 * np.abs(impedance).max()
    slow = response(system.at({"speed": 0.0}), 1e-2)
    np.testing.assert_allclose(slow[:6, :6].real, -np.diag([MASS] * 3 + [RADIAL] * 2 + [0.0]), atol=1e-6)
    np.testing.assert_allclose(slow[:5, 7:].real, np.eye(5), atol=1e-6)


def test_a_stiff_bearing_is_the_rigid_wheel() -> None:
    rigid = reaction_wheel(ReactionWheel(MASS, AXIAL, RADIAL), SPEED)
    errors = []
    for stiff in (1e10, 1e12):
        system = wheel(radial_stiffness=stiff, axial_stiffness=stiff, rocking_stiffness=stiff)
        at = [(response(one.at({"speed": 640.0}), 700.0)) for one in (system, rigid)]
        errors.append(np.abs(at[0] - at[1]).max() / np.abs(at[1]).max())
    assert errors[0] < 1e-3 and errors[1] == pytest.approx(1e-2 * errors[0], rel=0.05)


def test_directions_without_stiffness_are_rigid() -> None:
    partly, rigid = (
        wheel(axial_stiffness=1e6).at({"speed": 300.0}),
        reaction_wheel(ReactionWheel(MASS, AXIAL, RADIAL), SPEED).at({"speed": 300.0}),
    )
    rest = np.array([0, 1, 3, 4, 5, 6])
    np.testing.assert_allclose(response(partly, 90.0)[rest], response(rigid, 90.0)[rest], atol=1e-12)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"rotor_mass": 0.0, **SPRINGS}, "rotor_mass must be positive, got 0.0"),
        ({"radial_stiffness": -1.0}, "radial_stiffness must be positive, got -1.0"),
        ({"radial_damping": 1.0, "axial_stiffness": 1.0}, "radial_damping must be absent without radial_stiffness"),
        ({}, "bearing must have one of radial_stiffness, axial_stiffness, rocking_stiffness, got none"),
        ({**SPRINGS, "rotor_mass": 1.5}, "rotor_mass must be at most that of the wheel, 1, got 1.5"),
        ({**SPRINGS, "rocking_damping": -0.1}, "rocking_damping must not be negative, got -0.1"),
    ],
)
def test_bearings_that_cannot_be_are_refused(values: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        reaction_wheel(
            ReactionWheel(
                MASS, AXIAL, RADIAL, WheelBearing(**{"rotor_mass": ROTOR, "rotor_radial_inertia": TILTING, **values})
            ),
            SPEED,
        )
