"""What the rounding of the laws does to the line of sight, beside what the proofs leave (slow)."""

from __future__ import annotations

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts

from lftkit.arrays import FloatArray
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_loop.noise import periodic_covariances
from los_loop.spec import state_parts
from pointing_analysis.units import RAD_PER_MAS
from titop_plant.interface import COMMANDS, ESTIMATES, FORCE_STAGES, MEASUREMENTS, PLATFORM, TRUTH

ROUNDOFF = 2.0**-53
TICKS = 3000
MARGIN_MAS = 0.015
"""Of the fast tones with noise, proven 39.985 of 40 mas (docs/certificates.md)."""


def step_matrix(law: SampledSystem) -> FloatArray:
    return np.abs(np.block([[law.A, law.B], [law.C, law.D]]))


@pytest.mark.slow
@pytest.mark.parametrize("worst_of", ["fast", "APE"])
@pytest.mark.parametrize("stage", ["fsm", "fsm+pma"])
def test_the_rounding_of_the_laws_is_far_below_the_margin_of_the_proofs(stage: str, worst_of: str) -> None:
    """Each row of a step errs by its bound, at the largest values of a run, in every tick; errors are independent."""
    parts = RunParts(RunConfig(mode="inprocess", loop=stage, worst_of=worst_of))
    plant, estimator, controller = parts.plant(), parts.estimator(), parts.controller()
    for part in (plant, estimator, controller):
        part.reset()
    k_fsm, k_pma = estimator.k_fsm, controller.k_pma
    matrices = [step_matrix(law) for law in (k_fsm, k_pma)]
    sums = [np.zeros(len(matrix)) for matrix in matrices]
    command = np.array(parts.start.command)
    measured, los, estimate = np.zeros(MEASUREMENTS), np.zeros(TRUTH), np.zeros(ESTIMATES)
    held: FloatArray = np.zeros(MEASUREMENTS)
    for _ in range(TICKS):
        states = k_fsm.state, k_pma.state
        plant.step(command, measured, los)
        held = np.where(np.isfinite(measured), measured, held)
        estimator.step(measured, estimate)
        controller.step(estimate, measured[PLATFORM], command)
        for k, (state, u) in enumerate(zip(states, (held, measured[PLATFORM]))):
            sums[k] = np.maximum(sums[k], matrices[k] @ np.abs(np.concatenate([state, u])))
    errors = [matrix.shape[1] * ROUNDOFF * found for matrix, found in zip(matrices, sums)]
    loop = parts.tone_model().loop
    _, v, f, p, _ = state_parts(loop.plant_order, k_fsm.order, k_pma.order)
    added = np.zeros(len(loop.hold))
    added[f], added[p] = errors[0][: k_fsm.order], errors[1][: k_pma.order]
    forces = errors[1][k_pma.order :] if stage in FORCE_STAGES else np.zeros(COMMANDS - ESTIMATES)
    added[v] = np.r_[errors[0][k_fsm.order :] / float(parts.basis.los_sensitivity or 0.1), forces]
    noise = np.diag(added**2)
    found = periodic_covariances([(loop.at(k)[0], noise) for k in range(loop.frame_ticks)])
    rms = max(float(np.sqrt(np.trace(loop.truth @ covariance @ loop.truth.T))) for covariance in found)
    assert 1e-12 < rms / RAD_PER_MAS < 1e-5 * MARGIN_MAS
