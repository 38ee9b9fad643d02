"""Designs from end to end with very small effort: what the returned file holds, screening."""

from __future__ import annotations

import numpy as np
import pytest

from los_design.search.worst_case_search import SearchOptions
from los_design.synthesis import synthesis
from los_design.synthesis.options import LOOP_DELAY, DesignOptions
from los_design.synthesis.pair_problem import ALONE, BOTH, grid, limits, named
from los_design.synthesis.rounds import Effort
from los_design.synthesis.starts import zero_controller
from los_design.synthesis.store import continuous, load_designs
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
        loop = ImplementedLoop(OpenLoop(system, telescope), *pair, name)
        for metric in loop_metrics(telescope, name).values():
            share = limits(telescope, stage)[metric.name]
            omega = np.array(
                [w for w in grid(telescope.weights.band_edge) if metric.band[0] <= w < metric.band[1]][::4]
            )
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
    check_file(
        found, kind, options, telescope, tmp_path, f"los-testbed design {kind} --nominal --loop-delay 0.0015 --seed 0"
    )
    stage = ALONE if kind == "k-fsm" else BOTH
    assert set(found.provenance["tuned_values"]) == {*limits(telescope, stage), "all noise -> APE", "noise -> RPE"}
    assert not np.array_equal(found.A, other.A)


@pytest.mark.parametrize("kind", ["k-fsm", "k-pma"])
def test_a_zero_controller_fits_the_runtime_and_does_nothing(kind: str) -> None:
    system = zero_controller(kind)
    system.require(*PORTS[kind], 1e-3)
    assert system.order == 0 and not system.D.any()
