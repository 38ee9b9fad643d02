"""Designs from end to end with very small effort, of the usual and of other orders; files that load again."""

from __future__ import annotations

import json
import runpy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lftkit import SampledSystem
from lftkit.analysis.frequency_response import frequency_response
from lftkit.tuning.structures.structures import controller
from los_design.search.worst_case_search import SearchOptions
from los_design.synthesis import paper_start, synthesis
from los_design.synthesis.options import LOOP_DELAY, DesignOptions
from los_design.synthesis.pair_problem import ALONE, BOTH, grid, limits, named
from los_design.synthesis.paper_problem import PaperTask
from los_design.synthesis.provenance import law_digest
from los_design.synthesis.rounds import Effort
from los_design.synthesis.starts import padded, random_law, zero_controller
from los_design.synthesis.store import continuous, load_designs
from los_estimator.problem import kalman_start, observer_plant, observer_structure
from los_loop.implemented_loop import ImplementedLoop, loop_metrics
from los_loop.open_loop import OpenLoop
from titop_plant.interface import CAMERA, K_FSM_INPUTS, K_FSM_OUTPUTS, K_PMA_INPUTS, K_PMA_OUTPUTS
from titop_plant.telescope.control_plant import control_loop_plant

PORTS = {"k-fsm": (K_FSM_INPUTS, K_FSM_OUTPUTS), "k-pma": (K_PMA_INPUTS, K_PMA_OUTPUTS)}
STATUSES = {"converged", "rounds", "out_of_time"}


def check_file(system, kind: str, options: DesignOptions, telescope, tmp_path, command: str) -> None:
    """Ports, period, provenance; written and read back without a change."""
    system.require(*PORTS[kind], 1e-3)
    provenance = system.provenance
    assert provenance["command"] == command
    assert (provenance["seed"], provenance["loop_delay"]) == (options.seed, LOOP_DELAY)
    assert system.design_basis == telescope.design_basis.to_mapping()
    assert provenance["status"] in STATUSES
    assert provenance["commit"]
    system.to_file(tmp_path / "design.json")
    again = type(system).from_file(tmp_path / "design.json")
    assert all(np.array_equal(getattr(system, key), getattr(again, key)) for key in "ABCD")
    assert again.provenance == provenance and again.design_basis == system.design_basis and again.name == system.name
    assert continuous(again).order == 4


SMALL = SearchOptions(frequencies=8, points=2, ascents=1, iterations=1, patience=1, confirmed=0.8)
TINY = Effort(rounds=1, points=0, first=6, iterations=0, target=0.0, searches=(SMALL,))


def measured(telescope, pair, values) -> dict[str, float]:
    """Worst gamma of every requirement of the tuned values' names at one parameter point, by the implemented loop."""
    system, found = control_loop_plant(telescope), {}
    for stage, name in ((ALONE, "fsm"), (BOTH, "fsm+pma")):
        loop = ImplementedLoop(OpenLoop(system, telescope, telescope.loop_ports.used_by()), *pair, name)
        for metric in loop_metrics(telescope, name, telescope.loop_ports.used_by()).values():
            share = limits(telescope, stage)[metric.name]
            every = grid(telescope.weights.band_edge)
            omega = np.array([w for w in every if metric.band[0] <= w < metric.band[1]][::4])
            peaks = [loop.gains(closed, metric, loop.point(values)[None])[0] for closed in loop.at_each(omega)]
            found[named(metric.name, stage)] = float(np.max(peaks)) * metric.limit / share
    return found


def test_a_pair_from_end_to_end(telescope, tmp_path, monkeypatch) -> None:
    """Six steps at the nominal point: the files are whole, no value there is above the tuned one (six digits)."""
    monkeypatch.setattr(synthesis, "EFFORT", TINY)
    options = DesignOptions(seed=3)
    pair = synthesis.design_pair(telescope, options)
    for kind, system in zip(PORTS, pair):
        check_file(system, kind, options, telescope, tmp_path, "los-testbed design all --seed 3")
        assert system.provenance["active_models"] == [pytest.approx(nominal_values(telescope))]
    assert not continuous(pair[0]).at({}).D[:, CAMERA].any()  # no direct path from a zero-order-hold camera
    found = measured(telescope, pair, {})
    for stage, system in zip((ALONE, BOTH), pair):
        tuned = system.provenance["tuned_values"]
        assert set(tuned) == {*limits(telescope, stage), "all noise -> APE", "noise -> RPE"}
        for name in limits(telescope, stage):
            value = found[named(name, stage)]
            assert value <= tuned[name] * (1.0 + 1e-5) and (name == "force" or value > 0.5 * tuned[name])
        worst = {case["requirement"] for case in system.provenance["worst_cases"]}
        assert worst <= set(limits(telescope, stage)) and "fast" in worst


def nominal_values(telescope) -> dict[str, float]:
    return {name: p.nominal for name, p in telescope.uncertain.items()}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["k-fsm", "k-pma"])
def test_one_controller_is_designed_with_the_other_as_it_is(kind: str, telescope, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(synthesis, "NOMINAL_EFFORT", TINY)
    options, (k_fsm, k_pma) = DesignOptions(nominal=True), load_designs("implemented")
    if kind == "k-fsm":
        found, other = synthesis.design_observer(telescope, options), k_fsm
    else:
        found, other = synthesis.design_actuators(telescope, k_fsm, options), k_pma
    command = f"los-testbed design {kind} --nominal --loop-delay 0.0015 --seed 0"
    check_file(found, kind, options, telescope, tmp_path, command)
    stage = ALONE if kind == "k-fsm" else BOTH
    assert set(found.provenance["tuned_values"]) == {*limits(telescope, stage), "all noise -> APE", "noise -> RPE"}
    assert not np.array_equal(found.A, other.A)


@pytest.mark.parametrize("kind", ["k-fsm", "k-pma"])
def test_a_zero_controller_fits_the_runtime_and_does_nothing(kind: str) -> None:
    system = zero_controller(kind)
    system.require(*PORTS[kind], 1e-3)
    assert system.order == 0 and not system.D.any()


EXAMPLE = Path(__file__).parents[3] / "examples" / "paper"
OMEGA = np.geomspace(1e-2, 1e3, 30)


def kalman_of(order: int, telescope):
    structure = observer_structure(observer_plant(telescope), order=order)
    return controller(structure, kalman_start(structure, telescope))


def test_the_kalman_start_of_higher_order_is_the_same_observer(telescope) -> None:
    """More states, which decay and have no effect yet; those of order 4 are as they were."""
    expected = frequency_response(kalman_of(4, telescope), OMEGA)
    for order in (5, 8):
        found = kalman_of(order, telescope)
        assert found.order == order and np.linalg.eigvals(found.A).real.max() < 0.0
        np.testing.assert_allclose(frequency_response(found, OMEGA), expected, rtol=1e-6, atol=1e-12)
        assert np.all(np.abs(found.B[4:]).max(axis=1) > 0.0) and not found.C[:, 4:].any()


def test_the_kalman_start_of_lower_order_is_truncated(telescope) -> None:
    whole, errors = frequency_response(kalman_of(4, telescope), OMEGA), []
    for order in (0, 1, 2, 3):
        found = kalman_of(order, telescope)
        assert found.order == order
        errors.append(np.abs(frequency_response(found, OMEGA) - whole).max())
    assert errors[0] == pytest.approx(np.abs(whole).max()) and errors[2] <= errors[0]


@pytest.mark.parametrize("order", range(9))
def test_random_laws_of_every_order_are_stable_and_small(order: int) -> None:
    law = random_law(3, order=order)
    assert law.order == order and np.any(frequency_response(law, OMEGA))
    assert order == 0 or np.linalg.eigvals(law.A).real.max() < 0.0


@pytest.mark.parametrize("order", [0, 4])
def test_a_padded_controller_has_the_same_response(order: int) -> None:
    """Its further states decay, have inputs, and act on nothing; their poles differ."""
    law = random_law(3, order=order)
    found = padded(law, order + 3)
    poles = np.linalg.eigvals(found.A).real
    assert found.order == order + 3 and poles.max() < 0.0 and len(set(np.round(poles, 6))) == order + 3
    np.testing.assert_array_equal(frequency_response(found, OMEGA), frequency_response(law, OMEGA))
    assert np.all(np.abs(found.B[order:]).max(axis=1) > 0.0) and not found.C[:, order:].any()
    assert padded(law, order) is law
    with pytest.raises(ValueError, match=f"start must be of order 2 or lower, got {order + 3}"):
        padded(found, 2)


def test_a_design_begins_with_the_one_of_lower_order(telescope, monkeypatch) -> None:
    """Its first look has the values that the other ended with; K_PMA compares no random starts."""
    monkeypatch.setattr(synthesis, "NOMINAL_EFFORT", replace(synthesis.NOMINAL_EFFORT, first=6))
    monkeypatch.setattr(PaperTask, "missed_peaks", lambda *given: [])
    monkeypatch.setattr(paper_start, "STEPS", 1)
    low, high = (DesignOptions(nominal=True, loop_delay=0.0, order=order, starts=1) for order in (1, 2))
    k_fsm = synthesis.design_observer(telescope, low)
    k_pma = synthesis.design_actuators(telescope, k_fsm, low)
    monkeypatch.setattr(synthesis, "NOMINAL_EFFORT", replace(synthesis.NOMINAL_EFFORT, first=0))
    observer = synthesis.design_observer(telescope, high, start=k_fsm)
    actuators = synthesis.design_actuators(telescope, k_fsm, high, start=k_pma)
    for below, above in ((k_fsm, observer), (k_pma, actuators)):
        assert continuous(above).order == 2 and "starts" not in above.provenance
        assert above.provenance["start"] == law_digest(below) and "start" not in below.provenance
        assert above.provenance["tuned_values"] == pytest.approx(below.provenance["tuned_values"], rel=1e-5)


@pytest.mark.parametrize("order", [pytest.param(0, marks=pytest.mark.slow), 1, pytest.param(6, marks=pytest.mark.slow)])
def test_a_design_of_another_order_is_stored_and_loads_again(order: int, telescope, tmp_path, monkeypatch) -> None:
    """Both controllers, K_PMA behind that K_FSM; with next to no effort."""
    monkeypatch.setattr(synthesis, "NOMINAL_EFFORT", replace(synthesis.NOMINAL_EFFORT, first=1))
    monkeypatch.setattr(paper_start, "STEPS", 1)
    options = DesignOptions(nominal=True, loop_delay=0.0, order=order, starts=1)
    k_fsm = synthesis.design_observer(telescope, options)
    k_pma = synthesis.design_actuators(telescope, k_fsm, options)
    ports = (K_FSM_INPUTS, K_FSM_OUTPUTS), (K_PMA_INPUTS, K_PMA_OUTPUTS)
    for kind, system, (inputs, outputs) in zip(("k-fsm", "k-pma"), (k_fsm, k_pma), ports):
        system.require(inputs, outputs, 1e-3)
        system.to_file(tmp_path / "k.json")
        again = SampledSystem.from_file(tmp_path / "k.json")
        assert all(np.array_equal(getattr(system, name), getattr(again, name)) for name in "ABCD")
        assert continuous(again).order == order and continuous(again).inputs == inputs
        flags = f" --order {order}" + (" --starts 1" if kind == "k-pma" else "")
        assert again.provenance["command"] == f"los-testbed design {kind} --nominal --loop-delay 0 --seed 0{flags}"
        assert ("starts" in again.provenance) == (kind == "k-pma")


def test_no_order_of_the_paper_s_table_is_worse_than_a_lower_one() -> None:
    script, rows = runpy.run_path(str(EXAMPLE / "orders.py")), json.loads((EXAMPLE / "orders.json").read_text("utf-8"))
    assert [row["order"] for row in rows["orders"]] == list(range(9))
    for kind, soft in script["SOFT"].items():
        values = [max(row[kind]["gammas"][name] for name in soft) for row in rows["orders"]]
        assert all(value <= 1.001 * min(values[: k + 1]) for k, value in enumerate(values))


def test_an_order_that_ends_worse_begins_again_from_the_one_below() -> None:
    """The better of the two counts, and the next order begins with it; a tie within the descents' ends is none."""
    script, asked = runpy.run_path(str(EXAMPLE / "orders.py")), []

    def design(value: float) -> SampledSystem:
        values = {"APE": value, "RPE": 0.1, "mirror": 2.0}
        return replace(zero_controller("k-fsm"), provenance={"tuned_values": values, "status": "", "seconds": 0.0})

    own = {0: 0.7, 1: 0.70001, 2: 2.5, 3: 0.8}
    again = {2: 0.69, 3: 0.9}

    def made(kind, order, observer, start=None):
        asked.append((order, start and start.provenance["tuned_values"]["APE"]))
        return design(own[order] if start is None else again[order])

    found = script["Orders"].all(SimpleNamespace(made=made), "k-fsm", [3, 2, 1, 0])
    assert asked == [(0, None), (1, None), (2, None), (2, 0.70001), (3, None), (3, 0.69)]
    assert [found[order].provenance["tuned_values"]["APE"] for order in range(4)] == [0.7, 0.70001, 0.69, 0.8]
