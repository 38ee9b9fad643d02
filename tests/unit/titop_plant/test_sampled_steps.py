"""The simulation step and the tones on small numbers, against their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from titop_plant.interface import CAMERA, DT
from titop_plant.simulation.disturbances import Tones, joined, no_tones
from titop_plant.simulation.sampled_plant import SampledPlant, Segment, SensorModel

N, K = 3, 2


def segment(seed: int, ticks: int) -> Segment:
    rng = np.random.default_rng(seed)
    step = rng.standard_normal((N + 24, N + 8 + 2 * K))
    step[:N, :N] = np.diag([0.9, 0.5, -0.3])
    return Segment(ticks, step, np.exp(1j * rng.uniform(0.1, 2.0, K)))


SENSORS = SensorModel(np.linspace(0.1, 2.3, 22), np.linspace(-1.0, 1.0, 22), 4, 0.3, 11)
LIMITS = np.linspace(0.5, 1.2, 8)


def plant(*segments: Segment, sensors: SensorModel = SENSORS) -> SampledPlant:
    state = np.array([1.0, -2.0, 0.5])
    return SampledPlant(segments, state, sensors, LIMITS, dt=DT, tones=np.array([1.0, 2.0]), parameters_hash="name")


def expected(segments: list[Segment], commands: np.ndarray, sensors: SensorModel):
    """The recursion of the module's documentation, with its own noise and frames drawn beforehand."""
    noise, camera = (np.random.default_rng(s) for s in np.random.SeedSequence(sensors.seed).spawn(2))
    blocks = [noise.standard_normal((64, 22)) for _ in range(len(commands) // 64 + 1)]
    draws = np.vstack(blocks) * sensors.sigma
    x, p = np.array([1.0, -2.0, 0.5]), np.ones(K, complex)
    of_tick = [s for s in segments for _ in range(s.ticks)]
    measured, truth = [], []
    for k, command in enumerate(commands):
        current = of_tick[min(k, len(of_tick) - 1)]
        phasors = np.column_stack([p.real, p.imag]).ravel()
        out = current.step @ np.concatenate([x, np.minimum(np.maximum(command, -LIMITS), LIMITS), phasors])
        y = out[N : N + 22] + draws[k] + sensors.bias
        lost = k % sensors.frame_ticks == 0 and sensors.dropout > 0 and camera.random(3)[0] < sensors.dropout
        if k % sensors.frame_ticks or lost:
            y[CAMERA] = np.nan
        measured.append(y)
        truth.append(out[N + 22 :])
        x, p = out[:N], p * current.turn
    return np.array(measured), np.array(truth), x


@pytest.mark.parametrize("dropout", [0.0, 0.3, 1.0])
def test_a_run_is_the_recursion_of_its_segments(dropout: float) -> None:
    """Three segments, more than two blocks of noise, commands beyond their limits on either side, lost frames."""
    sensors = SensorModel(SENSORS.sigma, SENSORS.bias, 4, dropout, 11)
    segments = [segment(0, 7), segment(1, 5), segment(2, 3)]
    commands = 2.0 * np.random.default_rng(3).standard_normal((150, 8))
    model = plant(*segments, sensors=sensors)
    measured, truth = np.zeros((150, 22)), np.zeros((150, 2))
    for _ in range(2):
        model.reset()
        assert (model.tick, model.state.tolist()) == (0, [1.0, -2.0, 0.5])
        for k in range(150):
            assert model.tick == k
            model.step(commands[k], measured[k], truth[k])
        y, t, x = expected(segments, commands, sensors)
        np.testing.assert_allclose(measured, y, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(truth, t, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(model.state, x, rtol=1e-12)
    frames = np.isfinite(measured[:, 18])
    assert np.isfinite(np.delete(measured, [18, 19], axis=1)).all()
    assert frames.sum() == {0.0: 38, 1.0: 0}.get(dropout, frames.sum())
    assert np.all(np.flatnonzero(frames) % 4 == 0)


def test_the_state_is_a_copy_and_the_settings_are_kept() -> None:
    model = plant(segment(0, 10))
    model.state[:] = 9.0
    assert model.state.tolist() == [1.0, -2.0, 0.5]
    assert (model.dt, model.frame_ticks, model.parameters_hash) == (DT, 4, "name")
    assert model.tones.tolist() == [1.0, 2.0] and model.limits is LIMITS


def tones() -> Tones:
    """Two tones of wheel 1, one of wheel 3 (which turns backwards), one of fixed frequency."""
    amplitude = (np.arange(88.0).reshape(22, 4) + 1.0) * np.exp(0.3j)
    return Tones(
        np.array([200.0, 500.0, 150.0, 7.0]), amplitude, np.array([1.0, 2.5, 1.0, 0.0]), np.array([1, 1, 3, -1])
    )


def test_tones_of_a_wheel_follow_its_speed_with_the_square() -> None:
    before = tones()
    reference, speed = np.array([0.0, 200.0, 0.0, -150.0]), np.array([50.0, 600.0, 0.0, 75.0])
    after = before.at_speed(speed, reference)
    assert after.frequency.tolist() == [600.0, 1500.0, 75.0, 7.0]
    np.testing.assert_allclose(after.amplitude, before.amplitude * np.array([9.0, 9.0, 0.25, 1.0]), rtol=1e-14)
    assert (after.harmonic.tolist(), after.wheel.tolist()) == (before.harmonic.tolist(), before.wheel.tolist())
    same = before.at_speed(reference, reference)
    np.testing.assert_array_equal(same.amplitude, before.amplitude)
    stopped = before.at_speed(np.zeros(4), reference)
    assert stopped.frequency.tolist() == [0.0, 0.0, 0.0, 7.0]
    assert not stopped.amplitude[:, :3].any() and np.array_equal(stopped.amplitude[:, 3], before.amplitude[:, 3])


def test_tones_of_every_wheel_follow_their_own_wheel() -> None:
    """One tone for each wheel and two of fixed frequency; wheel 2 is at rest at first and makes no tone then."""
    wheel = np.array([0, 1, 2, 3, -1, -1])
    amplitude = np.ones((22, 6), complex) * np.array([1.0, 2.0j, 0.0, 3.0, 4.0, 5.0])
    harmonic = np.array([1.0, 2.0, 3.0, 0.5, 0.0, 0.0])
    before = Tones(np.array([10.0, 40.0, 0.0, 20.0, 7.0, 9.0]), amplitude, harmonic, wheel)
    reference, speed = np.array([10.0, 20.0, 0.0, -40.0]), np.array([30.0, -10.0, 5.0, 80.0])
    with np.errstate(all="raise"):
        after = before.at_speed(speed, reference)
    assert after.frequency.tolist() == [30.0, 20.0, 15.0, 40.0, 7.0, 9.0]
    np.testing.assert_allclose(after.amplitude[0], [9.0, 0.5j, 0.0, 12.0, 4.0, 5.0], rtol=1e-14)
    np.testing.assert_array_equal(after.wheel, wheel)


def test_joined_sets_keep_their_tones_in_order() -> None:
    whole = joined([tones(), no_tones(), tones().at_speed(np.zeros(4), np.ones(4))])
    assert whole.frequency.tolist() == [200.0, 500.0, 150.0, 7.0, 0.0, 0.0, 0.0, 7.0]
    assert whole.amplitude.shape == (22, 8) and whole.wheel.tolist() == [1, 1, 3, -1] * 2
