"""Wheels on bearings and array drives with steppers: equations of motion of their own, a simulated motor."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import linalg, signal

from lftkit import RealParameter, System
from titop_plant.blocks.flexible_body import rigid_body
from titop_plant.blocks.reaction_wheel import ReactionWheel, reaction_wheel
from titop_plant.blocks.revolute_joint import DriveRotor, on_revolute_joint
from titop_plant.blocks.stepper import Stepper
from titop_plant.blocks.wheel_bearing import WheelBearing
from titop_plant.disturbances.mechanisms import (
    ON_ARRAY,
    ON_ROTOR,
    AngleSignal,
    drive_harmonics,
    mechanism_sources,
)
from titop_plant.disturbances.sources import INSTANTS
from titop_plant.interface import DT
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.motion_profiles import MotionProfile
from titop_plant.telescope.telescope import Telescope

INERTIA, GEARBOX, DAMPING = 26.0, 2.0e4, 15.0
ROTOR = DriveRotor(1.2e-5, 100.0, 20.0, 1e-3)
PERFECT = Stepper(1.2e-5, 100.0, 200, 16, 0.4, 1e-3, motor_damping=1e-3)
AXIS = np.array([0.0, 1.0, 0.0])


def joint(rotor: DriveRotor | None = ROTOR, damping: float = DAMPING) -> System:
    array = rigid_body("array", "P", np.diag([60.0, 60.0, 60.0, 400.0, INERTIA, 400.0]))
    return on_revolute_joint(array, "P", AXIS, stiffness=GEARBOX, damping=damping, rotor=rotor)


def response(system: System, w: float) -> np.ndarray:
    A, B, C, D = system.matrices
    return C @ linalg.solve(1j * w * np.eye(len(A)) - A, B.astype(complex)) + D


def about_the_axis(system: System, w: float) -> np.ndarray:
    """Torque on the parent and angle, by parent's angular acceleration, torque on the array, torque of the motor."""
    inputs = (
        "accel_P",
        "joint_torque",
        *(["motor_torque"] if "motor_torque" in {p.name for p in system.inputs} else []),
    )
    return np.delete(response(system[("wrench_P", "joint_angle"), inputs], w)[[4, 6]], [0, 1, 2, 3, 5], axis=1)


def lagrange(w: float, rotor: DriveRotor, damping: float = DAMPING) -> np.ndarray:
    """Parent's angle, psi, phi as coordinates: energies, then the torque that holds the parent's motion."""
    s, n = 1j * w, rotor.gear_ratio
    speeds = [(INERTIA, [1.0, 0.0, 1.0]), (rotor.inertia, [1.0, n, 0.0])]  # of the array and of the rotor
    M = np.sum([inertia * np.outer(v, v) for inertia, v in speeds], axis=0)
    springs = [(GEARBOX, damping, [0.0, -1.0, 1.0]), (rotor.stiffness, rotor.damping, [0.0, n, 0.0])]
    Z = s**2 * M + np.sum([(k + s * d) * np.outer(v, v) for k, d, v in springs], axis=0)
    loads = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, n], [0.0, 1.0, 0.0]])
    base = np.array([1.0 / s**2, 0.0, 0.0])  # the parent's angle for a unit acceleration
    relative = linalg.solve(Z[1:, 1:], loads[1:] - np.outer(Z[1:, 0], base))
    held = Z[0, :1, None] * base[None] + Z[0, 1:] @ relative - loads[0]
    return np.vstack([-held, relative[1]])


def test_the_rotor_by_lagrange() -> None:
    system = joint()
    for w in (0.2, 8.0, 27.0, 120.0, 900.0):
        ours, theirs = about_the_axis(system, w), lagrange(w, ROTOR)
        assert np.abs(ours - theirs).max(axis=1) == pytest.approx(0.0, abs=1e-9 * np.abs(theirs).max())


def simulated(motor: Stepper, count: int = 200_000) -> np.ndarray:
    """Torque over one electrical cycle by the currents in the windings, sample by sample."""
    x = (np.arange(count) + 0.5) * 2.0 * math.pi / count
    width = 0.5 * math.pi / motor.micro_steps
    command = (np.floor(x / width) + 0.5) * width
    gain, third = motor.gain_mismatch, motor.third_harmonic
    a = (1 + gain / 2) * np.cos(command) + third * np.cos(3 * command) + motor.current_offset
    b = (1 - gain / 2) * np.sin(command + motor.quadrature_error) - third * np.sin(3 * command) + motor.current_offset
    return motor.holding_torque * (b * np.cos(x) - a * np.sin(x)) + motor.detent_torque * np.sin(4 * x)


IMPERFECT = replace(
    PERFECT,
    micro_steps=4,
    detent_torque=0.02,
    current_offset=0.01,
    gain_mismatch=0.03,
    third_harmonic=0.02,
    quadrature_error=0.01,
)


def test_harmonics_are_those_of_a_simulated_motor() -> None:
    """Over 200 000 points of a cycle, up to the fortieth harmonic."""
    torque = simulated(IMPERFECT)
    order, amplitude = IMPERFECT.torque_harmonics(40)
    x = (np.arange(torque.size) + 0.5) * 2.0 * math.pi / torque.size
    for h, a in zip(order, amplitude):
        expected = 2j * np.mean(torque * np.exp(-1j * h * x))
        assert abs(a - expected) < 1e-6 * IMPERFECT.holding_torque, h
    assert {1.0, 2.0, 4.0, 12.0, 14.0, 16.0, 20.0, 32.0} <= set(order)


def test_tones_follow_the_rate_of_the_array() -> None:
    """At a constant rate lines at order x cycles x rate; over a ramp the phase is that of the angle."""
    cycles, amplitude = drive_harmonics(
        replace(IMPERFECT, gear_errors=((60.0, 2e-6),)), GEARBOX, np.random.default_rng(1)
    )
    assert 5000.0 in cycles and 60.0 in cycles
    gear = amplitude[cycles == 60.0][0]
    assert abs(gear[ON_ARRAY]) == pytest.approx(GEARBOX * 2e-6)
    assert gear[ON_ROTOR] == pytest.approx(-gear[ON_ARRAY] / 100.0)
    steady = AngleSignal(cycles, amplitude, lambda t: 2e-3 * t, DT, 2e-3)
    values = np.array([steady.tick(k, INSTANTS[:1])[0, ON_ROTOR] for k in range(20_000)])
    frequency, power = signal.periodogram(values, 1.0 / DT)
    loudest = frequency[np.argmax(power)]
    assert loudest == pytest.approx(16 * 5000 * 2e-3 / (2 * math.pi), abs=0.06)
    assert np.isclose(steady.lines, 16 * 5000 * 2e-3).any()
    moving = AngleSignal(cycles, amplitude, lambda t: 0.5e-3 * t**2, DT)
    k = 700  # angle 0.5e-3 0.7^2
    expected = (np.exp(1j * cycles * 0.5e-3 * (k * DT) ** 2) @ amplitude).imag
    np.testing.assert_allclose(moving.tick(k, INSTANTS[:1])[0], expected, atol=1e-12)
    assert not moving.lines.size


STEPPER = {
    "rotor_inertia": 1.2e-5,
    "gear_ratio": 100.0,
    "full_steps": 200,
    "micro_steps": 16,
    "holding_torque": 0.4,
    "rate": 1e-3,
}
NOISE = {"frequency": [1.0, 400.0], "radial_force": [1e-6, 1e-6], "axial_torque": [4e-8, 4e-8]}


def with_mechanisms(**stepper: Any) -> Telescope:
    return load_telescope().changed(
        {"sadm": {"stepper": {**STEPPER, **stepper}}, "reaction_wheel": {"broadband": NOISE}}
    )


@pytest.mark.further
def test_sources_of_the_telescope_have_a_row_each_and_their_density() -> None:
    """One-sided density of 20 s of each wheel's noise; wheels and axes are independent; the seed gives the bits."""
    still = MotionProfile(np.zeros(1), np.zeros(1), np.full((1, 4), 200.0))
    noise, drive = mechanism_sources(with_mechanisms(detent_torque=0.01), still, 20.0, 5)
    assert (noise.name, drive.name) == ("wheel broadband", "array drive")
    assert (noise.matrix.shape[1], drive.matrix.shape[1]) == (24, 12)
    values = np.array([noise.signal.tick(k, INSTANTS[:1])[0] for k in range(20_000)])
    frequency, power = signal.welch(values, 1.0 / DT, nperseg=1000, axis=0)
    inside = (frequency > 5.0) & (frequency < 350.0)
    expected = np.tile([1e-6, 1e-6, 0.0, 0.0, 0.0, 4e-8], 4)
    np.testing.assert_allclose(power[inside].mean(axis=0), expected, rtol=0.05, atol=1e-15)
    active = values[:, expected > 0.0]
    alike = np.corrcoef(active.T) - np.eye(active.shape[1])
    assert np.abs(alike).max() < 0.05
    again = mechanism_sources(with_mechanisms(detent_torque=0.01), still, 20.0, 5)[0]
    np.testing.assert_array_equal(again.signal.tick(7, INSTANTS), noise.signal.tick(7, INSTANTS))


def test_torques_and_noise_are_in_no_design() -> None:
    plain, noisy, other = load_telescope(), with_mechanisms(), with_mechanisms(detent_torque=0.01, rate=2e-3)
    assert noisy.parameters_hash == other.parameters_hash != plain.parameters_hash
    assert noisy.without_steppers().parameters_hash == plain.parameters_hash


MASS, AXIAL, RADIAL = 1.0, 0.096, 0.05

ROTOR_MASS, TILTING = 0.8, 0.045

SPRINGS = {"radial_stiffness": 1.5e6, "axial_stiffness": 1.0e6, "rocking_stiffness": 6.0e3}

DAMPERS = {"radial_damping": 30.0, "axial_damping": 20.0, "rocking_damping": 0.3}

SPEED = RealParameter("speed", 0.0, -1000.0, 1000.0)

OMEGA = np.array([3.0, 120.0, 365.0, 900.0, 1370.0, 4000.0])


def wheel(speed: RealParameter = SPEED, **bearing: float) -> System:
    return reaction_wheel(ReactionWheel(MASS, AXIAL, RADIAL, WheelBearing(ROTOR_MASS, TILTING, **bearing)), speed)


def wheel_response(system: System, w: float) -> np.ndarray:
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
    rotor = np.diag([ROTOR_MASS] * 3 + [TILTING] * 2).astype(complex)
    rotor[3, 4], rotor[4, 3] = AXIAL * spin / s, -AXIAL * spin / s  # the spin's momentum tilts with the rotor
    housing = np.diag([MASS - ROTOR_MASS] * 3 + [RADIAL - TILTING] * 2)
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
            ours, theirs = wheel_response(system.at({"speed": spin}), w), newton_euler(w, spin, SPRINGS, DAMPERS)
            assert np.abs(ours - theirs).max() < 1e-10 * np.abs(theirs).max()


def test_whirl_modes_split_with_the_speed() -> None:
    """Backward and forward whirl of a symmetric rotor on springs; the other modes stay; one pair at rest."""
    system, rocking = wheel(**SPRINGS), SPRINGS["rocking_stiffness"] / TILTING
    others = [np.sqrt(SPRINGS[f"{kind}_stiffness"] / ROTOR_MASS) for kind in ("axial", "radial", "radial")]
    for spin in (0.0, 40.0, -400.0, 1000.0):
        half = abs(spin) * AXIAL / (2.0 * TILTING)
        whirl = [sign * half + np.hypot(half, np.sqrt(rocking)) for sign in (-1.0, 1.0)]
        found = np.sort(linalg.eigvals(system.at({"speed": spin}).A).imag)[5:]
        np.testing.assert_allclose(found, np.sort([*whirl, *others]), rtol=1e-7)
        assert (whirl[0] < whirl[1]) == (spin != 0.0)


def test_directions_without_stiffness_are_rigid() -> None:
    partly, rigid = (
        wheel(axial_stiffness=1e6).at({"speed": 300.0}),
        reaction_wheel(ReactionWheel(MASS, AXIAL, RADIAL), SPEED).at({"speed": 300.0}),
    )
    rest = np.array([0, 1, 3, 4, 5, 6])
    np.testing.assert_allclose(wheel_response(partly, 90.0)[rest], wheel_response(rigid, 90.0)[rest], atol=1e-12)


def test_energy_and_momentum_are_conserved_without_damping() -> None:
    system, still = joint(replace(ROTOR, damping=0.0), 0.0), 1e-3
    for w in (0.5, 9.0, 60.0, 700.0):
        impedance = 1j * w * response(system["wrench_P", "accel_P"], w)
        assert np.abs(impedance + impedance.conj().T).max() < 1e-9 * np.abs(impedance).max()
    whole = response(system["wrench_P", "accel_P"], still)[4, 4]
    assert -whole.real == pytest.approx(INERTIA + ROTOR.inertia, rel=1e-6)
    inner = response(system["wrench_P", ("joint_torque", "motor_torque")], still)
    assert np.abs(inner).max() < 1e-6  # a torque inside of the drive moves nothing outside at rest


@pytest.mark.parametrize("kind", ["light and held", "light"])
def test_without_inertia_of_the_rotor_it_is_the_joint_on_springs_in_series(kind: str) -> None:
    """Held firmly the joint of today; by its own spring that of both springs in series."""
    stiffness = 1e4 if kind == "light and held" else ROTOR.stiffness
    light = joint(DriveRotor(1e-8, ROTOR.gear_ratio, stiffness), 0.0)
    motor = ROTOR.gear_ratio**2 * stiffness
    array = rigid_body("array", "P", np.diag([60.0, 60.0, 60.0, 400.0, INERTIA, 400.0]))
    series = on_revolute_joint(array, "P", AXIS, stiffness=GEARBOX * motor / (GEARBOX + motor), damping=0.0)
    for w in (0.3, 20.0, 60.0):
        one, two = about_the_axis(light, w), about_the_axis(series, w)
        np.testing.assert_allclose(one[:, 0], two[:, 0], rtol=1e-6)
        assert one[0, 1] == pytest.approx(two[0, 1], rel=1e-6)


def test_a_stiff_bearing_is_the_rigid_wheel() -> None:
    rigid = reaction_wheel(ReactionWheel(MASS, AXIAL, RADIAL), SPEED)
    errors = []
    for stiff in (1e10, 1e12):
        system = wheel(radial_stiffness=stiff, axial_stiffness=stiff, rocking_stiffness=stiff)
        at = [(response(one.at({"speed": 640.0}), 700.0)) for one in (system, rigid)]
        errors.append(np.abs(at[0] - at[1]).max() / np.abs(at[1]).max())
    assert errors[0] < 1e-3 and errors[1] == pytest.approx(1e-2 * errors[0], rel=0.05)
