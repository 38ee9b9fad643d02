"""The continuous loop of the paper's problem against one that is closed by plain algebra, and its tuner."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from lftkit import connect, transform
from lftkit.analysis.frequency_response import frequency_response
from lftkit.arrays import FloatArray
from lftkit.tuning.responses import parameters_of
from lftkit.tuning.structures.structures import gain_matrix_of
from los_design.synthesis.pair_problem import ACTUATORS, ALONE, BOTH, OBSERVER
from los_design.synthesis.paper_problem import TUNED, PaperSamples, PaperTask, paper_limits
from los_design.synthesis.starts import random_law
from los_estimator.kalman import kalman_observer
from los_loop.continuous_loop import ContinuousLoop, continuous_open_loop
from los_loop.implemented_loop import LoopMetric
from los_loop.open_loop import OpenLoop
from titop_plant.interface import COMMAND_PORTS, COMMANDED, FORCES, MEASURED, MIRROR, MIRROR_STAGES, PLATFORM
from titop_plant.telescope.control_plant import control_plant, disturbances_of
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.weights import rpe_weight, weight_amplitudes

OMEGA = np.array([0.05, 0.9, 7.3, 61.0, 400.0, 1570.0])


@pytest.fixture(scope="module")
def open_loop() -> OpenLoop:
    return continuous_open_loop(load_telescope())


@pytest.fixture(scope="module")
def matrices() -> tuple[FloatArray, FloatArray]:
    """Gain matrices of the Kalman observer and of a random K_PMA with which the loop is stable."""
    return (
        gain_matrix_of(kalman_observer(load_telescope()).at({})),
        gain_matrix_of(random_law(2, 1.0)),
    )


def by_algebra(stage: str, values: dict[str, float], matrices: tuple[FloatArray, FloatArray]) -> dict[str, FloatArray]:
    """Gains at OMEGA of the loop closed by its equations: the plant's transfer matrices and the controllers'."""
    telescope = load_telescope()
    plant = control_plant(telescope)
    inputs, outputs = (*disturbances_of(plant), *COMMANDED), (*MEASURED, "los_controlled")
    G = frequency_response(plant[outputs, inputs].at(values), OMEGA)
    found: dict[str, list[float]] = {"APE": [], "RPE": [], "RPE, fine": [], "mirror": [], "force": []}
    weights = telescope.weights
    for w, g in zip(OMEGA, G):
        K = np.zeros((8, 22), complex)
        for rows, columns, M, gain in (
            (MIRROR, slice(0, 22), matrices[0], -1.0 / telescope.fsm.los_sensitivity),
            (FORCES, PLATFORM, matrices[1], float(stage == "fsm+pma")),
        ):
            A, B, C, D = M[:4, :4], M[:4, 4:], M[4:, :4], M[4:, 4:]
            K[rows, columns] = gain * (D + C @ linalg.solve(1j * w * np.eye(4) - A, B))
        size = weight_amplitudes(telescope, np.array([w]))[0]
        Gw, Gu = g[:, :-8] * size, g[:, -8:]
        u = linalg.solve(np.eye(8) - K @ Gu[:22], K @ Gw[:22])
        los = Gw[22:] + Gu[22:] @ u
        rpe = weights.rpe_limit if stage == "fsm" else weights.rpe_limit_fine
        error = float(linalg.svdvals(los)[0])
        found["APE"].append(error / weights.ape_limit)
        relative = error * float(rpe_weight(np.array([w]), weights.rpe_window)[0])
        found["RPE"].append(relative / rpe)
        found["RPE, fine"].append(relative / weights.rpe_limit_fine)
        found["mirror"].append(float(linalg.svdvals(u[MIRROR])[0]) / telescope.fsm.authority)
        found["force"].append(float(linalg.svdvals(u[FORCES])[0]) / telescope.pma.authority)
    return {name: np.array(column) for name, column in found.items()}


def members(open_loop: OpenLoop) -> list[dict[str, float]]:
    return [{}, *(open_loop.values(p) for p in np.random.default_rng(3).uniform(size=(2, len(open_loop.names))))]


@pytest.mark.parametrize("stage", MIRROR_STAGES)
def test_gains_are_those_of_the_loop_closed_by_its_equations(stage: str, open_loop: OpenLoop, matrices) -> None:
    loop = ContinuousLoop(open_loop, *matrices, stage, fine=True)
    assert list(loop.metrics()) == (
        ["APE", "RPE", "mirror", "RPE, fine"] if stage == "fsm" else ["APE", "RPE", "force"]
    )
    for values in members(open_loop):
        expected = by_algebra(stage, values, matrices)
        for name, metric in loop.metrics().items():
            found = [loop.gains(closed, metric, loop.point(values)[None])[0] for closed in loop.at_each(OMEGA)]
            np.testing.assert_allclose(found, expected[name], rtol=1e-8)


@pytest.mark.parametrize("name", ["APE", "RPE", "force"])
def test_slopes_are_those_of_differences(name: str, open_loop: OpenLoop, matrices) -> None:
    loop = ContinuousLoop(open_loop, *matrices, "fsm+pma")
    metric, point, omega, h = loop.metrics()[name], np.full(len(open_loop.names), 0.4), 6.1, 1e-6

    def value(w: float, at: FloatArray) -> float:
        return float(loop.gain(w, metric, at)[0])

    _, gradient, slope = loop.gain(omega, metric, point)
    expected = [
        (value(omega, point + h * e) - value(omega, point - h * e)) / (2 * h) for e in np.eye(len(open_loop.names))
    ]
    np.testing.assert_allclose(gradient, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())
    assert slope == pytest.approx(
        (value(omega * np.exp(h), point) - value(omega * np.exp(-h), point)) / (2 * h), rel=1e-4
    )


def task_of(open_loop: OpenLoop, stage: tuple[int, ...]) -> PaperTask:
    tuned = (OBSERVER,) if stage == ALONE else (ACTUATORS,)
    return PaperTask(PaperSamples(open_loop), (stage,), tuned, fine=True)


@pytest.mark.further
@pytest.mark.parametrize("stage", [ALONE, BOTH])
def test_the_tuner_has_the_gains_of_the_loop(stage: tuple[int, ...], open_loop: OpenLoop, matrices) -> None:
    task = task_of(open_loop, stage)
    x, problem = parameters_of(task.blocks, matrices), task.problem()
    loop, values = task.loop(x, stage), problem.values(x)
    assert task.limits(stage) == paper_limits(open_loop.telescope, stage, fine=True)
    for k in range(0, len(problem.samples), 97):
        closed = loop.at(float(problem.samples.omega[k]))
        for gain, found in zip(problem.gains, values[:, k]):
            metric: LoopMetric = loop.metrics()[gain.name.removesuffix(", alone")]
            value = loop.gains(closed, metric, loop.point({})[None])[0]
            value = value if metric.name != "RPE, fine" or closed.omega >= metric.band[0] else 0.0
            assert found == pytest.approx(value / (TUNED if gain.hard else 1.0), rel=1e-8)


@pytest.mark.parametrize("stage", MIRROR_STAGES)
def test_poles_are_those_of_the_connected_systems(stage: str, open_loop: OpenLoop, matrices) -> None:
    loop = ContinuousLoop(open_loop, *matrices, stage)
    values = members(open_loop)[1]
    plant = control_plant(load_telescope()).at(values)
    law = transform(
        kalman_observer(load_telescope()),
        outputs={"los_estimate": (-10.0 * np.eye(2), COMMAND_PORTS[0])},
    )
    systems = {"plant": plant, "mirror": law, "forces": random_law(2, 1.0)}
    wires = [(f"plant.{p.name}", f"mirror.{p.name}") for p in law.inputs] + [
        ("mirror.fsm_command", "plant.fsm_command")
    ]
    if stage == "fsm+pma":
        wires += [("plant.accel_Ip", "forces.accel_Ip"), ("forces.pma_force", "plant.pma_force")]
    else:
        del systems["forces"]
    driven = {target for _, target in wires}
    free = [p for p in plant.inputs if f"plant.{p.name}" not in driven]
    wires += [(p.name, f"plant.{p.name}") for p in free]
    closed = connect(systems, wires, inputs=free, outputs={"los_controlled": "plant.los_controlled"})
    assert loop.decay(values) == pytest.approx(float(linalg.eigvals(closed.A).real.max()), rel=1e-4)
    assert loop.decay(values) < 0.0
    unstable = np.array(matrices[0])
    unstable[0, 0] = 5.0
    assert ContinuousLoop(open_loop, unstable, matrices[1], stage).decay(values) > 0.0
