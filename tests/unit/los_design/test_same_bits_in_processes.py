"""Searches, checks and values of the implemented loop: two processes or threads give the bits of one."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.support.threads import one_thread
from lftkit.support.workers import Workers
from lftkit.tuning.responses import parameters_of
from los_design.search.worst_case_search import Search, SearchOptions
from los_design.synthesis.pair_problem import ALONE, BOTH, Samples, pair_problem
from los_design.synthesis.store import continuous, load_designs
from los_design.verification import stage_check
from los_design.verification.stage_check import check_stage
from los_design.verification.verification import verification_points
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

SMALL = SearchOptions(frequencies=24, points=6, ascents=12, iterations=4, patience=1, several=2)


@pytest.mark.slow
def test_a_search_and_a_check_in_two_processes(monkeypatch) -> None:
    monkeypatch.setattr(stage_check, "CHUNK", 2)
    telescope, pair = load_telescope(), load_designs("implemented")
    system = control_loop_plant(telescope)
    at = verification_points(telescope, system, 0)[:3]
    open_loop, found, checked = OpenLoop(system, telescope), [], []
    with one_thread(), Workers(2) as two:
        for workers in (Workers(), two):
            search = Search(ImplementedLoop(open_loop, *pair, "fsm+pma"), SMALL)
            loop = ImplementedLoop(open_loop, *pair, "fsm")
            found.append(search.run(["fast", "force"], workers=workers))
            checked.append(check_stage(loop, at, changes=False, workers=workers))
    for name, points in found[0].items():
        assert [p.to_mapping() for p in points] == [p.to_mapping() for p in found[1][name]]
    one, other = checked
    assert {n: p.to_mapping() for n, p in one.worst.items()} == {n: p.to_mapping() for n, p in other.worst.items()}
    assert one.stable.tolist() == other.stable.tolist() and len(one.stable) == len(at)
    for name, values in one.envelope.items():
        np.testing.assert_array_equal(values, other.envelope[name])


@pytest.mark.further
def test_values_and_gradients_in_two_threads() -> None:
    telescope = load_telescope()
    with one_thread():
        samples = Samples(OpenLoop(control_loop_plant(telescope), telescope))
        samples.add(np.random.default_rng(0).uniform(size=(2, 7)))
        one, two = (pair_problem(samples, (ALONE, BOTH), (0, 1), threads) for threads in (1, 2))
        matrices = []
        for system in load_designs("implemented"):
            A, B, C, D = continuous(system).at({}).matrices
            matrices.append(np.block([[A, B], [C, D]]))
        x = parameters_of(one.blocks, matrices)
        values = one.values(x)
        np.testing.assert_array_equal(two.values(x), values)
        entries = np.argwhere(values > 0.5 * values.max())
        for first, second in zip(one.slopes(x, entries), two.slopes(x, entries)):
            np.testing.assert_array_equal(first, second)
