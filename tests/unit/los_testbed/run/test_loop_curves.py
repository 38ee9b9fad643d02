"""Nyquist curves of the loop that ran: where they cross the negative real axis, the exact loop becomes unstable."""

from __future__ import annotations

import numpy as np
import pytest
from support.loop_rows import COMMANDS

from los_design.synthesis.store import load_designs
from los_loop.implemented_loop import ImplementedLoop
from los_loop.margins import scaled
from los_loop.nyquist import BrokenLoop, broken_loops
from los_loop.open_loop import OpenLoop
from titop_plant.interface import MIRROR
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.error_budget import MAX_SENSITIVITY
from titop_plant.telescope.load import load_telescope


@pytest.fixture(scope="module")
def mirror_loop() -> ImplementedLoop:
    telescope = load_telescope()
    return ImplementedLoop(
        OpenLoop(control_loop_plant(telescope), telescope, telescope.loop_ports.used_by()),
        *load_designs("implemented"),
        "fsm",
    )


def gain_margin(curve: BrokenLoop) -> float:
    """Smallest factor above 1 that takes a curve through -1: at its crossings of the negative real axis."""
    crossings = []
    for locus in curve.loci.T:
        k = np.flatnonzero(np.diff(np.sign(locus.imag)) != 0.0)
        part = locus.imag[k] / (locus.imag[k] - locus.imag[k + 1])
        real = locus.real[k] + part * (locus.real[k + 1] - locus.real[k])
        crossings += [float(x) for x in real if -1.0 < x < 0.0]
    return -1.0 / min(crossings)


@pytest.fixture(scope="module")
def curve(mirror_loop: ImplementedLoop) -> BrokenLoop:
    (found,) = broken_loops(mirror_loop, mirror_loop.point({}))
    return found


def test_the_exact_loop_becomes_unstable_where_the_curve_reaches_the_critical_point(
    mirror_loop: ImplementedLoop, curve: BrokenLoop
) -> None:
    factor = gain_margin(curve)
    assert 1.9 < factor < 5.0
    _, exact = mirror_loop.sampled_at(mirror_loop.values(mirror_loop.point({})))
    radii = []
    for gain in (0.97 * factor, 1.03 * factor):
        gains = np.ones(COMMANDS)
        gains[MIRROR] = gain
        radii.append(scaled(exact, gains).spectral_radius())
    assert radii[0] < 1.0 < radii[1]


def test_the_distance_from_the_critical_point_bounds_the_sensitivity(curve: BrokenLoop) -> None:
    nearest = np.abs(1.0 + curve.loci).min(axis=1)
    assert np.all(curve.sensitivity >= (1.0 - 1e-9) / nearest)
    assert 1.5 < curve.sensitivity.max() < MAX_SENSITIVITY == 2.0
    assert np.abs(np.diff(curve.loci, axis=0)).max() < 0.5 * np.abs(curve.loci).max(), "columns are curves"
