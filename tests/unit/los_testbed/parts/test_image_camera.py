"""The telescope with a camera that takes images: exposure, read-out, window, frames without angles, bag."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.image_camera import BEFORE_START, DROPPED, SEARCH_AFTER, ImageCamera
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process
from mcap.reader import make_reader
from support.loop_rows import MEASUREMENTS

from lftkit.arrays import FloatArray
from pointing_analysis.image.centroid import NO_STAR, noise_equivalent_angle
from pointing_analysis.image.guide_camera import GuideCamera
from pointing_analysis.image.optics import Optics
from pointing_analysis.image.star_camera import StarCamera
from pointing_analysis.read.run import Run
from pointing_analysis.units import RAD_PER_MAS
from titop_plant.interface import CAMERA, DT

OPTICS = Optics(wavelength=550e-9, pixel_mas=38.0, aperture_diameter=1.5, obscuration=0.3)
STAR = GuideCamera(magnitude=9.0, cosmic_rate=0.0)
RATE = np.array([300.0, -200.0]) * RAD_PER_MAS
"""Of the line of sight [rad/s]: four pixels in half a second."""
NEVER: frozenset[int] = frozenset()


class Drift(ImageCamera):
    """A camera on a telescope whose line of sight moves at a constant rate, without noise of its other sensors."""

    def __init__(self, camera: StarCamera, seed: int, noise: bool, dropped: frozenset[int]) -> None:
        super().__init__(camera, 20, seed, noise)
        self.dropped = dropped

    def step(self) -> FloatArray:
        """Camera's columns of the next tick (2,)."""
        y = np.zeros(MEASUREMENTS)
        y[CAMERA] = 0.0 if self.tick % 20 == 0 and self.tick not in self.dropped else np.nan
        self.after(y, RATE * self.tick * DT)
        return y[CAMERA]


def plant(camera: GuideCamera = STAR, *, noise: bool = False, seed: int = 1, dropped: frozenset[int] = NEVER) -> Drift:
    return Drift(StarCamera(OPTICS, camera), seed, noise, dropped)


def angles(made: Drift, ticks: int) -> FloatArray:
    """Camera's columns of each tick (n, 2)."""
    return np.array([made.step() for _ in range(ticks)])


def user(folder: Path, text: str = '[sensors]\ncamera = "image"\n') -> str:
    file = folder / "user.toml"
    file.write_text('base = "reference"\n' + text, "utf-8")
    return str(file)


@pytest.mark.parametrize(("exposure", "delay"), [(0.02, 0.002), (0.005, 0.0), (0.02, 0.03)])
def test_the_angles_are_the_mean_over_the_exposure_that_was_read_out(exposure: float, delay: float) -> None:
    """So those of a constant rate are older by the delay and half of the exposure; the window follows the star."""
    found = angles(plant(replace(STAR, exposure=exposure, readout_delay=delay)), 2001)
    frames = np.arange(0, 2001, 20)
    exposed = frames * DT >= exposure + delay - 1e-9
    assert np.isnan(np.delete(found, frames, axis=0)).all()
    assert np.isnan(found[frames[~exposed]]).all() and not np.isnan(found[frames[exposed]]).any()
    known = RATE * (frames[exposed] * DT - delay - 0.5 * exposure)[:, None]
    # the model of the centroid is a star at rest
    np.testing.assert_allclose(found[frames[exposed]], known, atol=2e-3 * OPTICS.pixel)


class Counted(Drift):
    """Says what is done of the frames, and in which tick."""

    def _go_on(self) -> bool:
        done = super()._go_on()
        if done:
            self.done.append(self.stepping)
        return done

    def step(self) -> FloatArray:
        self.stepping = True
        found = super().step()
        self.stepping = False
        return found

    def reset(self) -> None:
        self.done: list[bool] = []
        super().reset()


@pytest.mark.parametrize("delay", [0.001, 0.002, 0.03])
def test_work_between_ticks_gives_the_same_bits_and_leaves_none_to_them(delay: float) -> None:
    """A frame and its centroid take longer than the telescope: in real time they must not be in a tick."""
    camera = StarCamera(OPTICS, replace(STAR, magnitude=13.0, readout_delay=delay))
    alone, between = (Counted(camera, 1, True, frozenset({100, 140})) for _ in range(2))
    expected, found = angles(alone, 1000), np.zeros((1000, 2))
    for k in range(1000):
        found[k] = between.step()
        between.work()
    assert np.array_equal(expected, found, equal_nan=True) and np.isfinite(found).any()
    assert np.array_equal(alone.image, between.image) and alone.counts == between.counts
    assert all(alone.done) and not any(between.done) and len(between.done) >= len(alone.done) > 90


def test_frames_without_angles_are_counted_by_reason() -> None:
    made = plant(replace(STAR, magnitude=25.0), noise=True, dropped=frozenset({100, 140}))
    found = angles(made, 400)
    assert np.isnan(found).all()
    assert made.missing == {BEFORE_START: 2, DROPPED: 2, NO_STAR: 16}


def test_a_lost_star_is_searched_in_the_whole_field() -> None:
    """Clouds for a second: the star leaves the window, which goes on after some frames without angles."""
    made = plant(noise=True)
    assert not np.isnan(angles(made, 401)[40::20]).any()
    bright, dark = made.camera, StarCamera(OPTICS, replace(STAR, magnitude=25.0))
    made.camera = dark
    assert np.isnan(angles(made, 4000)).all()  # 1.2 arcsec, twice the window
    assert made.missing[NO_STAR] == 200 > SEARCH_AFTER
    made.camera = bright
    found = angles(made, 400)
    assert (~np.isnan(found).any(axis=1)).sum() >= 19


def test_a_run_has_its_images_in_the_bag(tmp_path: Path) -> None:
    """Frames at the frame rate with the stamps of their angles, which are the exposures' means to some noise."""
    config = RunConfig(mode="inprocess", duration=1.0, parameters=user(tmp_path), scenario="imbalance")
    parts = RunParts(config)
    assert parts.star_camera is not None
    statistics = run_in_process(config, tmp_path / "bag")
    assert statistics["plant"]["frames"] == "50" and statistics["plant"]["frames_before_start"] == "2"
    with (tmp_path / "bag/bag_0.mcap").open("rb") as file:
        messages = [
            (schema.name, message.log_time, message.data)
            for schema, channel, message in make_reader(file).iter_messages("/telescope/camera/image")
            if schema is not None
        ]
    run = Run.open(tmp_path / "bag")
    camera, truth = run["camera/los"], run["truth/los"]
    assert {name for name, _, _ in messages} == {"sensor_msgs/msg/Image"}
    assert [stamp for _, stamp, _ in messages] == camera.stamp.tolist()
    offset = len(messages[0][2]) - 2 - 2 * 15**2  # two bytes fill up the last four
    frame = np.frombuffer(messages[-1][2], "<u2", 15**2, offset)
    assert 200 < int(frame.sum()) - 100 * 15**2 < 600  # 355 electrons of the star, 45 of the dark current
    x = np.asarray(truth.values)[:, :2]
    means = [x[k - 22 : k - 1].mean(axis=0) for k in range(40, 1000, 20)]
    error = np.asarray(camera.values)[2:, :2] - np.array(means)
    assert float(error.std()) == pytest.approx(noise_equivalent_angle(parts.star_camera), rel=0.3)
    assert json.loads(json.dumps(run.parameters["camera"]))["magnitude"] == 14.0
