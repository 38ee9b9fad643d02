r"""Figures of the image of a star in each exposure: Strehl ratio, encircled energy, size and ellipticity.

With the transfer functions of aperture O, of the pixel P and of the motion M (about the mean of the path) the image is
:math:`I(x) = \int O P M\, e^{2\pi i f\cdot x}\,d^2f`, and

==================  ================================================================================================
Strehl ratio        of the motion: largest value of the image by aperture and motion over that without motion
encircled energy    about the mean position, of the image with the pixel: :math:`E(r) = 2\pi r \int \langle O P M
                    \rangle(f)\, J_1(2\pi r f)\,df`, the mean over the directions of f; EE50 and EE80 are its radii
size, ellipticity   :math:`R^2 = Q_{xx} + Q_{yy}`, :math:`e_1 = (Q_{xx} - Q_{yy}) / R^2`, :math:`e_2 = 2 Q_{xy} / R^2`,
                    Q the second moments of the image with the pixel, with a Gaussian weight about the position where
                    its first moments vanish
==================  ================================================================================================

Nothing is drawn on a grid: all of them are integrals over frequencies (:mod:`pointing_analysis.image.quadrature`).
An exposure in which the line of sight goes farther than `LARGEST` (phase at the cutoff) from its mean counts as the
worst possible: Strehl ratio 0, infinite radii, ellipticity 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from pointing_analysis.arrays import ComplexArray, FloatArray
from pointing_analysis.image.motion_blur import centred, levels, motion_transfer, sizes
from pointing_analysis.image.optics import Optics
from pointing_analysis.image.quadrature import Quadrature

LARGEST = 60.0
"""[rad] 2 pi times the largest distance from the mean, in units of wavelength over aperture: 9.5 of these."""
LEVELS = (1.5, 6.0, 15.0, 30.0, LARGEST)
"""Exposures are worked on in classes by that phase, each with as many frequencies as it needs."""
STARTS = 5
"""Places on the path at which the search for the peak begins, where it may have several."""
ONE_PEAK = 2.0
"""[rad] Motion below this phase leaves one peak, near the mean."""
STEPS = 20
RADII = 160
BLOCK = 1 << 17
MOMENTS = ("size", "e1", "e2", "ellipticity")
"""Figures that are computed together."""
Figure = Callable[[Optics, Quadrature, FloatArray, ComplexArray], FloatArray]
"""Figures (m, k) from optics, frequencies, paths (m, N + 1, 2) about their means and their transfer (m, f)."""


FIGURES: dict[str, tuple[Figure, float]] = {}
"""Name to figure and to the value of motion beyond `LARGEST`; filled below."""


def figures(paths: FloatArray, optics: Optics, names: Sequence[str]) -> dict[str, FloatArray]:
    """Several figures of each exposure, for little more than the cost of one.

    Parameters
    ----------
    paths : (m, N + 1, 2) [rad]
    optics : Optics
    names : of `FIGURES`: strehl, ee50, ee80 [rad], size [rad^2], e1, e2, ellipticity

    Returns
    -------
    (m,) of each name
    """
    wanted = list(dict.fromkeys("moments" if name in MOMENTS else name for name in names))
    x = centred(paths)
    found = {name: np.full((len(x), 3), FIGURES[name][1]) for name in wanted}
    for rows, top in levels(_phases(x, optics), LEVELS):
        q = Quadrature.of(optics, top)
        count = max(BLOCK // len(q.weights), 1)
        for first in range(0, len(rows), count):
            some = rows[first : first + count]
            transfer = motion_transfer(x[some], q.frequencies)
            for name in wanted:
                values = FIGURES[name][0](optics, q, x[some], transfer)
                found[name][some, : values.shape[1]] = values
    columns = {name: found[name][:, 0] for name in wanted if name != "moments"}
    if "moments" in wanted:
        size, e1, e2 = found["moments"].T
        absolute = np.where(np.isfinite(size), np.hypot(e1, e2), 1.0)
        columns |= {"size": size, "e1": e1, "e2": e2, "ellipticity": absolute}
    return {name: columns[name] for name in names}


def strehl(paths: FloatArray, optics: Optics) -> FloatArray:
    """Strehl ratio of the motion in each exposure: (m, N + 1, 2) [rad] -> (m,)."""
    return figures(paths, optics, ("strehl",))["strehl"]


def encircled_energy(path: FloatArray, optics: Optics, radii: FloatArray) -> FloatArray:
    """Part of the energy within radii [rad] about the mean position, all exposures together.

    Parameters
    ----------
    path : (m, N + 1, 2) [rad]
    radii : (r,) [rad]
    """
    x = centred(path)
    phase = _phases(x, optics)
    q = Quadrature.of(optics, float(phase.max()) + 2 * math.pi * optics.cutoff * float(np.max(radii)))
    mean = np.mean([_azimuthal(q, q.image * motion_transfer(one[None], q.frequencies))[0] for one in x], axis=0)
    return np.asarray(_energy(mean[None], q, np.asarray(radii, dtype=float)[None])[0])


def _phases(x: FloatArray, optics: Optics) -> FloatArray:
    return np.asarray(2 * math.pi * optics.cutoff * sizes(x))


def _shifted(q: Quadrature, places: FloatArray) -> ComplexArray:
    """exp(2 pi i f . x) at a place of each exposure: (m, 2) -> (m, f)."""
    phase = 2 * math.pi * (places @ q.frequencies.T)
    found = np.empty(phase.shape, dtype=complex)
    found.real, found.imag = np.cos(phase), np.sin(phase)
    return found


def _peaks(optics: Optics, q: Quadrature, x: FloatArray, transfer: ComplexArray) -> FloatArray:
    """Strehl ratio (m, 1)."""
    still = _peak(q, q.diffraction[None], _still_peak(optics, q))
    starts = still[1]
    if float(_phases(x, optics).max()) > ONE_PEAK:
        places = x[:, np.linspace(0, x.shape[1] - 1, STARTS).round().astype(int)]
        places = np.concatenate([places, np.zeros((len(x), 1, 2))], axis=1) + starts
        spectrum = q.diffraction * transfer
        heights = np.stack([q.over_plane(spectrum * _shifted(q, p)) for p in places.swapaxes(0, 1)], axis=1)
        starts = places[np.arange(len(x)), heights.argmax(axis=1)]
    peak, _ = _peak(q, q.diffraction * transfer, np.broadcast_to(starts, (len(x), 2)))
    return np.asarray(peak / still[0])[:, None]


def _still_peak(optics: Optics, q: Quadrature) -> FloatArray:
    """Approximate peak of the image without motion: with aberrations it may be off the axis."""
    if optics.aperture.in_phase:
        return np.zeros((1, 2))
    line = optics.resolution * np.arange(-8.0, 8.25, 0.25)
    places = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    heights = np.concatenate([q.over_plane(q.diffraction * _shifted(q, p)) for p in np.array_split(places, 64)])
    return np.asarray(places[heights.argmax()][None])


def _surface(q: Quadrature) -> ComplexArray:
    """Integrands of value, slope (x, y) and curvature (xx, xy, yy) of an image, from its spectrum: (f, 6)."""
    turn = 2j * math.pi * q.frequencies
    x, y = turn[:, 0], turn[:, 1]
    columns = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    return np.asarray(2.0 * q.weights[:, None] * columns)


def _peak(q: Quadrature, spectrum: ComplexArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Largest value near a start by Newton's method, and its place: (m,), (m, 2)."""
    place, surface = np.array(start, dtype=float), _surface(q)
    far = 0.25 / float(q.radii[-1])
    here = ((spectrum * _shifted(q, place)) @ surface).real
    for _ in range(STEPS):
        # Newton's step where the surface bends down in all directions, else one along the slope
        slope, xx, xy, yy = here[:, 1:3], here[:, 3], here[:, 4], here[:, 5]
        det = xx * yy - xy**2
        down = (det > 0) & (xx < 0)
        det = np.where(down, det, 1.0)
        newton = np.stack([-(yy * slope[:, 0] - xy * slope[:, 1]), -(xx * slope[:, 1] - xy * slope[:, 0])], axis=-1)
        size = np.abs(xx) + np.abs(yy) + 1e-300
        step = np.where(down[:, None], newton / det[:, None], slope / size[:, None])
        length = np.hypot(step[:, 0], step[:, 1])
        step *= np.minimum(1.0, far / np.maximum(length, 1e-300))[:, None]
        tried = ((spectrum * _shifted(q, place + step)) @ surface).real
        better = tried[:, 0] > here[:, 0]
        place, here = np.where(better[:, None], place + step, place), np.where(better[:, None], tried, here)
        if not better.any() or float(length.max()) < 1e-5 * far:  # the height is flat there: exact to its square
            break
    return here[:, 0], place


def peak_of(q: Quadrature, spectrum: ComplexArray, path: FloatArray) -> tuple[float, FloatArray]:
    """Largest value of one image and its place (2,), searched for from some places on the path (N + 1, 2)."""
    starts = np.concatenate([path[np.linspace(0, len(path) - 1, STARTS).round().astype(int)], np.zeros((1, 2))])
    heights, places = _peak(q, spectrum[None], starts)
    best = int(heights.argmax())
    return float(heights[best]), places[best]


def _azimuthal(q: Quadrature, values: ComplexArray) -> FloatArray:
    """Mean over the directions: (m, r a) -> (m, r)."""
    return np.asarray(values.real.reshape(len(values), len(q.radii), q.angles).mean(axis=2))


def _energy(mean: FloatArray, q: Quadrature, radii: FloatArray) -> FloatArray:
    """Energy within radii: (m, r) and (1 or m, k) -> (m, k)."""
    from scipy import special

    kernel = special.j1(2 * math.pi * radii[..., None] * q.radii) * q.steps
    together = mean @ kernel[0].T if len(radii) == 1 else np.einsum("mr,mkr->mk", mean, kernel)
    return np.asarray(2 * math.pi * radii * together)


def _radius(part: float, optics: Optics, q: Quadrature, x: FloatArray, transfer: ComplexArray) -> FloatArray:
    """Radius with a part of the energy (m, 1): a table, then bisection and secants on what is left."""
    from scipy import special

    mean = _azimuthal(q, q.image * transfer)
    top = 4.0 * optics.resolution + optics.pixel
    while True:
        grid = np.asarray(np.linspace(0.0, top, RADII), dtype=float)
        table = _energy(mean, q, grid[None])
        reached = table >= part
        if reached.any(axis=1).all() or top > 200.0 * optics.resolution:
            break
        top *= 2.0
    at = np.where(reached.any(axis=1), reached.argmax(axis=1), RADII - 1)
    low, high = grid[np.maximum(at - 1, 0)], grid[at]
    radius = 0.5 * (low + high)
    for _ in range(60):
        value = _energy(mean, q, radius[:, None])[:, 0] - part
        low, high = np.where(value < 0, radius, low), np.where(value < 0, high, radius)
        arc = special.j0(2 * math.pi * radius[:, None] * q.radii) * (q.steps * q.radii)
        slope = 4 * math.pi**2 * radius * np.sum(mean * arc, axis=1)
        newton = radius - value / np.where(slope > 0, slope, 1.0)
        inside = (slope > 0) & (newton > low) & (newton < high)
        following = np.where(inside, newton, 0.5 * (low + high))
        moved, radius = float(np.abs(following - radius).max()), following
        if moved <= 1e-13 * top:
            break
    return np.where(reached.any(axis=1), radius, math.inf)[:, None]


def _moments(optics: Optics, q: Quadrature, x: FloatArray, transfer: ComplexArray) -> FloatArray:
    """R^2, e1, e2 (m, 3).

    The first moments vanish where the image, smoothed by the weight, has its peak: the one near the mean of the path.
    """
    f, sigma = q.frequencies, optics.moment_weight
    weight = 2 * math.pi * sigma**2 * np.exp(-2 * math.pi**2 * sigma**2 * np.sum(f**2, axis=1))
    spectrum = q.image * transfer * weight
    _, place = _peak(q, spectrum, np.zeros((len(x), 2)))
    found = ((spectrum * _shifted(q, place)) @ _surface(q)).real
    # x_i x_j times the weight has the spectrum (sigma^2 d_ij - 4 pi^2 sigma^4 f_i f_j) times that of the weight
    xx, xy, yy = (sigma**2 * same + sigma**4 * found[:, k] / found[:, 0] for k, same in ((3, 1), (4, 0), (5, 1)))
    return np.stack([xx + yy, (xx - yy) / (xx + yy), 2 * xy / (xx + yy)], axis=-1)


FIGURES |= {
    "strehl": (_peaks, 0.0),
    "ee50": (partial(_radius, 0.5), math.inf),
    "ee80": (partial(_radius, 0.8), math.inf),
    "moments": (_moments, math.inf),
}
