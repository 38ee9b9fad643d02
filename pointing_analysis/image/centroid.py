r"""Centroid of a star in a frame: moments, maximum likelihood, and the Cramer-Rao bound.

The likelihood is that of Poisson noise and read noise of variance :math:`r^2`, the latter taken as Poisson noise, too:
:math:`d + r^2` has the mean and the variance :math:`\mu + r^2`. Its information about x, y and the flux is

.. math:: I_{ab} = \sum \frac{\partial_a\mu\;\partial_b\mu}{\mu + r^2}

and the bound of the variance of x is :math:`(I^{-1})_{xx}`. The model is the star at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.support.settings import AlgorithmSettings
from pointing_analysis.arrays import FloatArray
from pointing_analysis.image.guide_camera import OFFSET
from pointing_analysis.image.star_camera import StarCamera

SATURATED, NO_STAR, TWO_STARS, NOT_A_STAR = "saturated", "no_star", "two_stars", "not_a_star"
REASONS = (SATURATED, NO_STAR, TWO_STARS, NOT_A_STAR)
"""Why a frame gives no angles."""


@dataclass(frozen=True)
class CentroidSettings(AlgorithmSettings):
    """What is a star, and how its place is found.

    Attributes
    ----------
    detection : sigma of 3 x 3 pixels without light that a star must have
    apart : a second star is searched for farther away than this from the first [wavelength over aperture]
    second : part of the brightest 3 x 3 pixels that a second star has at least: the first ring has a third of it
    sharpest : part of 3 x 3 pixels that the brightest of them holds at most: a hit of a cosmic particle holds all
    moment_pixels : the moments are of the pixels so many to each side of the brightest
    moment_threshold : sigma above which a pixel counts in them
    steps : largest number of steps to the maximum of the likelihood
    tolerance : a smaller step ends them [pixel]
    """

    detection: float = 5.0
    apart: float = 2.5
    second: float = 0.15
    sharpest: float = 0.6
    moment_pixels: int = 3
    moment_threshold: float = 3.0
    steps: int = 12
    tolerance: float = 1e-3


SETTINGS = CentroidSettings()


@dataclass(frozen=True)
class Centroid:
    """Result of a frame.

    Parameters
    ----------
    place : ndarray, shape (2,)
        From the middle of the window [rad]; NaN where there is none.
    reason : str
        Why not, one of `REASONS`; "" with a place.
    """

    place: FloatArray
    reason: str = ""


def _missing(reason: str) -> Centroid:
    return Centroid(np.full(2, np.nan), reason)


def centroid(frame: FloatArray, camera: StarCamera, settings: CentroidSettings = SETTINGS) -> Centroid:
    """Place of the star in a frame.

    Parameters
    ----------
    frame : ndarray, shape (n, n)
        Counts, as :meth:`StarCamera.read_out` gives them.
    camera : StarCamera
    settings : CentroidSettings
    """
    data = frame - OFFSET
    if float(data.max()) >= camera.camera.full_well - 5.0 * camera.camera.read_noise:
        return _missing(SATURATED)
    data = data - camera.background
    # Sums of 3 x 3 pixels about each pixel, fewer at the edge
    padded = np.zeros((data.shape[0] + 2, data.shape[1] + 2))
    padded[1:-1, 1:-1] = data
    three = padded[:-2] + padded[1:-1] + padded[2:]
    boxes = np.asarray(three[:, :-2] + three[:, 1:-1] + three[:, 2:])
    row, column = np.unravel_index(int(np.argmax(boxes)), boxes.shape)
    brightest, sigma = float(boxes[row, column]), np.sqrt(camera.camera.floor_variance)
    faintest = settings.detection * 3.0 * sigma
    if brightest < faintest:
        return _missing(NO_STAR)
    near = data[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
    if float(near.max()) > settings.sharpest * brightest + settings.detection * sigma:
        return _missing(NOT_A_STAR)
    rows, columns = (np.arange(size) - at for size, at in zip(data.shape, (row, column)))
    far = np.hypot(rows[:, None], columns) * camera.optics.pixel > settings.apart * camera.optics.resolution
    if far.any() and float(boxes[far].max()) > faintest + settings.second * brightest:
        return _missing(TWO_STARS)
    start = _moments(data, int(row), int(column), camera, settings)
    return (
        Centroid(start)
        if camera.camera.centroid == "moments"
        else _most_likely(data, start, brightest, camera, settings)
    )


def _moments(data: FloatArray, row: int, column: int, camera: StarCamera, settings: CentroidSettings) -> FloatArray:
    """Centre of what is above the threshold in the pixels about the brightest."""
    reach, threshold = settings.moment_pixels, settings.moment_threshold * np.sqrt(camera.camera.floor_variance)
    first_row, first_column = max(row - reach, 0), max(column - reach, 0)
    part = data[first_row : row + reach + 1, first_column : column + reach + 1]
    weight = np.where(part > threshold, part, 0.0)
    total = float(weight.sum())
    if not total > 0.0:  # all of the light is in pixels below the threshold
        return np.array([camera.line[column], camera.line[row]])
    x = camera.line[first_column : first_column + part.shape[1]]
    y = camera.line[first_row : first_row + part.shape[0]]
    return np.array([float(weight.sum(axis=0) @ x), float(weight.sum(axis=1) @ y)]) / total


def _most_likely(
    data: FloatArray, start: FloatArray, brightest: float, camera: StarCamera, settings: CentroidSettings
) -> Centroid:
    """Maximum of the likelihood over place and flux by Fisher scoring."""
    pixel, floor, edge = camera.optics.pixel, camera.camera.floor_variance, float(camera.line[-1]) / camera.optics.pixel
    x, y, flux = float(start[0]) / pixel, float(start[1]) / pixel, brightest
    flat = data.ravel()
    for _ in range(settings.steps):
        image, by_x, by_y = camera.still(np.array([pixel * x, pixel * y]))
        derivatives = np.concatenate((by_x, by_y, image), axis=None).reshape(3, -1)
        mean = flux * derivatives[2]
        weighted = derivatives / (np.maximum(mean, 0.0) + floor)
        step = _step((weighted @ derivatives.T).tolist(), (weighted @ (flat - mean)).tolist(), pixel, flux)
        if step is None:
            return _missing(NOT_A_STAR)
        move = [min(max(part, -1.0), 1.0) for part in step[:2]]
        x, y, flux = x + move[0], y + move[1], max(flux + flux * step[2], 0.1 * flux)
        if max(abs(x), abs(y)) > edge:
            return _missing(NO_STAR)
        if max(map(abs, move)) < settings.tolerance:
            return Centroid(np.array([pixel * x, pixel * y]))
    return _missing(NOT_A_STAR)


def _step(
    information: list[list[float]], score: list[float], pixel: float, flux: float
) -> tuple[float, float, float] | None:
    """Step of Fisher scoring [pixel, pixel, part of the flux] by the cofactors; None where there is none.

    Both are those of the image of energy 1 and of its derivatives by x, y [1/rad].
    """
    size = (pixel, pixel, 1.0)
    (a, b, c), (_, d, e), (_, _, f) = (
        tuple(size[i] * size[j] * value for j, value in enumerate(row)) for i, row in enumerate(information)
    )
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * A + b * B + c * C
    if not (a > 0.0 and a * d > b * b and determinant > 0.0):
        return None
    u, v, w = (part * value / (determinant * flux) for part, value in zip(size, score))
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    return A * u + B * v + C * w, B * u + D * v + E * w, C * u + E * v + F * w


def bound(place: FloatArray, camera: StarCamera) -> FloatArray:
    """Smallest standard deviations of an unbiased estimate of x and y of a star at rest (Cramer and Rao) [rad].

    Parameters
    ----------
    place : ndarray, shape (2,)
        From the middle of the window [rad].
    camera : StarCamera

    Returns
    -------
    ndarray, shape (2,)
    """
    image, by_x, by_y = camera.still(place)
    derivatives = np.stack([camera.flux * by_x.ravel(), camera.flux * by_y.ravel(), image.ravel()])
    variance = np.maximum(camera.flux * image.ravel(), 0.0) + camera.camera.floor_variance
    scale = np.array([camera.optics.pixel, camera.optics.pixel, camera.flux])
    information = (derivatives / variance) @ derivatives.T * np.outer(scale, scale)
    return np.asarray(np.sqrt(np.diag(linalg.inv(information)))[:2] * scale[:2])


def noise_equivalent_angle(camera: StarCamera, phases: int = 4) -> float:
    """Bound of the standard deviation of an angle, rms over both axes and over the place within a pixel [rad].

    Parameters
    ----------
    camera : StarCamera
    phases : int
        Places within a pixel along each axis.
    """
    line = (np.arange(phases) + 0.5) / phases - 0.5
    variances = [bound(camera.optics.pixel * np.array([x, y]), camera) ** 2 for x in line for y in line]
    return float(np.sqrt(np.mean(variances)))
