"""The one-tick matrices of the sampled loop against the runtime classes, tick by tick."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from small_loop import small_controllers, small_plant

from fsm_pma_controller.runtime import FsmPmaController
from lftkit.arrays import FloatArray
from los_estimator.runtime import LosEstimator
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop import Delays
from titop_plant.disturbances.wheel_and_drive_tones import no_tones
from titop_plant.interface import CAMERA, FSM_ANGLE
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_step import plant_step
from titop_plant.simulation.sensor_samples import SensorModel

STAGES = ("none", "isolator", "fsm", "fsm+pma")


@pytest.mark.parametrize(
    ("frame_ticks", "delays"),
    [(1, Delays()), (5, Delays()), (20, Delays()), (20, Delays(2, 0)), (20, Delays(0, 7)), (20, Delays(3, 19))],
)
@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("basis", [{"los_sensitivity": 0.125}, {}])
def test_the_matrices_step_like_plant_estimator_and_controller(
    stage: str, frame_ticks: int, delays: Delays, basis: dict
) -> None:
    """From a random state, with a constant error on every sensor in the place of noise.

    The mirror law divides by the sensitivity of the observer's file, else by that of the telescope, here 0.2. With the
    delays of a rig commands are on their way, and frames are used late, corrected by the motion of the mirror since
    (with the telescope's sensitivity): the error of the correction is that of two samples of the gauges.
    """
    data, (k_fsm, k_pma) = small_plant(), small_controllers()
    k_fsm, of_telescope = replace(k_fsm, design_basis=basis), 0.2
    rng = np.random.default_rng(0)
    error, state = 1e-3 * rng.standard_normal(22), rng.standard_normal(10)
    sensors = SensorModel(np.zeros(22), error, frame_ticks, 0.0, 0)
    plant = Plant(ConstantStep(plant_step(data, no_tones()), state, np.zeros(0)), sensors, np.full(8, 1e9))
    estimator = LosEstimator(k_fsm)
    of_law = basis.get("los_sensitivity", of_telescope)
    controller = FsmPmaController(k_pma, stage, los_sensitivity=of_law, fsm_authority=1e9, pma_authority=1e9)
    loop = sampled_loop(data, ControlLaws(k_fsm, k_pma, stage, of_telescope), frame_ticks=frame_ticks, delays=delays)
    z: FloatArray = np.zeros(len(loop.hold))
    z[:10] = state
    measured, estimate, los = np.zeros(22), np.zeros(2), np.zeros(2)
    under_way = deque(np.zeros(8) for _ in range(1 + delays.commands))
    frame: FloatArray = np.zeros(2)
    for k in range(100):
        applied = under_way.popleft()
        assert delays.commands or z[10:18] == pytest.approx(applied, rel=1e-9, abs=1e-12)
        plant.step(applied, measured, los)
        assert loop.truth @ z == pytest.approx(los, rel=1e-9, abs=1e-12)
        if delays.frames:
            if k % frame_ticks == 0:
                frame = measured[CAMERA] - of_telescope * measured[FSM_ANGLE]
            due = k >= delays.frames and k % frame_ticks == delays.frames
            measured[CAMERA] = frame + of_telescope * measured[FSM_ANGLE] if due else np.nan
        estimator.step(measured, estimate)
        command = np.zeros(8)
        controller.step(estimate, measured[:6], command)
        under_way.append(command)
        A, N = loop.at(k)
        z = A @ z + N @ error
    assert (stage == "fsm+pma") == bool(np.any(command[2:])) and (stage in STAGES[:2]) == (not np.any(command[:2]))
    assert (loop.frame_ticks, loop.plant_order) == (frame_ticks, 10)


def test_a_frame_that_is_later_than_the_next_one_is_refused() -> None:
    with pytest.raises(ValueError, match="20 of 20 ticks"):
        sampled_loop(small_plant(), ControlLaws(*small_controllers(), "fsm", 0.2), frame_ticks=20, delays=Delays(0, 20))
    with pytest.raises(ValueError, match="zero or more"):
        Delays(-1)


@pytest.mark.parametrize(("gain", "stable"), [(1.0, True), (8.0, False)])
@pytest.mark.parametrize("frame_ticks", [1, 9, 20])
def test_spectral_radius_is_the_growth_in_simulation(gain: float, stable: bool, frame_ticks: int) -> None:
    """The camera's share of the observer times 8 drives the mirror loop unstable."""
    data, (k_fsm, k_pma) = small_plant(), small_controllers()
    D = k_fsm.D.copy()
    D[:, 18:20] *= gain
    loop = sampled_loop(data, ControlLaws(replace(k_fsm, D=D), k_pma, "fsm+pma"), frame_ticks=frame_ticks)
    z, logarithms = np.random.default_rng(1).standard_normal(len(loop.hold)), []
    for _ in range(40000 // frame_ticks):
        for k in range(frame_ticks):
            z = (loop.hold if k else loop.frame) @ z
        logarithms.append(np.log(np.linalg.norm(z)))
        z /= np.linalg.norm(z)
    half = len(logarithms) // 2  # the first half is for the other motions to die out
    assert loop.spectral_radius() == pytest.approx(np.exp(np.mean(logarithms[half:]) / frame_ticks), abs=2e-4)
    if frame_ticks > 1:
        assert (loop.spectral_radius() < 1.0) is stable
