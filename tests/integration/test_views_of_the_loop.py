"""The views of one loop agree: simulation, sampled matrices, prediction, response, proof model, tuner.

At random members of the telescope, both stages. Gains are compared over their limits, records over the limit of
the relative error or their own largest value.
What differs on purpose is made equal, so that all the rest must be:

* The response, the proof model and the tuner leave out sidebands of the camera's frame rate: compared with the sampled
  matrices they have a frame at every tick. Simulation, matrices and prediction have 50 frames per second.
* They bring images of held commands through the nominal telescope: compared with the sampled matrices the member is the
  nominal telescope (:func:`centred`), compared with each other it is not.

The prediction's steady state is solved from matrices of a tick, in which a tone of 0.05 rad/s turns by 5e-5: it has
fewer digits than its record from a given start, which is compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg
from support.loop_rows import COMMANDS, FRAME_TICKS, controller_of, estimator_of, loop_rows

from lftkit import SampledSystem, System
from lftkit.arrays import FloatArray
from lftkit.proofs.sampled_loop.bounds import member_gains
from lftkit.tuning.responses import ResponseProblem, parameters_of
from los_design.synthesis import pair_problem
from los_design.synthesis.store import continuous, load_designs
from los_design.verification.loop_models import figures_of, telescope_model
from los_loop import implemented_loop
from los_loop.closing import sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.figures_of_merit import figure
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from los_loop.sampled_loop_norms import weighted_gains
from los_loop.steady_state import steady_start
from los_loop.tone_model import ToneModel
from titop_plant.disturbances.wheel_and_drive_tones import Tones
from titop_plant.interface import MIRROR_STAGES, PLATFORM
from titop_plant.simulation.build import PlantFamily
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_config import PlantConfig
from titop_plant.simulation.plant_step import plant_step
from titop_plant.simulation.sensor_samples import SensorModel
from titop_plant.telescope.weights import weight_amplitudes

SAME = 1e-10
TICKS = 200
FEW, MANY = (0, 1, 16), 100
"""Points that always run: 16 is the one at which images of held commands matter most."""
POINTS = [pytest.param(seed, marks=[] if seed in FEW else [pytest.mark.slow]) for seed in range(MANY)]
Pair = tuple[SampledSystem, SampledSystem]


@pytest.fixture(scope="module")
def pair() -> Pair:
    return load_designs("implemented")


def centred(system: System, values: Mapping[str, float]) -> System:
    """The same family with a member as its nominal telescope: Delta = d + Delta', d closed."""
    q, n = len(system.channels), system.order
    nominal = {p.name: p.nominal for p in system.parameters}
    d = np.array([values[name] - nominal[name] for name in system.channels])
    seen = linalg.solve(np.eye(q) - system.D[:q, :q] * d, np.hstack([system.C[:q], system.D[:q]]))
    driven = np.vstack([system.B[:, :q], system.D[:, :q]]) * d
    whole = np.block([[system.A, system.B], [system.C, system.D]]) + driven @ seen
    telescope = tuple(replace(p, nominal=float(values[p.name])) for p in system.parameters)
    matrices = whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]
    return System(*matrices, system.inputs, system.outputs, channels=system.channels, elements=telescope)


def tones(rng: np.random.Generator, telescope) -> tuple[np.ndarray, np.ndarray]:
    """Four frequencies between 0.05 and 1400 rad/s, and phasors of about unit norm."""
    omega = np.sort(np.exp(rng.uniform(np.log(0.05), np.log(1400.0), 4)))
    size = weight_amplitudes(telescope, omega).T
    return omega, size * (rng.standard_normal(size.shape) + 1j * rng.standard_normal(size.shape))


def test_a_member_as_nominal_telescope_is_the_member(system) -> None:
    values, other = system.sample_values(np.random.default_rng(0), 2)
    own = centred(system, values)
    for at in (values, other):
        for found, expected in zip(own.at(at).matrices, system.at(at).matrices):
            assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("seed", POINTS)
@pytest.mark.parametrize("stage", MIRROR_STAGES)
def test_simulation_matrices_and_prediction_are_one_loop(stage: str, seed: int, system, telescope, pair: Pair) -> None:
    """Runtime classes and plant, powers of the matrices, and the prediction's record: from its start, with bias."""
    rng = np.random.default_rng([seed, MIRROR_STAGES.index(stage)])
    plant = system.at(system.sample_values(rng, 1)[0])
    (omega, amplitude), bias = tones(rng, telescope), 1e-5 * rng.standard_normal(22)
    limits = PlantFamily.of(PlantConfig(disturbance=False)).ports.limits
    modal = ModalPlant.of(plant, COMMANDS)
    loop = sampled_loop(modal, ControlLaws(*pair, stage, loop_rows()))
    model = ToneModel(loop, modal, omega, 1e-2 * amplitude, limits)
    start = steady_start(model, np.zeros(22), (pair[0].order, pair[1].order))
    predicted = model.record(TICKS)
    found = {}
    for name, error in (("quiet", np.zeros(22)), ("biased", bias)):
        disturbance = Tones(omega, model.amplitude, np.zeros(4), np.full(4, -1))
        dynamics = ConstantStep(plant_step(plant, disturbance), start.plant, omega)
        simulated = Plant(dynamics, SensorModel(np.zeros(22), error, FRAME_TICKS, 0.0, 0), limits)
        found[name] = run(simulated, start, stage, pair, limits)
    allowed = SAME * max(figure("RPE").limit(telescope, stage), float(np.abs(predicted).max()))
    assert np.abs(found["quiet"] - predicted).max() < allowed
    by_bias = np.empty((TICKS, 2))
    state: FloatArray = np.zeros(len(loop.hold))
    for k in range(TICKS):
        by_bias[k] = loop.truth @ state
        A, N = (loop.hold, loop.noise_hold) if k % FRAME_TICKS else (loop.frame, loop.noise_frame)
        state = A @ state + N @ bias
    assert np.abs(by_bias).max() > 1e3 * allowed
    assert np.abs(found["biased"] - predicted - by_bias).max() < allowed


def run(plant: Plant, start, stage: str, pair: Pair, limits: np.ndarray) -> np.ndarray:
    """Line of sight (TICKS, 2) with the classes that run."""
    authority = {"fsm_authority": limits[0], "pma_authority": limits[-1]}
    estimator, controller = (
        estimator_of(pair[0]),
        controller_of(pair[1], stage, los_sensitivity=pair[0].design_basis["los_sensitivity"], **authority),
    )
    estimator.start_at(start.k_fsm, start.camera)
    controller.start_at(start.k_pma)
    estimator.reset()
    controller.reset()
    los, measured, estimate, command = np.empty((TICKS, 2)), np.empty(22), np.empty(2), start.command.copy()
    for k in range(TICKS):
        plant.step(command, measured, los[k])
        assert np.all(np.abs(command) < limits)
        estimator.step(measured, estimate)
        controller.step(estimate, measured[PLATFORM], command)
    return los


@pytest.mark.parametrize("seed", POINTS)
@pytest.mark.parametrize("stage", MIRROR_STAGES)
def test_matrices_response_proof_and_tuner_have_the_same_gains(
    stage: str, seed: int, system, telescope, pair: Pair
) -> None:
    rng = np.random.default_rng([seed, MIRROR_STAGES.index(stage)])
    omega = float(np.exp(rng.uniform(np.log(0.05), np.log(1400.0))))
    member, point = system.sample_values(rng, 1)[0], rng.uniform(size=7)
    loop = ImplementedLoop(OpenLoop(system, telescope, telescope.loop_ports.used_by()), *pair, stage)
    closed, tuned = loop.at(omega), by_tuner(loop, omega, point, pair)
    deviation = loop.open.low + point * loop.open.width - loop.open.nominal
    deviation[-1] = 4.0 * np.arctan(deviation[-1])
    for name, metric in implemented_loop.loop_metrics(telescope, stage, telescope.loop_ports.used_by()).items():
        expected = float(loop.gains(closed, metric, point[None])[0])
        if metric.band[0] <= omega < metric.band[1]:
            assert tuned[name] == pytest.approx(expected, abs=SAME), name
        if metric.disturbed:
            model = telescope_model(loop, figures_of(telescope, stage, telescope.loop_ports.used_by())[name])
            assert float(member_gains(model, omega, deviation[None])[0]) == pytest.approx(expected, abs=SAME), name
    telescope = telescope.changed({"sensors": {"camera_rate": 1000.0}})  # without sidebands of frames
    loop = ImplementedLoop(OpenLoop(centred(system, member), telescope, telescope.loop_ports.used_by()), *pair, stage)
    plant = loop.system.at({})
    matrices = sampled_loop(plant, loop.control_laws)
    response, relative = weighted_gains(matrices, plant, telescope, np.array([omega]))
    for name, metric in implemented_loop.loop_metrics(telescope, stage, telescope.loop_ports.used_by()).items():
        if metric.disturbed:
            gain = relative[0] if metric.relative else linalg.svdvals(response[0, metric.rows])[0]
            found = float(loop.gains(loop.at(omega), metric, loop.point({})[None])[0])
            assert found == pytest.approx(float(gain) / metric.limit, abs=SAME), name


def by_tuner(loop: ImplementedLoop, omega: float, point: np.ndarray, pair: Pair) -> dict[str, float]:
    """Gains over their limits (not over what is tuned for), zero outside of their bands."""
    both = pair_problem.blocks(loop.telescope, (pair_problem.OBSERVER, pair_problem.ACTUATORS))
    matrices = [np.block([[K.A, K.B], [K.C, K.D]]) for K in (continuous(system).at({}) for system in pair)]
    stage = next(stage for stage, name in pair_problem.STAGE_NAMES.items() if name == loop.stage)
    samples = pair_problem.sample(loop.open, np.array([omega]), point[None])
    problem = ResponseProblem(both, samples, pair_problem.gains(loop.telescope, (stage,)))
    targets = pair_problem.limits(loop.telescope, stage)
    limits = {
        name: metric.limit
        for name, metric in implemented_loop.loop_metrics(loop.telescope, loop.stage, loop.ports).items()
    }
    values = problem.values(parameters_of(both, matrices))[:, 0]
    return {name: float(v) * targets[name] / limits[name] for name, v in zip(targets, values)}
