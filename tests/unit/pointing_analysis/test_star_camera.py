"""A star on the pixels of a guide camera, and its centroid, against closed forms and photutils."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lftkit.errors import InputError
from pointing_analysis.arrays import FloatArray
from pointing_analysis.image.centroid import (
    NO_STAR,
    NOT_A_STAR,
    SATURATED,
    SETTINGS,
    TWO_STARS,
    bound,
    centroid,
    noise_equivalent_angle,
)
from pointing_analysis.image.guide_camera import OFFSET, GuideCamera
from pointing_analysis.image.motion_blur import means
from pointing_analysis.image.optics import Optics
from pointing_analysis.image.star_camera import StarCamera
from pointing_analysis.image.star_image import star_image
from pointing_analysis.units import RAD_PER_MAS

OPTICS = Optics(wavelength=550e-9, pixel_mas=38.0, aperture_diameter=1.5, obscuration=0.3)
QUIET = GuideCamera(cosmic_rate=0.0)
TABLE = {
    "magnitude": 14.0,
    "zero_magnitude_flux": 8.8e9,
    "throughput": 0.5,
    "exposure": 0.02,
    "readout_delay": 0.002,
    "window": 15,
    "read_noise": 3.0,
    "dark": 10.0,
    "full_well": 50000.0,
    "cosmic_rate": 5e-6,
    "cosmic_charge": 2000.0,
    "second_magnitude": 99.0,
    "second_offset_mas": [300.0, 0.0],
    "centroid": "maximum_likelihood",
}


def camera(magnitude: float = 14.0, **values: object) -> StarCamera:
    return StarCamera(OPTICS, replace(QUIET, magnitude=magnitude, **values))  # type: ignore[arg-type]


def walk(rng: np.random.Generator, step: float) -> FloatArray:
    """A path of 20 segments about its own mean [rad]."""
    path = np.cumsum(step * rng.standard_normal((21, 2)), axis=0)
    return np.asarray(path - means(path[None])[0])


def at(place: FloatArray) -> FloatArray:
    """Path of a star at rest."""
    return np.tile(place, (2, 1))


@pytest.mark.parametrize("step", [0.0, 3.0, 30.0])
def test_the_frame_is_the_image_of_the_star(step: float) -> None:
    """The camera's image equals the one of pictures and figures, but for the light from beyond its smaller field."""
    path = walk(np.random.default_rng(1), step * RAD_PER_MAS)
    mine, whole = camera(), star_image(path[None], OPTICS, half=7)
    frame = (mine.expected(path) - mine.background) / mine.flux
    np.testing.assert_allclose(frame, whole, atol=2e-4 * whole.max())


def test_a_star_at_plus_x_is_at_a_larger_column_and_far_away_it_is_gone() -> None:
    made = camera()
    frame = made.expected(at(OPTICS.pixel * np.array([3.0, -2.0])))
    assert np.unravel_index(frame.argmax(), frame.shape) == (7 - 2, 7 + 3)
    assert made.expected(at(np.array([3.0 * made.reach, 0.0]))).max() == made.background


def test_derivatives_are_those_of_differences() -> None:
    made, place, h = camera(), OPTICS.pixel * np.array([0.3, -0.2]), 1e-4 * OPTICS.pixel
    for axis in (0, 1):
        step = h * np.eye(2)[axis]
        difference = (made.still(place + step)[0] - made.still(place - step)[0]) / (2.0 * h)
        np.testing.assert_allclose(made.still(place)[1 + axis], difference, atol=1e-7 * np.abs(difference).max())


@pytest.mark.parametrize("obscuration", [0.0, 0.3])
def test_the_bound_of_a_bright_star_is_that_of_the_aperture(obscuration: float) -> None:
    """Photon noise alone: lambda / (pi D sqrt(N (1 + e^2))), from the mean square of the pupil's coordinate.

    The window leaves out what the wings beyond 3.9 wavelengths over aperture tell, a tenth (4 / (pi^2 3.9)), and small
    as they are, the pixels fill the dark rings.
    """
    optics = Optics(wavelength=550e-9, pixel_mas=9.5, aperture_diameter=1.5, obscuration=obscuration)
    fine = StarCamera(optics, replace(QUIET, magnitude=0.0, window=63, read_noise=0.0, dark=0.0))
    known = optics.resolution / (math.pi * math.sqrt(fine.flux * (1.0 + obscuration**2)))
    found = bound(np.zeros(2), fine)
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert known < found[0] < 1.15 * known


@pytest.mark.parametrize("pixel", [19.0, 36.0])
def test_the_bound_of_a_faint_star_is_that_of_its_transfer_function(pixel: float) -> None:
    """Noise r alone: the sum of the squared derivatives is, by Parseval, an integral of those of the transfer."""
    optics = Optics(wavelength=550e-9, pixel_mas=pixel, aperture_diameter=1.5, obscuration=0.3)
    made = StarCamera(optics, replace(QUIET, read_noise=1000.0, window=31))
    line = optics.cutoff * ((np.arange(801) + 0.5) / 801 * 2.0 - 1.0)
    f = np.stack(np.meshgrid(line, line), axis=-1)
    square = np.abs(2.0 * math.pi * f[..., 0] * optics.diffraction(f) * optics.detector(f)) ** 2
    power = float(square.sum()) * (line[1] - line[0]) ** 2 * optics.pixel**2
    known = math.sqrt(made.camera.floor_variance / power) / made.flux
    np.testing.assert_allclose(bound(np.zeros(2), made), known, rtol=2e-3)


@pytest.mark.parametrize("magnitude", [11.0, 14.0])
def test_maximum_likelihood_reaches_the_bound_without_bias(magnitude: float) -> None:
    """600 frames over the phases of the pixel: standard deviation to 10 %, mean to four of its standard errors."""
    made, rng = camera(magnitude), np.random.default_rng(2)
    errors = []
    for _ in range(600):
        place = OPTICS.pixel * rng.uniform(-0.5, 0.5, 2)
        found = centroid(made.read_out(made.expected(at(place)), rng), made)
        assert found.reason == ""
        errors.append(found.place - place)
    known, rms = noise_equivalent_angle(made), float(np.sqrt(np.mean(np.square(errors))))
    assert rms == pytest.approx(known, rel=0.1)
    assert np.abs(np.mean(errors, axis=0)).max() < 4.0 * known / math.sqrt(600)


def test_the_bias_over_the_phase_of_the_pixel() -> None:
    """Without noise the likelihood is right at any phase; the moments are up to a tenth of a pixel off."""
    likely, moments = camera(9.0), camera(9.0, centroid="moments")
    worst = {"likely": 0.0, "moments": 0.0}
    for phase in np.linspace(-0.5, 0.5, 11):
        place = OPTICS.pixel * np.array([phase, 0.25])
        frame = likely.expected(at(place)) + OFFSET  # not rounded
        for name, made in (("likely", likely), ("moments", moments)):
            error = float(np.abs(centroid(frame, made).place - place).max()) / OPTICS.pixel
            worst[name] = max(worst[name], error)
    assert worst["likely"] < 1e-4
    assert 0.01 < worst["moments"] < 0.15


@pytest.mark.further
def test_moments_are_those_of_photutils() -> None:
    centroids = pytest.importorskip("photutils.centroids")
    made, rng = camera(12.0, centroid="moments"), np.random.default_rng(3)
    for _ in range(20):
        frame = made.read_out(made.expected(at(OPTICS.pixel * rng.uniform(-0.5, 0.5, 2))), rng)
        data = frame - OFFSET - made.background
        row, column = (int(k) for k in np.unravel_index(data.argmax(), data.shape))
        boxes = sum(np.roll(data, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1))
        row, column = (int(k) for k in np.unravel_index(np.asarray(boxes).argmax(), data.shape))
        reach = SETTINGS.moment_pixels
        near = np.s_[row - reach : row + reach + 1, column - reach : column + reach + 1]
        kept = data[near] > SETTINGS.moment_threshold * math.sqrt(made.camera.floor_variance)
        x, y = centroids.centroid_com(np.where(kept, data[near], 0.0))
        theirs = OPTICS.pixel * (np.array([x + column, y + row]) - reach - 7)
        np.testing.assert_allclose(centroid(frame, made).place, theirs, atol=1e-9 * OPTICS.pixel)


def test_mean_and_variance_of_a_pixel() -> None:
    made, rng = camera(12.0), np.random.default_rng(5)
    expected = made.expected(at(np.zeros(2)))
    frames = np.array([made.read_out(expected, rng) for _ in range(4000)])
    assert np.array_equal(frames, np.rint(frames))
    variance = expected + made.camera.read_noise**2 + 1.0 / 12.0
    assert np.abs((frames.mean(axis=0) - OFFSET - expected) / np.sqrt(variance / 4000)).max() < 5.0
    np.testing.assert_allclose(frames.var(axis=0), variance, rtol=6.0 * math.sqrt(2.0 / 4000))


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"magnitude": 5.0}, SATURATED),
        ({"magnitude": 20.0}, NO_STAR),
        ({"second_magnitude": 14.5, "second_offset_mas": (5.0 * OPTICS.pixel_mas, 2.0 * OPTICS.pixel_mas)}, TWO_STARS),
    ],
)
def test_a_frame_without_angles_says_why(values: dict[str, float], reason: str) -> None:
    made, rng = camera(**values), np.random.default_rng(7)  # type: ignore[arg-type]
    found = centroid(made.read_out(made.expected(at(np.zeros(2))), rng), made)
    assert found.reason == reason and np.isnan(found.place).all()


def test_a_hit_of_a_cosmic_particle_is_no_star() -> None:
    empty, rng = camera(25.0), np.random.default_rng(8)
    frame = empty.read_out(empty.expected(at(np.zeros(2))), rng)
    frame[4, 9] += 2000.0
    assert centroid(frame, empty).reason == NOT_A_STAR
    star = camera(13.0)
    frame = star.read_out(star.expected(at(np.zeros(2))), rng)
    frame[2, 12] += 300.0
    assert centroid(frame, star).reason == TWO_STARS


def test_hits_come_at_their_rate() -> None:
    struck = StarCamera(OPTICS, GuideCamera(magnitude=30.0, cosmic_rate=0.02, cosmic_charge=2000.0, dark=0.0))
    rng, dark = np.random.default_rng(9), struck.expected(at(np.zeros(2)))
    charge = np.mean([struck.read_out(dark, rng).sum() - OFFSET * dark.size - dark.sum() for _ in range(20_000)])
    known = 0.02 * 0.02 * dark.size * 2000.0
    spread = math.sqrt(2.0 * 2000.0**2 * 0.02 * 0.02 * dark.size / 20_000)
    assert charge == pytest.approx(known, abs=5.0 * spread)


def test_a_table_makes_a_camera() -> None:
    assert GuideCamera.of_table(TABLE) == GuideCamera(second_offset_mas=(300.0, 0.0))


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("window", 8, "window must be odd and between 7 and 63 pixels, got 8"),
        ("window", True, "window must be a whole number between 7 and 63 pixels, got True"),
        ("magnitude", 120.0, "magnitude must be above -30 and below 99, got 120"),
        ("read_noise", -1.0, "read_noise must be between 0 and 1000 electrons, got -1"),
        ("full_well", 1e6, "full_well must be above 100 and at most 60000 electrons, got 1000000"),
        ("throughput", math.nan, "throughput must be above 0 and at most 1, got nan"),
        ("centroid", "best", "centroid must be one of maximum_likelihood, moments, got 'best'"),
        ("second_offset_mas", [1.0], r"second_offset_mas must hold 2 numbers, got 1"),
        ("colour", 1.0, "unknown parameter 'colour', expected one of: magnitude, "),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(key: str, value: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        GuideCamera.of_table({**TABLE, key: value})
