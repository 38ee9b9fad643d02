"""Observer and controller at run time: parity with a plain simulation, camera hold, saturation, refusals."""

import numpy as np
import pytest
from scipy.signal import dlsim
from simple_telescope import write_controllers
from support.loop_rows import MEASUREMENTS, controller_of, estimator_of

from lftkit.systems.ports import Port
from lftkit.systems.sampled.sampled_system import SampledSystem
from titop_plant.interface import CAMERA, DT, K_FSM_INPUTS, K_FSM_OUTPUTS, K_PMA_INPUTS, K_PMA_OUTPUTS

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
    estimator, out = estimator_of(k), np.zeros((200, 2))
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
    estimator, first, second = estimator_of(k), np.zeros(2), np.zeros(2)
    y = RNG.standard_normal(MEASUREMENTS)
    blind = y.copy()
    blind[CAMERA] = np.nan
    estimator.step(blind, first)
    estimator.step(y, second)
    estimator.reset()
    estimator.step(blind, second)
    assert first.tolist() == second.tolist()


def test_a_system_with_other_ports_is_refused():
    wrong = SampledSystem([], [], [], np.zeros((2, 3)), (Port("u", 3),), K_FSM_OUTPUTS, DT, "thing")
    with pytest.raises(ValueError, match=r"thing: inputs must be accel_Ip\[6\], .* got u\[3\]"):
        estimator_of(wrong)
    with pytest.raises(ValueError, match=r"thing: inputs must be accel_Ip\[6\], got u\[3\]"):
        controller_of(wrong, **LIMITS)


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize("value", [0.0, np.nan])
def test_sensitivity_and_limits_are_positive(name, value, tmp_path):
    k = SampledSystem.from_file(write_controllers(tmp_path)["k_pma"])
    with pytest.raises(ValueError, match=f"{name} must be positive and finite, got"):
        controller_of(k, "fsm", **{**LIMITS, name: value})


@pytest.mark.parametrize("stage", ["none", "isolator", "fsm", "fsm+pma"])
def test_commands_are_mirror_law_and_forces_within_the_limits(stage: str) -> None:
    """Estimates and forces on both sides of the limits."""
    law = SampledSystem([], [], [], np.eye(6), K_PMA_INPUTS, K_PMA_OUTPUTS, 1e-3)
    controller = controller_of(law, stage, los_sensitivity=0.1, fsm_authority=2e-3, pma_authority=30.0)
    rng = np.random.default_rng(0)
    los, force = 4e-4 * rng.standard_normal((50, 2)), 40.0 * rng.standard_normal((50, 6))
    found = np.full((50, 8), np.nan)
    for row in range(50):
        controller.step(los[row], force[row], found[row])
    mirror = np.clip(-los / 0.1, -2e-3, 2e-3) if "fsm" in stage else np.zeros((50, 2))
    assert found[:, :2] == pytest.approx(mirror, rel=1e-15)
    assert np.array_equal(found[:, 2:], np.clip(force, -30.0, 30.0) if "pma" in stage else np.zeros((50, 6)))


def test_an_observer_of_some_sensors_needs_no_units() -> None:
    """A .mat file or a system of python-control states none; inputs that are left out have no effect."""
    observer = SampledSystem([], [], [], np.eye(2), (Port("camera_los", 2),), (Port("los_estimate", 2),), 1e-3)
    estimator, out = estimator_of(observer), np.full(2, np.nan)
    estimator.step(np.arange(22.0), out)
    assert out.tolist() == np.arange(22.0)[CAMERA].tolist()
