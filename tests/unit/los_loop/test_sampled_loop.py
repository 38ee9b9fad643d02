"""The sampled loop's matrices: tick by tick against the runtime classes, and against all signals solved at once."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg
from small_loop import DT, small_controllers, small_plant
from support.loop_rows import COMMANDS, FRAME_TICKS, MEASUREMENTS, controller_of, estimator_of, loop_rows

from lftkit.arrays import FloatArray
from los_design.synthesis.store import load_designs
from los_loop.closing import closed_loop, sampled_loop
from los_loop.control_laws import ControlLaws
from los_loop.sampled_loop import Delays, SampledLoop
from los_loop.spec import held_response
from titop_plant.disturbances.wheel_and_drive_tones import no_tones
from titop_plant.interface import CAMERA, FSM_ANGLE, TRUTH
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_step import plant_step
from titop_plant.simulation.sensor_samples import SensorModel
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

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
    plant = Plant(ConstantStep(plant_step(data, no_tones(22)), state, np.zeros(0)), sensors, np.full(8, 1e9))
    estimator = estimator_of(k_fsm)
    of_law = basis.get("los_sensitivity", of_telescope)
    controller = controller_of(k_pma, stage, los_sensitivity=of_law, fsm_authority=1e9, pma_authority=1e9)
    loop = sampled_loop(data, ControlLaws(k_fsm, k_pma, stage, loop_rows(frame_ticks), of_telescope), delays=delays)
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
        sampled_loop(small_plant(), ControlLaws(*small_controllers(), "fsm", loop_rows(20), 0.2), delays=Delays(0, 20))
    with pytest.raises(ValueError, match="zero or more"):
        Delays(-1)


@pytest.mark.parametrize(("gain", "stable"), [(1.0, True), (8.0, False)])
@pytest.mark.parametrize("frame_ticks", [1, 9, 20])
def test_spectral_radius_is_the_growth_in_simulation(gain: float, stable: bool, frame_ticks: int) -> None:
    """The camera's share of the observer times 8 drives the mirror loop unstable."""
    data, (k_fsm, k_pma) = small_plant(), small_controllers()
    D = k_fsm.D.copy()
    D[:, 18:20] *= gain
    loop = sampled_loop(data, ControlLaws(replace(k_fsm, D=D), k_pma, "fsm+pma", loop_rows(frame_ticks)))
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
    loop = sampled_loop(small_plant(), ControlLaws(*small_controllers(), stage, loop_rows(1)))
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
    laws = ControlLaws(*small_controllers(), stage, loop_rows())
    ticks = laws.held_ticks
    assert sorted(set(ticks.tolist())) == [1, FRAME_TICKS]
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


DAMPING, HIGHEST = 0.05, 60.0


@pytest.fixture(scope="module")
def loop() -> SampledLoop:
    """Random matrices; one sensor at every tick of 6, one at 0, 2 and 4."""
    rng, n = np.random.default_rng(2), 13
    frame, hold, some = rng.standard_normal((3, n, n)) / n
    noise = rng.standard_normal((3, n, 22))
    between = dict.fromkeys((2, 4), (some, noise[2]))
    return SampledLoop(frame, hold, noise[0], noise[1], np.zeros((2, n)), 3, loop_rows(6), between)


def test_each_tick_has_the_matrices_of_the_sensors_that_are_due(loop: SampledLoop) -> None:
    expected = [loop.frame, loop.hold, loop.between[2][0], loop.hold, loop.between[4][0], loop.hold]
    for k in range(12):
        assert loop.at(k)[0] is expected[k % 6]
    made = []

    def make(A: np.ndarray, N: np.ndarray) -> tuple[float, float]:
        made.append(A)
        return float(A[0, 0]), float(N[0, 0])

    assert [entry[0] for entry in loop.each_tick(make)] == [A[0, 0] for A in expected]
    assert len(made) == 3


def test_the_period_is_the_product_of_its_ticks(loop: SampledLoop) -> None:
    product = np.eye(len(loop.hold))
    for k in range(6):
        product = loop.at(k)[0] @ product
    np.testing.assert_allclose(loop.period, product, rtol=1e-12, atol=1e-15)


def test_a_change_is_made_to_all_matrices(loop: SampledLoop) -> None:
    changed = loop.changed(lambda A: 2.0 * A, lambda N: 3.0 * N, loop.truth)
    for k in range(6):
        assert np.array_equal(changed.at(k)[0], 2.0 * loop.at(k)[0])
        assert np.array_equal(changed.at(k)[1], 3.0 * loop.at(k)[1])
    np.testing.assert_allclose(changed.period, 2.0**6 * loop.period, rtol=1e-12)


@pytest.mark.parametrize("frame_ticks", [20, 100, 250])
def test_slow_modes_of_a_long_period_are_those_of_its_parts(frame_ticks: int) -> None:
    """Loops open: modes of telescope and controllers, also where others are alike over a period."""
    plant = control_loop_plant(load_telescope()).at({})
    pair = load_designs("implemented")
    loop = sampled_loop(plant, ControlLaws(*pair, "isolator", loop_rows(frame_ticks), 0.1))
    poles = np.concatenate([linalg.eigvals(plant.A), *(np.log(linalg.eigvals(K.A)) / DT for K in pair)])
    light = (poles.imag > 0.0) & (poles.imag < HIGHEST) & (-poles.real < DAMPING * np.abs(poles))
    expected = np.sort(poles[light].imag)
    found = loop.slow_modes(loop.multipliers(), HIGHEST, DAMPING)
    assert len(expected) > 8
    assert all(np.abs(found - w).min() < 1e-5 * w for w in expected)
    if frame_ticks > 52:  # above half the frame rate the frequency is told from the states
        assert len(found) == len(expected)
