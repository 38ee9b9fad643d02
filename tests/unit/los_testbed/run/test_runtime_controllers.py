"""Observer and controller at run time: parity with a plain simulation, camera hold, saturation, refusals."""

import numpy as np
import pytest
from scipy.signal import dlsim
from simple_telescope import write_controllers

from fsm_pma_controller.runtime import FsmPmaController
from lftkit.systems.ports import Port
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator, hold_values
from titop_plant.interface import (
    CAMERA,
    COMMANDS,
    DT,
    FORCES,
    K_FSM_INPUTS,
    K_FSM_OUTPUTS,
    K_PMA_INPUTS,
    K_PMA_OUTPUTS,
    MEASUREMENTS,
    MIRROR,
)

RNG = np.random.default_rng(5)
LIMITS = {"los_sensitivity": 0.1, "fsm_authority": 4e-3, "pma_authority": 25.0}


def random_system(inputs, outputs, order):
    m, p = sum(i.size for i in inputs), sum(o.size for o in outputs)
    A = RNG.standard_normal((order, order))
    A *= 0.9 / np.max(np.abs(np.linalg.eigvals(A)))
    return SampledSystem(
        A,
        RNG.standard_normal((order, m)),
        RNG.standard_normal((p, order)),
        RNG.standard_normal((p, m)),
        inputs,
        outputs,
        DT,
    )


def test_the_observer_is_its_system_with_the_camera_held():
    k = random_system(K_FSM_INPUTS, K_FSM_OUTPUTS, 4)
    y = RNG.standard_normal((200, MEASUREMENTS))
    frames = np.arange(200) % 20 == 3  # nothing before tick 3: zero is held
    y[~frames, CAMERA] = np.nan
    y[63, 19] = np.nan  # half a frame is no frame
    estimator, out = LosEstimator(k), np.zeros((200, 2))
    for row, los in zip(y, out):
        estimator.step(row, los)
    held, last = y.copy(), np.zeros(2)
    for row in held:
        last = row[CAMERA] if np.isfinite(row[CAMERA]).all() else last
        row[CAMERA] = last
    _, expected, _ = dlsim((k.A, k.B, k.C, k.D, DT), held)
    np.testing.assert_allclose(out, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert np.isnan(y[0, 18]), "the measurement is left alone"


def test_reset_forgets_state_and_camera():
    k = random_system(K_FSM_INPUTS, K_FSM_OUTPUTS, 4)
    estimator, first, second = LosEstimator(k), np.zeros(2), np.zeros(2)
    y = RNG.standard_normal(MEASUREMENTS)
    blind = y.copy()
    blind[CAMERA] = np.nan
    estimator.step(blind, first)
    estimator.step(y, second)
    estimator.reset()
    estimator.step(blind, second)
    assert first.tolist() == second.tolist()


@pytest.mark.parametrize("sensitivity", [0.1, 0.2])
def test_the_laws_are_the_mirror_gain_and_the_force_system(sensitivity):
    k = random_system(K_PMA_INPUTS, K_PMA_OUTPUTS, 5)
    controller = FsmPmaController(k, "fsm+pma", los_sensitivity=sensitivity, fsm_authority=1e9, pma_authority=1e9)
    los, accel = RNG.standard_normal((100, 2)), RNG.standard_normal((100, 6))
    out = np.zeros((100, COMMANDS))
    for row in zip(los, accel, out):
        controller.step(*row)
    _, force, _ = dlsim((k.A, k.B, k.C, k.D, DT), accel)
    np.testing.assert_allclose(out[:, MIRROR], -los / sensitivity, rtol=1e-15)
    np.testing.assert_allclose(out[:, FORCES], force, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("loop", "mirror", "forces"), [("none", 0, 0), ("isolator", 0, 0), ("fsm", 1, 0), ("fsm+pma", 1, 1)]
)
def test_stages_close_the_loops_they_name(loop, mirror, forces):
    k = random_system(K_PMA_INPUTS, K_PMA_OUTPUTS, 2)
    out = np.full(COMMANDS, np.nan)
    FsmPmaController(k, loop, **LIMITS).step(np.full(2, 1e-6), np.full(6, 1e-3), out)
    assert np.all((out[MIRROR] != 0) == bool(mirror))
    assert np.all((out[FORCES] != 0) == bool(forces))


def test_commands_stop_at_the_authority():
    k = SampledSystem([], [], [], 1e9 * np.eye(6), K_PMA_INPUTS, K_PMA_OUTPUTS, DT)
    out = np.zeros(COMMANDS)
    FsmPmaController(k, "fsm+pma", **LIMITS).step(np.array([1.0, -1.0]), np.array([1, -1, 1, -1, 1, -1.0]), out)
    assert out.tolist() == [-4e-3, 4e-3, 25.0, -25.0, 25.0, -25.0, 25.0, -25.0]


def test_a_system_with_other_ports_is_refused():
    wrong = SampledSystem([], [], [], np.zeros((2, 3)), (Port("u", 3),), K_FSM_OUTPUTS, DT, "thing")
    with pytest.raises(ValueError, match=r"thing: inputs must be accel_Ip\[6\], .* got u\[3\]"):
        LosEstimator(wrong)
    with pytest.raises(ValueError, match=r"thing: inputs must be accel_Ip\[6\], got u\[3\]"):
        FsmPmaController(wrong, **LIMITS)


def test_another_period_is_refused():
    k = SampledSystem([], [], [], np.zeros((6, 6)), K_PMA_INPUTS, K_PMA_OUTPUTS, 2.0 * DT)
    with pytest.raises(ValueError, match=r"sampling period must be 0.001 s, got 0.002"):
        FsmPmaController(k, **LIMITS)


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_sensitivity_and_limits_are_positive(name, value, tmp_path):
    k = SampledSystem.from_file(write_controllers(tmp_path)["k_pma"])
    with pytest.raises(ValueError, match=f"{name} must be positive and finite, got"):
        FsmPmaController(k, "fsm", **{**LIMITS, name: value})


def test_a_stage_is_one_of_four(tmp_path):
    k = SampledSystem.from_file(write_controllers(tmp_path)["k_pma"])
    with pytest.raises(ValueError, match="loop must be one of none, isolator, fsm, fsm\\+pma, got 'pma'"):
        FsmPmaController(k, "pma", **LIMITS)


@pytest.mark.parametrize("stage", ["none", "isolator", "fsm", "fsm+pma"])
def test_commands_are_mirror_law_and_forces_within_the_limits(stage: str) -> None:
    """Estimates and forces on both sides of the limits."""
    law = SampledSystem([], [], [], np.eye(6), K_PMA_INPUTS, K_PMA_OUTPUTS, 1e-3)
    controller = FsmPmaController(law, stage, los_sensitivity=0.1, fsm_authority=2e-3, pma_authority=30.0)
    rng = np.random.default_rng(0)
    los, force = 4e-4 * rng.standard_normal((50, 2)), 40.0 * rng.standard_normal((50, 6))
    found = np.full((50, 8), np.nan)
    for row in range(50):
        controller.step(los[row], force[row], found[row])
    mirror = np.clip(-los / 0.1, -2e-3, 2e-3) if "fsm" in stage else np.zeros((50, 2))
    assert found[:, :2] == pytest.approx(mirror, rel=1e-15)
    assert np.array_equal(found[:, 2:], np.clip(force, -30.0, 30.0) if "pma" in stage else np.zeros((50, 6)))


def test_a_camera_value_is_held_unless_both_axes_are_finite() -> None:
    held, measurement = np.array([1.0, 2.0]), np.zeros(22)
    for frame, expected in (
        ((3.0, np.nan), [1.0, 2.0]),
        ((np.inf, 4.0), [1.0, 2.0]),
        ((np.nan, np.nan), [1.0, 2.0]),
        ((3.0, -4.0), [3.0, -4.0]),
    ):
        measurement[18:20] = frame
        hold_values(measurement, held)
        assert held.tolist() == expected
