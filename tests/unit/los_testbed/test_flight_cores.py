"""Observer and controller as they fly: parity with a plain simulation, camera hold, saturation, refusals."""

import numpy as np
import pytest
from scipy.signal import dlsim
from simple_telescope import write_controllers

from fsm_pma_controller import runtime as laws
from los_estimator import runtime as observer
from lti.ports import Port
from lti.sampled_system import SampledSystem

RNG = np.random.default_rng(5)


def random_system(inputs, outputs, order):
    m, p = sum(i.size for i in inputs), sum(o.size for o in outputs)
    A = RNG.standard_normal((order, order))
    A *= 0.9 / np.max(np.abs(np.linalg.eigvals(A)))
    return SampledSystem(
        A, RNG.standard_normal((order, m)), RNG.standard_normal((p, order)), RNG.standard_normal((p, m)),
        inputs, outputs, 1e-3,
    )  # fmt: skip


def test_the_observer_is_its_system_with_the_camera_held():
    k = random_system(observer.INPUTS, observer.OUTPUTS, 4)
    y = RNG.standard_normal((200, 22))
    frames = np.arange(200) % 20 == 3  # nothing before tick 3: zero is held
    y[~frames, 18:20] = np.nan
    y[63, 19] = np.nan  # half a frame is no frame
    estimator, out = observer.LosEstimator(k), np.zeros((200, 2))
    for row, los in zip(y, out):
        estimator.step(row, los)
    held, last = y.copy(), np.zeros(2)
    for row in held:
        last = row[18:20] if np.isfinite(row[18:20]).all() else last
        row[18:20] = last
    _, expected, _ = dlsim((k.A, k.B, k.C, k.D, 1e-3), held)
    np.testing.assert_allclose(out, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert np.isnan(y[0, 18]), "the measurement is left alone"


def test_reset_forgets_state_and_camera():
    k = random_system(observer.INPUTS, observer.OUTPUTS, 4)
    estimator, first, second = observer.LosEstimator(k), np.zeros(2), np.zeros(2)
    y = RNG.standard_normal(22)
    blind = y.copy()
    blind[18:20] = np.nan
    estimator.step(blind, first)
    estimator.step(y, second)
    estimator.reset()
    estimator.step(blind, second)
    assert first.tolist() == second.tolist()


def test_the_laws_are_the_mirror_gain_and_the_force_system():
    k = random_system(laws.INPUTS, laws.OUTPUTS, 5)
    controller = laws.FsmPmaController(k, "fsm+pma", fsm_authority=1e9, pma_authority=1e9)
    los, accel = RNG.standard_normal((100, 2)), RNG.standard_normal((100, 6))
    out = np.zeros((100, 8))
    for row in zip(los, accel, out):
        controller.step(*row)
    _, force, _ = dlsim((k.A, k.B, k.C, k.D, 1e-3), accel)
    np.testing.assert_allclose(out[:, :2], -10 * los, rtol=1e-15)
    np.testing.assert_allclose(out[:, 2:], force, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("loop", "mirror", "forces"), [("none", 0, 0), ("isolator", 0, 0), ("fsm", 1, 0), ("fsm+pma", 1, 1)]
)
def test_stages_close_the_loops_they_name(loop, mirror, forces):
    k = random_system(laws.INPUTS, laws.OUTPUTS, 2)
    out = np.full(8, np.nan)
    laws.FsmPmaController(k, loop).step(np.full(2, 1e-6), np.full(6, 1e-3), out)
    assert np.all((out[:2] != 0) == bool(mirror))
    assert np.all((out[2:] != 0) == bool(forces))


def test_commands_stop_at_the_authority():
    k = SampledSystem([], [], [], 1e9 * np.eye(6), laws.INPUTS, laws.OUTPUTS, 1e-3)
    out = np.zeros(8)
    laws.FsmPmaController(k, "fsm+pma").step(np.array([1.0, -1.0]), np.array([1, -1, 1, -1, 1, -1.0]), out)
    assert out.tolist() == [-5.3e-3, 5.3e-3, 31.6, -31.6, 31.6, -31.6, 31.6, -31.6]


def test_a_system_with_other_ports_is_refused():
    wrong = SampledSystem([], [], [], np.zeros((2, 3)), (Port("u", 3),), observer.OUTPUTS, 1e-3, "thing")
    with pytest.raises(ValueError, match=r"thing: expected inputs accel_Ip\[6\], .* got u\[3\]"):
        observer.LosEstimator(wrong)
    with pytest.raises(ValueError, match=r"thing: expected inputs accel_Ip\[6\], got u\[3\]"):
        laws.FsmPmaController(wrong)


def test_another_period_is_refused():
    k = SampledSystem([], [], [], np.zeros((6, 6)), laws.INPUTS, laws.OUTPUTS, 2e-3)
    with pytest.raises(ValueError, match=r"expected a period of 0.001 s, got 0.002"):
        laws.FsmPmaController(k)


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan, np.inf])
def test_limits_are_positive(limit, tmp_path):
    k = SampledSystem.from_file(write_controllers(tmp_path)["k_pma"])
    with pytest.raises(ValueError, match="fsm_authority must be positive"):
        laws.FsmPmaController(k, "fsm", fsm_authority=limit)
    with pytest.raises(ValueError, match="loop must be one of"):
        laws.FsmPmaController(k, "pma")
