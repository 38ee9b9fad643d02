"""Views of a loop whose observer uses a second camera, of the page "Add a sensor"; run where this sensor exists."""

from __future__ import annotations

import numpy as np
from los_testbed.run.summary.pointing_budget_sources import testbed_sources
from support.loop_rows import FRAME_TICKS, loop_rows

from fsm_pma_controller.runtime import FsmPmaController
from lftkit import SampledSystem, state_space
from lftkit.arrays import FloatArray
from lftkit.proofs.sampled_loop.bounds import member_gains
from lftkit.support.threads import one_thread
from lftkit.tuning.responses import ResponseProblem, parameters_of
from los_design.synthesis import pair_problem
from los_design.synthesis.store import continuous, load_designs
from los_design.verification.loop_models import figures_of, telescope_model
from los_estimator.kalman import sampled_observer
from los_estimator.runtime import LosEstimator
from los_loop import sampled_loop_norms
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.implemented_loop import ImplementedLoop, loop_metrics
from los_loop.noise import noise_covariances, noise_rms
from los_loop.open_loop import OpenLoop
from los_loop.steady_state import steady_start
from los_loop.tone_model import ToneModel
from titop_plant.disturbances.wheel_and_drive_tones import Tones
from titop_plant.interface import (
    CAMERA,
    COLUMNS,
    COMMANDS,
    ESTIMATES,
    K_FSM_INPUTS,
    K_FSM_OUTPUTS,
    MEASUREMENTS,
    PLATFORM,
    DesignBasis,
)
from titop_plant.simulation.build import PlantFamily, build_plant
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_config import PlantConfig
from titop_plant.simulation.plant_step import plant_step
from titop_plant.simulation.sensor_samples import SensorModel
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.error_budget import error_budget
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.weights import weight_amplitudes

GUIDE, STAGE, TICKS, SHARE = COLUMNS.get("guide_los", slice(0, 0)), "fsm+pma", 450, 0.4
PARAMETERS = load_telescope()
SYSTEM = control_loop_plant(PARAMETERS)
STORED, K_PMA = load_designs("implemented")


def observer() -> tuple[SampledSystem, FloatArray]:
    """The stored K_FSM with 40 % of the camera's gain from the second camera, and its continuous matrices."""
    K = continuous(STORED).at({})
    B = K.B.copy()
    B[:, GUIDE], B[:, CAMERA] = SHARE * K.B[:, CAMERA], (1.0 - SHARE) * K.B[:, CAMERA]
    system = state_space(K.A, B, K.C, K.D, K_FSM_INPUTS, K_FSM_OUTPUTS)
    basis = DesignBasis.from_mapping(STORED.design_basis, "K_FSM")
    made = sampled_observer(system, PARAMETERS.washout, name="shared", basis=basis)
    return made, np.block([[K.A, B], [K.C, K.D]])


def samples() -> dict[str, object]:
    """Ticks and standard deviation of the samples of a plant without commands and disturbance."""
    plant = build_plant(PlantConfig(disturbance=False, seed=4))
    y, truth, rows = np.empty(MEASUREMENTS), np.empty(2), []
    for _ in range(30000):
        plant.step(np.zeros(COMMANDS), y, truth)
        rows.append(y[GUIDE].copy())
    values = np.array(rows)
    present = np.flatnonzero(np.isfinite(values).all(axis=1))
    return {"ticks": present[:4].tolist(), "count": len(present), "sigma": values[present].std(axis=0).tolist()}


def tones(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Frequencies [rad/s] and phasors of about unit norm."""
    omega = np.sort(np.exp(rng.uniform(np.log(0.5), np.log(900.0), 4)))
    size = weight_amplitudes(PARAMETERS, omega).T
    return omega, size * (rng.standard_normal(size.shape) + 1j * rng.standard_normal(size.shape))


def prediction(k_fsm: SampledSystem) -> dict[str, float]:
    """Largest differences: simulated run and prediction; response and settled prediction, for few ticks."""
    rng, found = np.random.default_rng(8), {}
    plant = SYSTEM.at(SYSTEM.sample_values(rng, 1)[0])
    omega, amplitude = tones(rng)
    limits = PlantFamily.of(PlantConfig(disturbance=False)).limits
    modal = ModalPlant.of(plant)
    model = ToneModel(
        sampled_loop(modal, ControlLaws(k_fsm, K_PMA, STAGE, loop_rows())), modal, omega, 1e-2 * amplitude, limits
    )
    bias = np.zeros(MEASUREMENTS)
    start = steady_start(model, bias, (k_fsm.order, K_PMA.order))
    predicted = model.record(TICKS)
    step = plant_step(plant, Tones(omega, model.amplitude, np.zeros(4), np.full(4, -1)))
    sensors = SensorModel(bias, bias, FRAME_TICKS, 0.0, 0, ((GUIDE, 100),))
    simulated = Plant(ConstantStep(step, start.plant, omega), sensors, limits)
    authority = {"fsm_authority": limits[0], "pma_authority": limits[-1]}
    sensitivity = PARAMETERS.fsm.los_sensitivity
    estimator = LosEstimator(k_fsm)
    controller = FsmPmaController(K_PMA, STAGE, los_sensitivity=sensitivity, **authority)
    estimator.start_at(start.k_fsm, start.camera)
    controller.start_at(start.k_pma)
    estimator.reset()
    controller.reset()
    los, y, estimate, u = np.empty((TICKS, 2)), np.empty(MEASUREMENTS), np.empty(ESTIMATES), start.command.copy()
    for k in range(TICKS):
        simulated.step(u, y, los[k])
        estimator.step(y, estimate)
        controller.step(estimate, y[PLATFORM], u)
    found["simulated"] = float(np.abs(los - predicted).max() / np.abs(predicted).max())
    sampled_loop_norms.SIDEBANDS = 50
    for ticks in (1, 4, FRAME_TICKS):
        loop = sampled_loop(plant, ControlLaws(k_fsm, K_PMA, STAGE, loop_rows(ticks)))
        same = sampled_loop(modal, ControlLaws(k_fsm, K_PMA, STAGE, loop_rows(ticks)))
        settled = ToneModel(same, modal, omega, amplitude, limits).settled()
        response = sampled_loop_norms.disturbance_response(loop, plant, omega)[:, :2]
        shown = np.stack([response[k] @ amplitude[:, k] for k in range(4)], axis=1)
        found[f"response, {ticks}"] = float(np.abs(shown - settled).max() / np.abs(settled).max())
    sampled_loop_norms.SIDEBANDS = 4
    return found


def gains(k_fsm: SampledSystem, matrix: FloatArray) -> dict[str, float]:
    """Largest differences of response, tuner and proof from each other, over the limits; free entries of the tuner."""
    rng = np.random.default_rng(9)
    loop, blocks = ImplementedLoop(OpenLoop(SYSTEM, PARAMETERS), k_fsm, K_PMA, STAGE), pair_problem.blocks
    both = blocks(PARAMETERS, (pair_problem.OBSERVER, pair_problem.ACTUATORS))
    law = continuous(K_PMA).at({})
    x = parameters_of(both, [matrix, np.block([[law.A, law.B], [law.C, law.D]])])
    tuner, proof = 0.0, 0.0
    for omega in (0.7, 31.0, 333.0):
        point = rng.uniform(size=7)
        samples = pair_problem.sample(loop.open, np.array([omega]), point[None])
        problem = ResponseProblem(both, samples, pair_problem.gains(PARAMETERS, (pair_problem.BOTH,)))
        tuned = dict(zip(pair_problem.limits(PARAMETERS, pair_problem.BOTH).items(), problem.values(x)[:, 0]))
        closed, deviation = loop.at(omega), loop.open.low + point * loop.open.width - loop.open.nominal
        deviation[-1] = 4.0 * np.arctan(deviation[-1])
        for (name, target), value in tuned.items():
            metric = loop_metrics(PARAMETERS, STAGE)[name]
            expected = float(loop.gains(closed, metric, point[None])[0])
            if metric.band[0] <= omega < metric.band[1]:
                tuner = max(tuner, abs(float(value) * target / metric.limit - expected))
            if metric.disturbed:
                model = telescope_model(loop, figures_of(PARAMETERS, STAGE)[name])
                proof = max(proof, abs(float(member_gains(model, omega, deviation[None])[0]) - expected))
    free = both[0].free[:, -MEASUREMENTS:][:, GUIDE]
    order = len(free) - ESTIMATES
    problem = ResponseProblem(
        both,
        samples,
        pair_problem.gains(PARAMETERS, (pair_problem.BOTH,)),
        pair_problem.noises(pair_problem.Samples(loop.open), (pair_problem.BOTH,)),
    )
    share = error_budget(PARAMETERS).total_noise
    return {
        "tuner": tuner,
        "proof": proof,
        "tuned": bool(free[:order].all()) and not free[order:].any(),
        "tuned noise": float(problem.noise(x)[1]) * share,
    }


def noise(k_fsm: SampledSystem) -> dict[str, object]:
    """Relative error by noise, of the stored observer and of this one, and the second camera's part in a budget."""
    plant, found = SYSTEM.at({}), dict[str, object]()
    louder = PARAMETERS.changed({"sensors": {"guide_noise": 3e-6}})
    for name, k, parameters in (
        ("stored", STORED, PARAMETERS),
        ("stored, louder", STORED, louder),
        ("shared", k_fsm, PARAMETERS),
        ("shared, louder", k_fsm, louder),
    ):
        found[name] = noise_rms(noise_covariances(plant, k, K_PMA, parameters, loop=STAGE))[1]
    k_fsm.to_file("shared.json")
    for name, settings in (("stored", {}), ("shared", {"k_fsm": "shared.json"})):
        sources = testbed_sources((), {"loop": STAGE, "part": "noise", "settings": settings}, 1.0)
        found[f"budget, {name}"] = {source.path[-1]: float(np.linalg.norm(source.sigma(None))) for source in sources}
    return found


def found() -> dict[str, object]:
    """All of it."""
    with one_thread():
        k_fsm, matrix = observer()
        return {
            "held": loop_rows().held.size,
            "samples": samples(),
            "prediction": prediction(k_fsm),
            "gains": gains(k_fsm, matrix),
            "noise": noise(k_fsm),
        }
