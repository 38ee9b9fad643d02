"""The closed loop as matrices and as responses, against all its signals solved at once by dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg
from small_loop import DT, small_controllers, small_plant

from los_loop.closing import closed_loop, sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.spec import held_response
from titop_plant.interface import COMMANDS, FRAME_TICKS, MEASUREMENTS, TRUTH, sample_ticks

OMEGA = np.array([0.3, 12.0, 59.0, 700.0, 2900.0])
CLOSED_STAGES = ("isolator", "fsm", "fsm+pma")


def sampled_plant(omega: float) -> np.ndarray:
    """Measurements and line of sight by held commands at the ticks: the plant's step by one matrix exponential."""
    plant, n = small_plant(), 10
    step = linalg.expm(DT * np.block([[plant.A, plant.B[:, :COMMANDS]], [np.zeros((COMMANDS, n + COMMANDS))]]))
    z = np.exp(1j * omega * DT)
    return plant.C @ np.linalg.solve(z * np.eye(n) - step[:n, :n], step[:n, n:]) + plant.D[:, :COMMANDS]


def law(stage: str, omega: float) -> np.ndarray:
    """Commands by measurements at the ticks, each controller on its own, before the delay of a tick."""
    z, (k_fsm, k_pma) = np.exp(1j * omega * DT), small_controllers()
    found = np.zeros((COMMANDS, MEASUREMENTS), complex)
    rows = {"fsm": [(k_fsm, -1.0 / 0.1, slice(0, 2), slice(0, 22))], "isolator": []}
    rows["fsm+pma"] = [*rows["fsm"], (k_pma, 1.0, slice(2, 8), slice(0, 6))]
    for K, gain, command, measured in rows[stage]:
        found[command, measured] = gain * (K.C @ np.linalg.solve(z * np.eye(K.order) - K.A, K.B) + K.D)
    return found


@pytest.mark.parametrize("stage", CLOSED_STAGES)
def test_the_matrices_have_the_response_of_all_signals_solved_at_once(stage: str) -> None:
    """From errors of the measurement to commands and line of sight, with a sample of every sensor at each tick."""
    loop = sampled_loop(small_plant(), ControlLaws(*small_controllers(), stage), frame_ticks=1)
    n = loop.plant_order
    for omega in OMEGA:
        z, P = np.exp(1j * omega * DT), sampled_plant(omega)
        K = law(stage, omega) / z
        # y - P u = n,  u - K y = 0
        equations = np.block([[np.eye(MEASUREMENTS), -P[:MEASUREMENTS]], [-K, np.eye(COMMANDS)]])
        signals = np.linalg.solve(equations, np.eye(MEASUREMENTS + COMMANDS)[:, :MEASUREMENTS])
        state = np.linalg.solve(z * np.eye(len(loop.frame)) - loop.frame, loop.noise_frame)
        command = signals[MEASUREMENTS:]
        np.testing.assert_allclose(state[n : n + COMMANDS], command, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(loop.truth @ state, P[MEASUREMENTS:] @ command, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("stage", CLOSED_STAGES)
def test_the_law_has_the_delay_of_a_tick_and_the_hold_of_slow_sensors(stage: str) -> None:
    laws = ControlLaws(*small_controllers(), stage)
    ticks = laws.held_ticks
    assert sorted(set(ticks.tolist())) == sorted({1, *sample_ticks(FRAME_TICKS).values()})
    poles, B, C, D = laws.modes()
    for omega, found in zip(OMEGA, laws.response(OMEGA)):
        z = np.exp(1j * omega * DT)
        hold = np.array([held_response(np.array([z]), int(n))[0] for n in ticks])
        np.testing.assert_allclose(found, law(stage, omega) * hold / z, rtol=1e-10, atol=1e-14)
        np.testing.assert_allclose(found, ((C / (z - poles)) @ B + D) * hold / z, rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("channels", [0, 4])
def test_the_closed_lft_solves_all_signals_of_the_loop(channels: int) -> None:
    """Of random plants and laws: equations of measurements and commands, with signals added to the commands."""
    rng, q, disturbances = np.random.default_rng(channels), channels, 5
    shape = len(OMEGA), q + MEASUREMENTS + TRUTH, q + disturbances + COMMANDS
    plant = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    K = 0.1 * (rng.standard_normal((len(OMEGA), COMMANDS, MEASUREMENTS)) + 0j)
    closed = closed_loop(plant, K, OMEGA)
    y, u = slice(q, q + MEASUREMENTS), q + disturbances
    for k, one in enumerate(closed):
        P, free = plant[k], u + COMMANDS
        equations = np.block([[np.eye(MEASUREMENTS), -P[y, u:]], [-K[k], np.eye(COMMANDS)]])
        entering = np.zeros((MEASUREMENTS + COMMANDS, free), complex)
        entering[:MEASUREMENTS, :u], entering[MEASUREMENTS:, u:] = P[y, :u], np.eye(COMMANDS)
        command = np.linalg.solve(equations, entering)[MEASUREMENTS:]
        every = P[:, u:] @ command
        every[:, :u] += P[:, :u]
        whole = np.vstack([every[:q], every[y.stop :], command])
        lft = one.lft
        found = np.block([[lft.M, lft.T21], [lft.T12, lft.T11]])
        np.testing.assert_allclose(found, whole, rtol=1e-9, atol=1e-10)
        assert one.omega == OMEGA[k]


def test_a_part_of_the_frequencies_is_the_loop_at_these() -> None:
    rng = np.random.default_rng(1)
    plant = rng.standard_normal((len(OMEGA), MEASUREMENTS + TRUTH, COMMANDS)) + 0j
    closed = closed_loop(plant, np.zeros((len(OMEGA), COMMANDS, MEASUREMENTS), complex), OMEGA)
    assert len(closed) == len(list(closed)) == len(OMEGA)
    part = closed[1:3]
    np.testing.assert_array_equal(part.omega, OMEGA[1:3])
    np.testing.assert_array_equal(part[0].lft.T11, closed[1].lft.T11)
