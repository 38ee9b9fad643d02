"""What the camera's frames do to stability: both gains of the argument, and the periodic loop itself."""

from __future__ import annotations

import numpy as np
import pytest

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.sampled_loop import LoopModel
from los_design.synthesis.store import load_designs
from los_design.verification.frames import IMAGES, LIMITS, SEEN, frames_share
from los_design.verification.loop_models import box_of, frames_of, telescope_model
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.interface import DT, FRAME_TICKS


@pytest.fixture(scope="module", params=["fsm", "fsm+pma"])
def loop(request: pytest.FixtureRequest, system, telescope) -> ImplementedLoop:
    return ImplementedLoop(OpenLoop(system, telescope), *load_designs("implemented"), request.param)


def member(model: LoopModel, omega: float, deviations: FloatArray) -> ComplexArray:
    """Response of a member: Delta closed."""
    q = model.sizes[0]
    z, e = model.at(omega)
    delta = np.zeros(q)
    for k, (group, angle) in enumerate(zip(model.groups, model.angle)):
        delta[list(group)] = np.tan(0.5 * deviations[k]) if angle else deviations[k]
    return e[:, q:] + (e[:, :q] * delta) @ np.linalg.solve(np.eye(q) - z[:, :q] * delta, z[:, q:])


def members(loop: ImplementedLoop, count: int) -> FloatArray:
    low, high = np.array(box_of(loop)).T
    rng = np.random.default_rng(5)
    inside = rng.uniform(size=(count, len(low)))
    return low + np.where(rng.uniform(size=inside.shape) < 0.6, np.round(inside), inside) * (high - low)


def test_the_closed_gain_is_the_sensitivity_of_the_opened_one(loop: ImplementedLoop) -> None:
    """``S = (I - L)^-1`` at members, though the one has the camera's loop closed and the other one open."""
    metrics = frames_of(loop.telescope, loop.stage)
    closed, opened = (telescope_model(loop, metrics[name]) for name in (SEEN, IMAGES))
    for deviations in members(loop, 4):
        for omega in (0.05, 3.0, 8.0, 60.0, 157.0):
            S, L = member(closed, omega, deviations), member(opened, omega, deviations)
            np.testing.assert_allclose(S @ (np.eye(2) - L), np.eye(2), atol=1e-7 * np.linalg.norm(S))


def test_found_members_keep_both_limits_and_their_periodic_loop_is_stable(loop: ImplementedLoop) -> None:
    found = dict.fromkeys(LIMITS, 0.0)
    drawn = members(loop, 3)
    for name, metric in frames_of(loop.telescope, loop.stage).items():
        model = telescope_model(loop, metric)
        for omega in np.geomspace(max(metric.band[0], 5.0), metric.band[1], 40):
            found[name] = max(found[name], *(float(np.linalg.norm(member(model, omega, one), 2)) for one in drawn))
    assert 1.5 < found[SEEN] < LIMITS[SEEN] and 5e-5 < found[IMAGES] < LIMITS[IMAGES]
    share = frames_share(LIMITS)
    assert share is not None and share < 0.1 and frames_share({SEEN: 3.0}) is None
    for values in loop.system.sample_values(np.random.default_rng(3), 2):
        assert loop.sampled_at(values)[1].spectral_radius() < 1.0


def test_images_of_a_held_sample_are_those_of_the_argument() -> None:
    """A signal of one frequency, sampled and held: its images have the fundamental's factor at their own frequency."""
    N, frames, bin_ = FRAME_TICKS, 40, 7
    ticks = np.arange(N * frames)
    omega = 2.0 * np.pi * bin_ / (N * frames * DT)
    held = np.exp(1j * omega * DT * (ticks // N * N))
    for image in range(N):
        w = omega + 2.0 * np.pi * image / (N * DT)
        found = np.mean(held * np.exp(-1j * w * DT * ticks))
        assert found == pytest.approx(np.mean(np.exp(-1j * w * DT * np.arange(N))), abs=1e-12)
