"""Largest values over a grid: the parts of a grid together have what each point has by itself at each frequency."""

from __future__ import annotations

import numpy as np
import pytest

from los_design.synthesis.store import load_designs
from los_design.verification.sweep import Reach, joined, sweep
from los_loop.implemented_loop import ImplementedLoop, loop_metrics
from los_loop.margins import doubtful
from los_loop.open_loop import OpenLoop
from titop_plant.interface import MIRROR_STAGES
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

OMEGA = np.array([0.3, 7.4, 40.0, 190.0, 580.0, 2500.0])


@pytest.fixture(scope="module")
def loops() -> list[ImplementedLoop]:
    telescope = load_telescope()
    open_loop = OpenLoop(control_loop_plant(telescope), telescope)
    return [ImplementedLoop(open_loop, *load_designs("implemented"), stage) for stage in MIRROR_STAGES]


def test_parts_of_a_grid_have_the_largest_values_of_each_point(loops) -> None:
    """Of both stages; the point with the largest force at 580 rad/s counts as unstable, and has no part in them."""
    cube = np.random.default_rng(3).uniform(size=(7, 7))
    force = loop_metrics(loops[1].telescope, loops[1].stage)["force"]
    stable = np.arange(7) != loops[1].gains(loops[1].at(580.0), force, cube).argmax()
    reaches = [Reach(loop, loop_metrics(loop.telescope, loop.stage)) for loop in loops]
    parts = [sweep(reaches, OMEGA, np.arange(k, len(OMEGA), 2), cube, [stable, stable]) for k in range(2)]
    for reach, loop, found in zip(reaches, loops, (joined(part) for part in zip(*parts))):
        doubt = np.zeros_like(found.doubt)
        for w in OMEGA:
            doubt |= doubtful(loop.sensitivities(loop.at(float(w)), cube), float(w), loop.stage)
        np.testing.assert_array_equal(found.doubt, doubt)
        for name, metric in reach.metrics.items():
            table = np.zeros((len(OMEGA), len(cube)))
            for k, w in enumerate(OMEGA):
                if metric.band[0] <= w <= metric.band[1]:
                    table[k] = loop.gains(loop.at(float(w)), metric, cube) * stable
            np.testing.assert_allclose(found.value[name], table.max(axis=0), rtol=1e-9, err_msg=name)
            np.testing.assert_array_equal(found.place[name][stable], table.argmax(axis=0)[stable], err_msg=name)
            np.testing.assert_allclose(found.envelope[name], table.max(axis=1), rtol=1e-9, err_msg=name)


def test_without_changes_nothing_is_in_doubt(loops) -> None:
    reach = Reach(loops[1], loop_metrics(loops[1].telescope, loops[1].stage), changes=False)
    (found,) = sweep([reach], OMEGA, np.arange(6), np.full((1, 7), 0.5), [np.array([True])])
    assert not found.doubt.any() and found.value["APE"][0] > 0.0
