"""Responses of the telescope and of the paper's continuous loop, against its modes, given angles and plain algebra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg
from support.loop_rows import COMMANDS

from lftkit import RealParameter, connect, transform
from lftkit.analysis.frequency_response import FrequencyResponse, frequency_response
from lftkit.analysis.lft_response import LftResponse, RepeatedClosed
from lftkit.arrays import FloatArray
from lftkit.tuning.responses import parameters_of
from lftkit.tuning.structures.structures import gain_matrix_of
from los_design.synthesis.pair_problem import ACTUATORS, ALONE, BOTH, OBSERVER
from los_design.synthesis.paper_problem import TUNED, PaperSamples, PaperTask, paper_limits
from los_design.synthesis.starts import random_law
from los_estimator.kalman import kalman_observer
from los_loop.angle_channels import half_turn, half_turn_slope, kept_channels
from los_loop.continuous_loop import ContinuousLoop, continuous_open_loop
from los_loop.implemented_loop import LoopMetric
from los_loop.open_loop import OpenLoop
from titop_plant.blocks.rotation import rotation
from titop_plant.interface import COMMAND_PORTS, COMMANDED, DT, FORCES, MEASURED, MIRROR, MIRROR_STAGES, PLATFORM
from titop_plant.physical_settings import ANGLE
from titop_plant.telescope.control_plant import control_plant, disturbances_of
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.weights import rpe_weight, weight_amplitudes

MANY = 40  # diagonals from which on repeated channels are closed at once


@pytest.mark.parametrize("omega", [0.3, 85.0, 580.7, 1400.0])
def test_held_commands_reach_every_output_as_through_each_mode(omega: float, open_loop: OpenLoop) -> None:
    """Modes in balanced coordinates, condition 1e3: in metres and microradians it is 1e5 to 1e9."""
    system, q = open_loop.system, len(open_loop.system.channels)
    held = open_loop.at(np.array([omega]))[0][open_loop.channels :, -COMMANDS:]
    B, C, D = system.B[:, q : q + COMMANDS], system.C[q:], system.D[q:, q : q + COMMANDS]
    modes = FrequencyResponse.of(system.A, B, C, D)
    assert modes.modal
    flow = np.exp(modes.poles * DT)
    gains = np.expm1(modes.poles * DT) / modes.poles / (np.exp(1j * omega * DT) - flow)
    exact = (modes.left * gains) @ modes.right + D
    largest = np.abs(exact).max(axis=0)  # of each command: angles and forces have other units
    assert np.all(np.abs(held - exact).max(axis=0) < 3e-11 * largest)


@pytest.fixture(scope="module")
def open_loop(system, telescope) -> OpenLoop:
    return OpenLoop(system, telescope, telescope.loop_ports.used_by())


def points(count: int) -> np.ndarray:
    """Random points, the first four at theta of -pi or pi."""
    found = np.random.default_rng(7).uniform(size=(count, 7))
    found[:4, -1] = [0.0, 1.0, 0.0, 1.0]
    return found


def test_the_entry_is_that_of_the_tangent_of_half_the_angle() -> None:
    tau = np.array([-0.9, -0.2, 0.0, 0.3, 0.7])
    t = np.tan(2.0 * np.arctan(tau))
    np.testing.assert_allclose(half_turn(tau), t / (1.0 - 1j * t), atol=1e-15)
    h = 1e-6
    slope = (half_turn(tau + h) - half_turn(tau - h)) / (2.0 * h)
    np.testing.assert_allclose(half_turn_slope(tau), slope, atol=1e-9)


@pytest.mark.parametrize("count", [6, MANY + 6])
def test_responses_to_disturbances_are_those_of_the_plant_at_the_parameters(count: int, open_loop: OpenLoop) -> None:
    """The plant that the expression of the telescope gives at numbers, without any channel: few points, and many."""
    at, system, omega = points(count), open_loop.system, np.array([0.05, 0.74, 7.4, 85.0, 399.2, 2500.0])
    found = [open_loop.closed_over(lft, at)[:, :, :-COMMANDS] for lft in open_loop.at(omega)]
    sizes = weight_amplitudes(open_loop.telescope, omega)
    for k in (0, 1, 2, 3, count - 1):
        plant = system.at(open_loop.values(at[k]))
        exact = FrequencyResponse.of(plant.A, plant.B[:, COMMANDS:], plant.C, plant.D[:, COMMANDS:]).at(omega)
        for ours, theirs, size, frequency in zip(found, exact, sizes, omega):
            for row, reference in zip(ours[k], theirs * size):
                assert np.linalg.norm(row - reference) < 1e-5 * np.linalg.norm(reference), frequency


@pytest.mark.parametrize("omega", [0.05, 0.74, 7.4, 399.2, 2500.0])
def test_responses_are_those_of_all_channels_of_the_telescope(omega: float, open_loop: OpenLoop) -> None:
    """48 channels with the differences of the parameters from their nominal values, theta as tan(theta / 4)."""
    at, system = points(MANY), open_loop.system
    q, names = len(system.channels), list(open_loop.names)
    G = FrequencyResponse.of(system.A, system.B, system.C, system.D).at([omega])[0]
    delta = (open_loop.low + at * open_loop.width - open_loop.nominal)[:, [names.index(c) for c in system.channels]]
    into = slice(q + COMMANDS, None)
    whole = LftResponse(G[:q, :q], G[q:, :q], G[:q, into], G[q:, into]).closed(delta.astype(complex))
    expected = whole * weight_amplitudes(open_loop.telescope, np.array([omega]))[0]
    found = open_loop.closed_over(open_loop.at(np.array([omega]))[0], at)[:, :, :-COMMANDS]
    for rows in (slice(0, 18), slice(18, 20), slice(20, 22), slice(22, 24)):
        size = np.linalg.norm(expected[:, rows], axis=(1, 2))
        assert np.all(np.linalg.norm((found - expected)[:, rows], axis=(1, 2)) <= 1e-9 * size)


def test_many_points_have_the_responses_of_each(open_loop: OpenLoop) -> None:
    at = points(2 * MANY)
    for omega in (0.05, 2.6, 580.0):
        lft = open_loop.at(np.array([omega]))[0]
        each = np.concatenate([open_loop.closed_over(lft, point[None]) for point in at])
        together = open_loop.closed_over(lft, at)
        for rows in (slice(0, 22), slice(22, 24)):
            size = np.linalg.norm(each[:, rows], axis=1)
            assert np.all(np.linalg.norm((together - each)[:, rows], axis=1) <= 1e-11 * size + 1e-300)


def test_channels_without_a_basis_of_eigenvectors_are_solved_point_by_point(open_loop: OpenLoop) -> None:
    rng, q = np.random.default_rng(0), open_loop.channels
    shapes = ((q, q), (2, q), (q, 3), (2, 3))
    lft = LftResponse(*(rng.normal(size=shape) + 1j * rng.normal(size=shape) for shape in shapes))
    lft.M[np.ix_(open_loop.angle, open_loop.angle)] = np.eye(16, k=1)
    assert RepeatedClosed.of(lft, open_loop.angle) is None
    delta = open_loop.delta(points(MANY))
    np.testing.assert_array_equal(lft.closed(delta, open_loop.angle), lft.closed(delta))


def test_all_channels_are_kept_where_the_nominal_angle_is_not_zero() -> None:
    for nominal, kept in ((0.0, [0, 1]), (0.2, [0, 1, 2, 3])):
        turn = rotation([0.0, 1.0, 0.0], RealParameter(ANGLE, nominal, -1.0, 1.0))
        assert kept_channels(turn).tolist() == kept


OMEGA = np.array([0.05, 0.9, 7.3, 61.0, 400.0, 1570.0])


@pytest.fixture(scope="module")
def continuous() -> OpenLoop:
    return continuous_open_loop(load_telescope())


@pytest.fixture(scope="module")
def matrices() -> tuple[FloatArray, FloatArray]:
    """Gain matrices of the Kalman observer and of a random K_PMA with which the loop is stable."""
    return gain_matrix_of(kalman_observer(load_telescope()).at({})), gain_matrix_of(random_law(2, 1.0))


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


def members(continuous: OpenLoop) -> list[dict[str, float]]:
    return [{}, *(continuous.values(p) for p in np.random.default_rng(3).uniform(size=(2, len(continuous.names))))]


@pytest.mark.parametrize("stage", MIRROR_STAGES)
def test_gains_are_those_of_the_loop_closed_by_its_equations(stage: str, continuous: OpenLoop, matrices) -> None:
    loop = ContinuousLoop(continuous, *matrices, stage, fine=True)
    assert list(loop.metrics()) == ["APE", "RPE", *(["mirror", "RPE, fine"] if stage == "fsm" else ["force"])]
    for values in members(continuous):
        expected = by_algebra(stage, values, matrices)
        for name, metric in loop.metrics().items():
            found = [loop.gains(closed, metric, loop.point(values)[None])[0] for closed in loop.at_each(OMEGA)]
            np.testing.assert_allclose(found, expected[name], rtol=1e-8)


@pytest.mark.parametrize("name", ["APE", "RPE", "force"])
def test_slopes_are_those_of_differences(name: str, continuous: OpenLoop, matrices) -> None:
    loop = ContinuousLoop(continuous, *matrices, "fsm+pma")
    metric, point, omega, h = loop.metrics()[name], np.full(len(continuous.names), 0.4), 6.1, 1e-6

    def value(w: float, at: FloatArray) -> float:
        return float(loop.gain(w, metric, at)[0])

    _, gradient, slope = loop.gain(omega, metric, point)
    steps = h * np.eye(len(continuous.names))
    expected = [(value(omega, point + step) - value(omega, point - step)) / (2 * h) for step in steps]
    np.testing.assert_allclose(gradient, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())
    after, before = (value(omega * np.exp(sign * h), point) for sign in (1.0, -1.0))
    assert slope == pytest.approx((after - before) / (2 * h), rel=1e-4)


def task_of(continuous: OpenLoop, stage: tuple[int, ...]) -> PaperTask:
    tuned = (OBSERVER,) if stage == ALONE else (ACTUATORS,)
    return PaperTask(PaperSamples(continuous), (stage,), tuned, fine=True)


@pytest.mark.further
@pytest.mark.parametrize("stage", [ALONE, BOTH])
def test_the_tuner_has_the_gains_of_the_loop(stage: tuple[int, ...], continuous: OpenLoop, matrices) -> None:
    task = task_of(continuous, stage)
    x, problem = parameters_of(task.blocks, matrices), task.problem()
    loop, values = task.loop(x, stage), problem.values(x)
    assert task.limits(stage) == paper_limits(continuous.telescope, stage, fine=True)
    for k in range(0, len(problem.samples), 97):
        closed = loop.at(float(problem.samples.omega[k]))
        for gain, found in zip(problem.gains, values[:, k]):
            metric: LoopMetric = loop.metrics()[gain.name.removesuffix(", alone")]
            value = loop.gains(closed, metric, loop.point({})[None])[0]
            value = value if metric.name != "RPE, fine" or closed.omega >= metric.band[0] else 0.0
            assert found == pytest.approx(value / (TUNED if gain.hard else 1.0), rel=1e-8)


@pytest.mark.parametrize("stage", MIRROR_STAGES)
def test_poles_are_those_of_the_connected_systems(stage: str, continuous: OpenLoop, matrices) -> None:
    loop = ContinuousLoop(continuous, *matrices, stage)
    values = members(continuous)[1]
    plant = control_plant(load_telescope()).at(values)
    command = {"los_estimate": (-10.0 * np.eye(2), COMMAND_PORTS[0])}
    law = transform(kalman_observer(load_telescope()), outputs=command)
    systems = {"plant": plant, "mirror": law, "forces": random_law(2, 1.0)}
    wires = [(f"plant.{p.name}", f"mirror.{p.name}") for p in law.inputs]
    wires.append(("mirror.fsm_command", "plant.fsm_command"))
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
    assert ContinuousLoop(continuous, unstable, matrices[1], stage).decay(values) > 0.0
