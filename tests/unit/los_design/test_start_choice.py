"""Start of a design: the stored one for the reference telescope, the best of several for another one."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

from lftkit.tuning.responses import gain_matrices
from lftkit.tuning.structures.structures import gain_matrix_of
from los_design.synthesis import start_choice, synthesis
from los_design.synthesis.options import LOOP_DELAY, DesignOptions
from los_design.synthesis.pair_problem import BOTH, blocks
from los_design.synthesis.starts import stored_start
from los_design.synthesis.store import continuous, load_designs
from los_estimator.problem import kalman_start, observer_plant, observer_structure
from titop_plant.telescope.telescope import Telescope

KEPT = 500.0
"""Random laws with larger entries are taken as not stabilising."""


@pytest.fixture(scope="module")
def kalman(telescope):
    structure = observer_structure(observer_plant(telescope, **DesignOptions().hold_delays), camera_hold=True)
    return structure.gain_matrix(kalman_start(structure, telescope, lead=LOOP_DELAY))


@pytest.fixture
def chosen(monkeypatch):
    """What a design begins with, as gain matrices, and the lines of the choice."""

    def choose(telescope, options=None, observer=None):
        lines: list[str] = []
        found: list[Any] = []

        def stop(task, start, *rest):
            found.append(gain_matrices(blocks(telescope, task.tuned), start()))
            raise InterruptedError

        monkeypatch.setattr(synthesis, "design_in_rounds", stop)
        options = options or DesignOptions()
        design: Any = synthesis.design_pair
        if observer is not None:
            design = partial(synthesis.design_actuators, observer=observer)
        with pytest.raises(InterruptedError):
            design(telescope, options=options, report=lines.append)
        return found[0], lines

    return choose


def another(telescope) -> Telescope:
    return telescope.changed({"isolator": {"stiffness": [0.25 * k for k in telescope.isolator.stiffness]}})


@pytest.mark.further
def test_the_reference_telescope_has_the_stored_start(telescope, chosen) -> None:
    found, lines = chosen(telescope)
    assert lines == []
    for M, kind in zip(found, ("k-fsm", "k-pma")):
        np.testing.assert_array_equal(M, gain_matrix_of(stored_start(kind)))


@pytest.mark.slow
def test_another_telescope_has_the_best_of_several_after_a_short_descent(telescope, chosen, monkeypatch) -> None:
    """Which one it is depends on the stored pair; the lowest value of all is improved, and alone."""
    monkeypatch.setattr(start_choice, "POINTS", 1)
    monkeypatch.setattr(start_choice, "STEPS", 6)
    monkeypatch.setattr(start_choice, "COMPARED", 1)
    table = another(telescope)
    found, lines = chosen(table)
    assert lines[0] == "another telescope than that of the stored start: starts are compared"
    assert lines[1].startswith("start from ") and len(lines) == 2
    before, after = (float(text.split()[-1]) for text in lines[1].split(", after"))
    assert after < before
    stored = [gain_matrix_of(continuous(system).at({})) for system in load_designs("implemented")]
    assert all(np.abs(M - S).max() > 0.0 for M, S in zip(found, stored))


@pytest.mark.further
def test_where_the_stored_ones_do_not_stabilise_it_is_the_kalman_observer(telescope, kalman, chosen, monkeypatch):
    """With the random law of the largest gain that it bears; the lowest value of the three seeds is chosen."""

    def stable(task, x, values=None):
        F, P = gain_matrices(blocks(telescope, BOTH), x)
        stored = np.array_equal(P, gain_matrix_of(continuous(load_designs("implemented")[1]).at({})))
        return np.array_equal(F, kalman) and np.abs(P).max() < KEPT and not stored

    monkeypatch.setattr(synthesis.ImplementedTask, "stable", stable)
    monkeypatch.setattr(start_choice, "descended", lambda task, problem, x: x)
    monkeypatch.setattr(start_choice, "POINTS", 0)
    (F, P), lines = chosen(telescope)
    assert np.array_equal(F, kalman) and 0.0 < np.abs(P).max() < KEPT
    values = [float(line.rsplit(" ", 1)[1]) for line in lines if line.startswith("start from a random K_PMA")]
    assert len(values) == len(lines) - 1 == 2 and values == sorted(values)

    monkeypatch.setattr(synthesis.ImplementedTask, "stable", lambda *rest: False)
    with pytest.raises(ValueError, match="K_FSM must stabilise the telescope with a small K_PMA, got one that does"):
        chosen(telescope)


@pytest.mark.further
def test_a_given_observer_stays_as_it_is(telescope, chosen, monkeypatch) -> None:
    monkeypatch.setattr(start_choice, "descended", lambda task, problem, x: x)
    monkeypatch.setattr(start_choice, "POINTS", 0)
    table, observer = another(telescope), load_designs("implemented")[0]
    (F, _), lines = chosen(table, DesignOptions(nominal=True), observer)
    np.testing.assert_array_equal(F, gain_matrix_of(continuous(observer).at({})))
    assert not any("Kalman" in line for line in lines)
