"""Metrics of a member from its matrices against the periodic solution of the assembled loop, which shares no code."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.campaign.sampling import MemberParameters, member_seeds, members
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from support.loop_rows import loop_rows
from support.unstable_laws import with_slow_pole

from lftkit import SampledSystem
from lftkit.analysis.batched_linalg import determinants
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.member_loop import MemberLoop, MemberLoopSettings
from los_loop.member_metrics import MemberMetrics, metric_names
from los_loop.sampled_loop_norms import sampled_loop_metrics, weighted_gains
from pointing_analysis.indices.errors import RAD_PER_ARCSEC, RAD_PER_MAS
from titop_plant.telescope.window_noise import WindowNoise, combined_level, ramp

REFERENCE = MemberParameters.of()

BASE = RunConfig(mode="inprocess")
DELTA = ("solar_array.tau", *(f"wheel_{i}.speed" for i in range(1, 5)), "solar_array.omega_1", "solar_array.omega_2")

RAMPS = np.outer(ramp(64), ramp(64))


def point(index: int) -> dict[str, float]:
    return dict(zip(DELTA, map(float, members("uniform", index + 1, 4)[index])))


def row(evaluator: MemberEvaluator, index: int, depth: str = "model") -> dict[str, Any]:
    values = dict(zip(REFERENCE.columns, map(float, members("uniform", index + 1, 4)[index])))
    return evaluator.row(index, {**values, "seed": int(member_seeds(index + 1, 4)[index])}, depth)


@pytest.fixture(scope="module")
def evaluator() -> Iterator[MemberEvaluator]:
    """With frequencies for fewer members than those of a campaign."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MemberLoop, "of", partial(MemberLoop.of, settings=MemberLoopSettings(draws=20)))
        yield MemberEvaluator.of(BASE)


@pytest.fixture(scope="module")
def depth(evaluator: MemberEvaluator) -> MemberMetrics:
    return evaluator._model


@pytest.mark.parametrize("index", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_gains_and_noise_are_those_of_the_assembled_loop(evaluator: MemberEvaluator, index: int) -> None:
    found = row(evaluator, index)
    assert found["status"] == "ok"
    plant, telescope = evaluator.family.control_loop.at(point(index)), evaluator.family.telescope
    pair = evaluator.controllers["k_fsm"], evaluator.controllers["k_pma"]
    exact = sampled_loop_metrics(plant, *pair, telescope, loop="fsm+pma")
    pairs = (
        (exact.ape, "ape_gain"),
        (exact.rpe_fine, "rpe_fine_gain"),
        (exact.mirror, "mirror_gain"),
        (exact.force, "force_gain"),
    )
    for value, name in pairs:  # the grid of the periodic solution is the coarser one: its peaks are lower bounds
        assert 0.997 * value < found[name] < 1.06 * value, name
    closed = sampled_loop(plant, ControlLaws(*pair, "fsm+pma", loop_rows()))
    near = found["rpe_peak_rad_s"] * (1.0 + np.linspace(-1e-3, 1e-3, 41))
    peak = float(weighted_gains(closed, plant, telescope, near)[1].max()) / telescope.weights.rpe_limit_fine
    assert found["rpe_fine_gain"] == pytest.approx(peak, rel=5e-3)
    assert found["noise_ape_arcsec_rms"] * RAD_PER_ARCSEC == pytest.approx(exact.noise_ape, rel=1e-3)
    assert found["noise_rpe_mas_rms"] * RAD_PER_MAS == pytest.approx(exact.noise_rpe, rel=1e-3)


def test_row_adds_up(evaluator: MemberEvaluator) -> None:
    found = row(evaluator, 3)
    assert all(np.isfinite(found[name]) and found[name] > 0.0 for name in metric_names())
    worst = max(found["slow_tone_mas"], found["fast_tone_mas"])
    assert found["rpe_fine_gain"] == pytest.approx(worst / 40.0)
    noise, turn = found["noise_rpe_mas_rms"], 0.02 * found["rpe_peak_rad_s"]
    slow, fast, slow_noise = found["slow_tone_mas"], found["fast_tone_mas"], WindowNoise(noise, 0.7, RAMPS)
    assert found["total_mas"] == pytest.approx(combined_level(worst, slow_noise, 0.997, turn), rel=0.02)
    assert found["total_mas"] <= max(combined_level(slow, noise, 0.997), combined_level(fast, noise, 0.997, 1.7))
    assert row(evaluator, 3) == found


def test_responses_are_those_of_the_lft(depth: MemberMetrics) -> None:
    """By the full Delta of 48 channels, at frequencies of the grid that the member is looked at."""
    loop, values = depth.model.loop, point(5)
    W = depth.model.W(values)
    index = depth.model.looked_at(W)[::40]
    found = depth.model.at(W, index)
    delta = loop.delta(loop.point(values))
    for T, omega in zip(found, depth.model.omega[index]):
        closed = loop.at(float(omega))
        lft = closed.lft
        direct = np.linalg.solve(np.eye(len(delta)) - lft.M * delta, lft.T21)
        expected = lft.T11 + (lft.T12 * delta) @ direct
        assert np.abs(T - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.further
def test_stability_is_that_of_the_eigenvalues(evaluator: MemberEvaluator, tmp_path: Path) -> None:
    """Of a stable loop and of one with another gain of the mirror; the count of encirclements agrees at each."""
    k_fsm = SampledSystem.from_file(RunParts(BASE).model_files["k_fsm"])
    replace(k_fsm, C=-30.0 * k_fsm.C, D=-30.0 * k_fsm.D).to_file(tmp_path / "k_fsm.json")
    unstable = MemberEvaluator.of(replace(BASE, loop="fsm", k_fsm=str(tmp_path / "k_fsm.json")))
    verdicts = []
    for changed, loop in ((evaluator, BASE.loop), (unstable, "fsm")):
        found = row(changed, 0)
        pair = changed.controllers["k_fsm"], changed.controllers["k_pma"]
        plant = changed.family.control_loop.at(point(0))
        radius = sampled_loop(plant, ControlLaws(*pair, loop, loop_rows())).spectral_radius()
        model = changed._model.model
        T = model.at(model.W(point(0)), np.arange(model.omega.size))
        turns = np.unwrap(-np.angle(determinants(T[:, 2:, 22:])))
        assert (found["status"] == "ok") == (radius < 1.0) == (abs(turns[-1] - turns[0]) < np.pi)
        verdicts.append(found["status"])
        assert (found["ape_gain"] == np.inf) == (found["status"] == "unstable")
    assert verdicts == ["ok", "unstable"]


def test_a_short_run_of_an_unstable_loop_is_beyond_every_limit(tmp_path: Path) -> None:
    """A slow pole in K_PMA, 1.0005 per tick: two seconds keep every limit."""
    with_slow_pole(RunParts(BASE)).to_file(tmp_path / "k_pma.json")
    changed = MemberEvaluator.of(replace(BASE, loop="fsm+pma", k_pma=str(tmp_path / "k_pma.json"), duration=2.0))
    found = row(changed, 0, "time")
    assert found["status"] == "unstable" and found["ape_max_arcsec"] < 10.0
