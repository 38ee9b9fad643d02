"""Uniform beams: the numbers every textbook prints (Blevins 1979; Alazard, Perez & Cumer 2015)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from oracles.static_frame import static_displacement
from scipy.linalg import eigh, solve

from titop_plant.structures import (
    Beam,
    BeamFrame,
    ModalData,
    Section,
    effective_masses,
    to_modal_data,
)
from titop_plant.structures.beam_frame import assemble

LENGTH, MASS, UP = 2.0, 3.0, np.array([0.0, 1.0, 0.0])
SECTION = Section(E=7e10, G=2.7e10, density=MASS / (LENGTH * 1e-4), A=1e-4, Iy=2e-9, Iz=5e-9, J=3e-9)
#: sqrt(EI / (rho A L^4)) of the two planes
UNIT_XY = np.sqrt(SECTION.E * SECTION.Iz / (MASS / LENGTH * LENGTH**4))
UNIT_XZ = np.sqrt(SECTION.E * SECTION.Iy / (MASS / LENGTH * LENGTH**4))

CLAMPED_FREE = [3.516015, 22.034492, 61.697214, 120.901916]
EFFECTIVE_MASS = [0.613076, 0.188300, 0.064732, 0.033087]
EFFECTIVE_INERTIA = [0.970688, 0.024716, 0.003152]
FREE_FREE = [4.73004074, 7.85320462]
PINNED_FREE = 3.92660231


def beam(elements: int = 24) -> BeamFrame:
    return BeamFrame(
        "beam", {"P": np.zeros(3), "C": np.array([LENGTH, 0, 0])}, (Beam("P", "C", SECTION, up=UP, elements=elements),)
    )


def clamped(elements: int = 24) -> ModalData:
    return to_modal_data(beam(elements), "P", ["C"])


def plane(data: ModalData, axis: int) -> np.ndarray:
    """Modes that move along one axis (1 = y: bending in x-y, 2 = z), in the order of frequency."""
    masses = effective_masses(data)
    return np.flatnonzero(masses[:, axis] > 1e-6 * masses.sum(axis=0)[axis])


def extrapolated(quantity: Callable[[ModalData], np.ndarray]) -> np.ndarray:
    """Limit of a quantity from two meshes: the error of consistent mass goes with the fourth power of h."""
    return (16.0 * quantity(clamped(64)) - quantity(clamped(32))) / 15.0


@pytest.mark.parametrize(("axis", "unit"), [(1, UNIT_XY), (2, UNIT_XZ)])
def test_clamped_free_frequencies(axis: int, unit: float) -> None:
    found = extrapolated(lambda data: data.frequencies[plane(data, axis)[:4]] / unit)
    np.testing.assert_allclose(found, CLAMPED_FREE, rtol=0, atol=1.5e-6)


@pytest.mark.parametrize(("axis", "rotation"), [(1, 5), (2, 4)])
def test_effective_masses_and_inertias(axis: int, rotation: int) -> None:
    masses = extrapolated(lambda data: effective_masses(data)[plane(data, axis)[:4]])
    np.testing.assert_allclose(masses[:, axis] / MASS, EFFECTIVE_MASS, rtol=0, atol=1e-6)
    inertias = masses[:3, rotation] / (MASS * LENGTH**2 / 3)
    np.testing.assert_allclose(inertias, EFFECTIVE_INERTIA, rtol=0, atol=1e-6)


def test_effective_masses_sum_to_the_total() -> None:
    """All modes together carry the mass, less what the clamped half element keeps for itself."""
    for elements, bound in ((10, 0.05), (40, 0.012)):
        data = clamped(elements)
        missing = 1.0 - effective_masses(data).sum(axis=0) / np.diag(data.mass_matrix)
        assert np.all(missing > -1e-9)
        assert np.all(missing < bound)


def test_axial_and_torsional_frequencies() -> None:
    """(2k - 1) pi/2 times the wave speed over the length, in tension and in torsion."""
    data = clamped(60)
    expected = (2 * np.arange(1, 3) - 1) * np.pi / 2 / LENGTH
    axial = data.frequencies[plane(data, 0)[:2]]
    np.testing.assert_allclose(axial, expected * np.sqrt(SECTION.E / SECTION.density), rtol=3e-4)
    speed = np.sqrt(SECTION.G * SECTION.J / (SECTION.density * (SECTION.Iy + SECTION.Iz)))
    torsional = data.frequencies[plane(data, 3)[:2]]
    np.testing.assert_allclose(torsional, expected * speed, rtol=3e-4)


def bending_frequencies(fixed: list[int], elements: int) -> np.ndarray:
    """Bending in x-y of the beam with some degrees of freedom of its first node fixed, over UNIT_XY."""
    names, M, K = assemble(beam(elements))
    in_plane = np.flatnonzero(np.isin(np.arange(6 * len(names)) % 6, [1, 5]))
    keep = np.setdiff1d(in_plane, fixed)
    squares = eigh(K[np.ix_(keep, keep)], M[np.ix_(keep, keep)], eigvals_only=True)
    return np.sqrt(np.maximum(squares, 0.0)) / UNIT_XY


@pytest.mark.parametrize(("fixed", "rigid", "expected"), [([], 2, FREE_FREE), ([1], 1, [PINNED_FREE])])
def test_free_free_and_pinned_frequencies(fixed: list[int], rigid: int, expected: list[float]) -> None:
    """The beam is free with two rigid modes in the plane, pinned with one; then (beta L)^2."""
    fine, coarse = bending_frequencies(fixed, 64), bending_frequencies(fixed, 32)
    assert np.all(fine[:rigid] < 1e-7 * fine[-1])  # zero to round-off
    found = np.sqrt((16.0 * fine[rigid : rigid + len(expected)] - coarse[rigid : rigid + len(expected)]) / 15.0)
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-8)


def test_frequencies_fall_to_the_exact_ones_as_the_mesh_is_refined() -> None:
    """Consistent mass: upper bounds, error of the fourth order in the element length."""
    errors = []
    for elements in (4, 8, 16):
        data = clamped(elements)
        errors.append(data.frequencies[plane(data, 1)[1]] / UNIT_XY / CLAMPED_FREE[1] - 1)
    assert errors[0] > errors[1] > errors[2] > 0
    assert errors[0] / errors[1] > 13
    assert errors[1] / errors[2] > 15


@pytest.mark.parametrize(
    ("load", "component", "expected"),
    [
        ([0, 5.0, 0, 0, 0, 0], 1, 5.0 * LENGTH**3 / (3 * SECTION.E * SECTION.Iz)),
        ([0, 0, 5.0, 0, 0, 0], 2, 5.0 * LENGTH**3 / (3 * SECTION.E * SECTION.Iy)),
        ([0, 5.0, 0, 0, 0, 0], 5, 5.0 * LENGTH**2 / (2 * SECTION.E * SECTION.Iz)),
        ([0, 0, 5.0, 0, 0, 0], 4, -5.0 * LENGTH**2 / (2 * SECTION.E * SECTION.Iy)),
        ([5.0, 0, 0, 0, 0, 0], 0, 5.0 * LENGTH / (SECTION.E * SECTION.A)),
        ([0, 0, 0, 5.0, 0, 0], 3, 5.0 * LENGTH / (SECTION.G * SECTION.J)),
        ([0, 0, 0, 0, 5.0, 0], 2, -5.0 * LENGTH**2 / (2 * SECTION.E * SECTION.Iy)),
        ([0, 0, 0, 0, 0, 5.0], 5, 5.0 * LENGTH / (SECTION.E * SECTION.Iz)),
    ],
)
def test_static_deflection_of_the_tip(load: list[float], component: int, expected: float) -> None:
    tip = static_displacement(beam(5), "P", {"C": load})["C"]
    assert tip[component] == pytest.approx(expected, rel=1e-8)


def test_modal_data_hold_the_static_compliance() -> None:
    """Phi diag(1/w^2) Phi' over all modes is the flexibility seen at the tip."""
    data = clamped(6)
    shapes = data.child("C").shapes
    flexibility = shapes @ np.diag(data.frequencies**-2) @ shapes.T
    exact = np.column_stack([static_displacement(beam(6), "P", {"C": unit})["C"] for unit in np.eye(6)])
    np.testing.assert_allclose(flexibility, exact, atol=1e-9 * np.abs(exact).max())


def test_half_beam_and_half_beam_are_the_beam() -> None:
    """Two TITOP halves in series, by their equations at s = j omega, are the whole."""
    half = BeamFrame(
        "half", {"P": np.zeros(3), "C": np.array([LENGTH / 2, 0, 0])}, (Beam("P", "C", SECTION, up=UP, elements=8),)
    )
    inner, whole = to_modal_data(half, "P", ["C"]), clamped(16)
    for omega in (3.0, 40.0, 500.0):
        left, right = titop(inner, omega), titop(inner, omega)
        # accel_C and wrench_P of each half; the joint shares acceleration and wrench
        joint = solve(np.eye(6) - left[:6, :6] @ right[6:, 6:], left[:6, 6:])
        wrench = left[6:, 6:] + left[6:, :6] @ right[6:, 6:] @ joint
        expected = titop(whole, omega)[6:, 6:]
        np.testing.assert_allclose(wrench, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def titop(data: ModalData, omega: float) -> np.ndarray:
    """[accel_C; wrench_P] per [wrench_C; accel_P], undamped, shape (12, 12)."""
    s2 = -(omega**2)
    modal = np.diag(1.0 / (s2 + data.frequencies**2))
    shapes, L, tau = data.child("C").shapes, data.participation, data.child_tau("C")
    accel_c = np.hstack([s2 * shapes @ modal @ shapes.T, tau - s2 * shapes @ modal @ L])
    wrench_p = np.hstack([tau.T - s2 * L.T @ modal @ shapes.T, -data.mass_matrix + s2 * L.T @ modal @ L])
    return np.vstack([accel_c, wrench_p])
