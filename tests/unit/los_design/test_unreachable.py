"""Limits that no controller keeps: the model of the bound is the loop that is designed, and what it says of cases."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy import linalg

from los_design.synthesis.unreachable import StageBounds, unreachable_limits
from los_loop.open_loop import OpenLoop
from titop_plant.interface import CAMERA, DT, MIRROR
from titop_plant.telescope.control_plant import loop_plant
from titop_plant.telescope.weights import rpe_weight


def open_loop_of(telescope) -> OpenLoop:
    return OpenLoop(loop_plant(telescope, telescope.loop_ports), telescope, ports=telescope.loop_ports)


@pytest.fixture(scope="module")
def open_loop(telescope) -> OpenLoop:
    return open_loop_of(telescope)


def noisy(telescope, factor: float):
    """With all sensor noise larger by a factor."""
    base = np.array([0.0012] * 3 + [0.0023] * 3)
    sensors = {"accelerometer_noise": (factor * base).tolist()}
    return telescope.changed(
        {"sensors": {**sensors, "camera_noise": 1e-8 * factor, "strain_gauge_noise": 1e-8 * factor}}
    )


@pytest.mark.further
@pytest.mark.parametrize("relative", [True, False])
def test_noises_through_a_loop_have_the_power_that_frequency_responses_give(open_loop, relative: bool) -> None:
    """Static feedback of the camera to the mirror, in the state space and on the samples that are tuned."""
    bounds = StageBounds(open_loop, "fsm", relative)
    plant, tones = bounds.plant_with_noises()
    K = np.zeros((2, open_loop.ports.measurements))
    K[:, CAMERA] = -0.05 / open_loop.telescope.fsm.los_sensitivity * np.eye(2)
    A = plant.A + plant.B @ K @ plant.M
    assert np.abs(linalg.eigvals(A)).max() < 1.0

    heard = plant.B @ K * plant.noises[-1].measurement
    P = linalg.solve_discrete_lyapunov(A, heard @ heard.T)
    by_states = np.sqrt(np.trace(plant.C @ P @ plant.C.T))

    omega = np.unique(np.concatenate([np.geomspace(1e-3, np.pi / DT, 1500), bounds.omega]))
    lft = open_loop.at(omega)
    nominal = np.array([open_loop.closed_over(one, open_loop.point({})[None])[0] for one in lft])
    control = np.zeros((len(omega), open_loop.ports.commands, open_loop.ports.measurements), complex)
    control[:, MIRROR] = K * np.exp(-1j * omega * DT)[:, None, None]
    m = open_loop.disturbances
    y, u = open_loop.ports.measurements, slice(m, None)
    sensed = np.linalg.solve(np.eye(y) - nominal[:, :y, u] @ control, np.broadcast_to(np.eye(y), (len(omega), y, y)))
    to_error = nominal[:, -2:, u] @ control @ sensed * plant.noises[-1].measurement
    weight = rpe_weight(omega, open_loop.telescope.weights.rpe_window) if relative else 1.0
    power = np.sum(np.abs(to_error) ** 2, axis=(1, 2)) * weight**2
    assert by_states == pytest.approx(np.sqrt(np.trapezoid(power, omega) * DT / np.pi), rel=0.02)

    closed = nominal[:, -2:, :m] + nominal[:, -2:, u] @ control @ sensed @ nominal[:, :y, :m]
    gains = np.linalg.norm(closed, ord=2, axis=(1, 2)) * weight / bounds.limits(omega)
    for noise, tone in zip(plant.noises[:-1], tones, strict=True):
        P = linalg.solve_discrete_lyapunov(A, noise.process @ noise.process.T)
        worst = gains[(omega > 0.05 * tone) & (omega < 20.0 * tone)].max()
        assert np.sqrt(np.trace(plant.C @ P @ plant.C.T)) <= worst


@pytest.mark.parametrize("stage", [pytest.param("fsm", marks=pytest.mark.further), "fsm+pma"])
def test_the_reference_has_no_unreachable_limit(open_loop, stage: str) -> None:
    """Its stored controllers keep them all."""
    lines: list[str] = []
    assert not unreachable_limits(open_loop, (stage,), lines.append) and not lines


@pytest.mark.further
def test_noise_that_hides_the_tones_is_named_with_what_would_do(telescope) -> None:
    lines: list[str] = []
    (found,) = unreachable_limits(open_loop_of(noisy(telescope, 200.0)), ("fsm+pma",), lines.append)
    assert lines == [str(found)] and found.names == ("slow", "noise -> RPE") and found.error == "relative error"
    assert 1.1 < found.factor < 2.0 and found.noise is not None and 0.02 < found.noise < 0.5
    advice = f"of the relative error must be at least {40 * found.factor:.3g} mas, got 40 mas, or sensor noise"
    assert advice in lines[0]


@pytest.mark.slow
def test_with_the_advised_noise_nothing_is_unreachable(telescope) -> None:
    found = StageBounds(open_loop_of(noisy(telescope, 200.0)), "fsm+pma", relative=True).conflict()
    assert found is not None and found.noise is not None
    advised = noisy(telescope, 200.0 * found.noise)
    assert StageBounds(open_loop_of(advised), "fsm+pma", relative=True).conflict() is None


@pytest.mark.further
def test_a_mirror_without_authority_does_not_reach(telescope) -> None:
    """At low frequency the mirror moves the line of sight by its sensitivity, and tones move it by more than both."""
    weak = StageBounds(open_loop_of(telescope.changed({"fsm": {"authority": 1e-5}})), "fsm", relative=False)
    found = weak.reach()
    assert found is not None and found.names == ("APE", "mirror") and found.noise is None
    strong = StageBounds(open_loop_of(telescope), "fsm", relative=False)
    assert strong.reach() is None
    moved = np.linalg.norm(strong.responses[:, :, : strong.open_loop.disturbances], ord=2, axis=(1, 2)).max()
    kept = strong.limits(np.array([found.tones[0]]))[0] + 0.1 * 0.985e-5
    assert found.factor == pytest.approx(moved / kept, rel=0.02)


def test_a_disturbance_without_amplitude_changes_nothing_else(telescope) -> None:
    """One moment of the wheels is zero at all frequencies, where the others are not."""
    without = telescope.changed({"weights": {"wheel_imbalance": [0.4, 0.4, 0.35, 0.3, 0.0]}})
    plant, tones = StageBounds(open_loop_of(without), "fsm", relative=True).plant_with_noises()
    assert len(tones) == 10 and all(np.isfinite(noise.process).all() for noise in plant.noises)
    assert np.isfinite(plant.A).all() and np.isfinite(plant.M).all()


def test_no_time_is_no_bound_and_is_said(open_loop) -> None:
    lines: list[str] = []
    assert unreachable_limits(open_loop, ("fsm",), lines.append, time.monotonic() - 1.0) == []
    assert lines == ["fsm, relative error: no bound for all controllers within the time limit"]
