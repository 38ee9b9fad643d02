"""The noise of a loop in time is what the matrices of the sampled loop predict."""

from __future__ import annotations

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.controllers import assemble_controller
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.closed_loop import SimulatedLoop

from lftkit import SampledSystem
from los_estimator.runtime import LosEstimator
from los_loop.sampled_loop_norms import sampled_loop_metrics
from titop_plant.disturbances.wheel_and_drive_tones import Tones, no_tones
from titop_plant.interface import MEASURED
from titop_plant.simulation.build import DISTURBANCES
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_step import plant_step
from titop_plant.simulation.sensor_samples import SensorModel
from titop_plant.telescope.assembly import assembled_telescope
from titop_plant.telescope.control_plant import with_sensors
from titop_plant.telescope.load import load_telescope

POINT = {"wheel_1.speed": 200.0, "wheel_3.speed": -300.0, "solar_array.tau": 0.3}


@pytest.fixture(scope="module")
def case():
    telescope = load_telescope()
    whole = with_sensors(assembled_telescope().system, telescope)
    data = whole.select(inputs=("fsm_command", "pma_force", *DISTURBANCES), outputs=(*MEASURED, "los_controlled")).at(
        POINT
    )
    files = RunParts(RunConfig()).model_files
    return telescope, data, SampledSystem.from_file(files["k_fsm"]), SampledSystem.from_file(files["k_pma"])


def simulate(case, tones: Tones, state: np.ndarray, ticks: int, frame_ticks: int, sigma: np.ndarray | None = None):
    _, data, k_fsm, k_pma = case
    sensors = SensorModel(np.zeros(22) if sigma is None else sigma, np.zeros(22), frame_ticks, 0.0, 3)
    limits = np.full(8, 1e6)
    plant = Plant(ConstantStep(plant_step(data, tones), state, tones.frequency), sensors, limits, "test")
    estimator, controller = (
        LosEstimator(k_fsm),
        assemble_controller({"k_fsm": k_fsm, "k_pma": k_pma}, load_telescope().design_basis, "fsm+pma"),
    )
    los: list[np.ndarray] = []
    loop = SimulatedLoop(plant, estimator, controller)
    loop.run(ticks, lambda block, rows: los.append(block.truth[:rows].copy()))
    return np.concatenate(los)


def test_noise_has_the_predicted_variance(case) -> None:
    """Sensor noise alone, frames at 50 Hz: rms over a long run against the Lyapunov equation."""
    telescope, data, k_fsm, k_pma = case
    sensors = telescope.to_mapping()["sensors"]
    sigma = np.r_[
        np.tile(sensors["accelerometer_noise"], 3), [sensors["camera_noise"]] * 2, [sensors["strain_gauge_noise"]] * 2
    ]
    los = simulate(case, no_tones(), np.zeros(len(data.A)), 60000, 20, sigma)[5000:]
    metrics = sampled_loop_metrics(data, k_fsm, k_pma, telescope, loop="fsm+pma", frame_ticks=20)
    windows = los[: len(los) // 20 * 20].reshape(-1, 20, 2)
    relative = np.sqrt(windows.var(axis=1).sum(axis=1).mean())
    assert relative == pytest.approx(metrics.noise_rpe, rel=0.25)
    assert metrics.radius < 1.0
