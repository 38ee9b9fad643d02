"""A telescope whose mirror moves the line of sight twice as much: run, prediction, analysis and replay all use 0.2.

With twice the sensitivity half the mirror angle does the same to the line of sight. The observer of this test is the
stored one with twice the gain from the strain gauges, so that it takes out the same share: the loop is the reference
loop in other coordinates of the mirror, but for the mirror's reaction on the payload, which is small.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.summary.predictions import predictions
from los_testbed.run.summary.ran_loop import RanLoop

from lftkit import SampledSystem
from los_design.synthesis.store import load_designs
from los_loop.sampled_loop_norms import sampled_loop_metrics
from pointing_analysis.indices.errors import knowledge_error
from pointing_analysis.indices.telescope_values import telescope_value
from pointing_analysis.read.run import Run
from titop_plant.interface import FSM_ANGLE
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

SENSITIVITY = 0.2


def for_sensitivity(k_fsm: SampledSystem, basis: dict[str, object]) -> SampledSystem:
    """The observer with twice the gain from the mirror's strain gauges."""
    B, D = k_fsm.B.copy(), k_fsm.D.copy()
    B[:, FSM_ANGLE] *= 2.0
    D[:, FSM_ANGLE] *= 2.0
    return replace(k_fsm, B=B, D=D, design_basis=basis)


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> RunConfig:
    folder = tmp_path_factory.mktemp("mirror")
    user = folder / "user.toml"
    user.write_text(f"base = 'reference'\n[fsm]\nlos_sensitivity = {SENSITIVITY}\n")
    basis = load_telescope(user).design_basis.to_mapping()
    k_fsm, k_pma = load_designs("implemented")
    for_sensitivity(k_fsm, basis).to_file(folder / "k_fsm.json")
    replace(k_pma, design_basis=basis).to_file(folder / "k_pma.json")
    return RunConfig(
        duration=6.0,
        scenario="design",
        mode="inprocess",
        noise=False,
        parameters=str(user),
        k_fsm=str(folder / "k_fsm.json"),
        k_pma=str(folder / "k_pma.json"),
    )


@pytest.fixture(scope="module")
def bag(config: RunConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    assert RunParts(config).check() == ()
    path = tmp_path_factory.mktemp("bag") / "bag"
    run_in_process(config, path)
    return path


def test_the_simulation_does_what_the_sampled_loop_predicts(bag: Path) -> None:
    (found,) = predictions([RanLoop.of(Run.open(bag))])
    assert found is not None and not found.note
    assert len(found.tones) >= 2
    for tone in found.tones:
        assert tone.ratio == pytest.approx(1.0, abs=0.02)


def test_the_metrics_are_those_of_the_reference_loop(config: RunConfig) -> None:
    """Pointing errors and stability within 3 %, half the mirror; a law that divides by 0.1 has other errors."""
    metrics = []
    chosen = RunParts(config).models
    wrong = replace(chosen["k_fsm"], design_basis={"los_sensitivity": 0.1})
    for path, pair in (
        (None, load_designs("implemented")),
        (config.parameters, (chosen["k_fsm"], chosen["k_pma"])),
        (config.parameters, (wrong, chosen["k_pma"])),
    ):
        telescope = load_telescope(path) if path else load_telescope()
        plant = control_loop_plant(telescope).at({})
        metrics.append(sampled_loop_metrics(plant, *pair, telescope, loop="fsm+pma", noise=False))
    reference, same, other = metrics
    for name in ("ape", "rpe", "radius"):
        assert getattr(same, name) == pytest.approx(getattr(reference, name), rel=0.03)
    assert same.mirror == pytest.approx(0.5 * reference.mirror, rel=0.03)
    assert other.radius > 1.0 or other.ape > 1.5 * reference.ape


def test_the_analysis_takes_the_sensitivity_from_the_bag(bag: Path) -> None:
    """Knowledge error: estimate plus 0.2 times the mirror's angle, less the truth."""
    run = Run.open(bag)
    assert telescope_value(run, "los_sensitivity") == SENSITIVITY
    found = knowledge_error(run)
    estimate, angle, truth = (run[name].values[:, :2] for name in ("los_estimate", "fsm/strain_gauge", "truth/los"))
    expected = (estimate + SENSITIVITY * angle - truth)[-len(found.values) :]
    assert len(found.values) > 1000
    np.testing.assert_allclose(found.values, expected, rtol=0, atol=1e-15)
