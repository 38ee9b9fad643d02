"""Motion and diffraction in a star's image: closed forms, sums written out, laws of the variance, files of others."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from lftkit.errors import InputError
from lftkit.support.input_limits import PICTURE
from pointing_analysis.image import motion_blur
from pointing_analysis.image import optics as optics_module
from pointing_analysis.image.fits_files import read_pupil
from pointing_analysis.image.motion_blur import (
    centred,
    covariance,
    exposures,
    means,
    missing,
    motion_transfer,
    sizes,
    worst_transfer,
)
from pointing_analysis.image.optics import Optics, from_mapping, load_optics
from pointing_analysis.image.pupil import AnnularPupil, PixelPupil, with_spider

F = 1.3e6
"""[cycles/rad]"""


def path_of(x: Any, y: Any = 0.0) -> Any:
    x = np.asarray(x, dtype=float)
    return np.column_stack([x, np.broadcast_to(y, x.shape)])[None]


def random_paths(count: int, samples: int, size: float, seed: int) -> Any:
    return np.cumsum(np.random.default_rng(seed).standard_normal((count, samples + 1, 2)), axis=1) * size


def test_a_ramp_is_a_sinc() -> None:
    """Whatever the number of samples: the path is linear between them."""
    length, angle = 0.9e-6, 0.4
    ramp = np.linspace(-length / 2, length / 2, 21)
    path = path_of(ramp * math.cos(angle), ramp * math.sin(angle))
    frequencies = np.array([[0.0, 0.0], [F, 0.0], [0.3 * F, -0.8 * F], [5 * F, 2 * F]])
    along = frequencies @ [math.cos(angle), math.sin(angle)]
    assert np.abs(motion_transfer(path, frequencies)[0] - np.sinc(length * along)).max() < 1e-14


def test_a_tone_over_many_periods_is_a_bessel_function() -> None:
    """The polygon of 4000 chords a period lies inside the sine by 2e-7 of the amplitude."""
    phase = 2 * math.pi * np.arange(40 * 4000 + 1) / 4000
    for amplitude in (1e-8, 2e-7, 6e-7):
        path = path_of(amplitude * np.sin(phase))
        polygon = amplitude * (1 - (math.pi / 4000) ** 2 / 3)  # chords of the same mean square
        found = motion_transfer(path, np.array([[F, 0.0], [0.0, F]]))[0]
        assert abs(found[0] - special.j0(2 * math.pi * F * polygon)) < 1e-9
        assert abs(found[1] - 1.0) < 1e-15


def test_gaussian_motion_by_its_covariance() -> None:
    """Nodes of Gauss and Hermite, each for a time as long as its weight: the mean is that of the distribution."""
    node, weight = np.polynomial.hermite_e.hermegauss(60)
    sigma, weight = 8e-8, weight / weight.sum()
    for f in (0.5 * F, F, 2 * F):
        still = [motion_transfer(path_of([x, x]), np.array([[f, 0.0]]))[0, 0] for x in sigma * node]
        assert abs(np.dot(weight, still) - math.exp(-2 * math.pi**2 * sigma**2 * f**2)) < 1e-9


def test_against_averages_by_brute_force() -> None:
    """Gauss points on every segment, hundreds of times as many as needed for the accuracy asked for."""
    node, twice = np.polynomial.legendre.leggauss(40)
    s, weight = (node + 1) / 2, twice / 2
    for size in (1e-9, 1e-7, 2e-6):
        paths = random_paths(5, 20, size, 3)
        between = paths[:, :-1, None, :] * (1 - s[:, None]) + paths[:, 1:, None, :] * s[:, None]
        for f in ([F, 0.0], [-0.2 * F, 0.7 * F]):
            wave = np.exp(-2j * math.pi * between @ np.array(f))
            expected = (wave @ weight).mean(axis=1)
            assert np.abs(motion_transfer(paths, np.array([f]))[:, 0] - expected).max() < 1e-9


def test_frequencies_of_each_exposure_and_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    paths, f = random_paths(50, 10, 1e-7, 4), F * np.random.default_rng(5).standard_normal((50, 3, 2))
    together = motion_transfer(paths, f)
    alone = np.array([motion_transfer(p[None], g)[0] for p, g in zip(paths, f)])
    assert np.abs(together - alone).max() < 1e-15
    monkeypatch.setattr(motion_blur, "BLOCK", 40)
    assert np.abs(motion_transfer(paths, f) - together).max() < 1e-15


@given(st.integers(0, 2**32 - 1), st.floats(-9.0, -5.5), st.floats(0.0, math.pi), st.integers(1, 30))
def test_the_variance_bounds_the_loss(seed: int, exponent: float, angle: float, samples: int) -> None:
    """|M| >= 1 - 2 pi^2 f' C f and, below a quarter of a cycle, |M| >= cos(2 pi sqrt(f' C f))."""
    paths = random_paths(4, samples, 10**exponent, seed)
    f = F * np.array([math.cos(angle), math.sin(angle)])
    transfer = np.abs(motion_transfer(paths, f[None])[:, 0])
    spread = np.einsum("i,mij,j->m", f, covariance(paths), f)
    assert (transfer >= 1 - 2 * math.pi**2 * spread - 1e-12).all()
    near = 2 * math.pi * np.sqrt(spread)
    assert (transfer[near < math.pi / 2] >= np.cos(near[near < math.pi / 2]) - 1e-12).all()


def test_the_sharper_law_is_tight() -> None:
    """Half of the time at either end of a jump, all of the rms: the cosine itself."""
    paths = np.zeros((1, 20_001, 2))
    paths[:, 10_001:, 0] = 2e-7
    sigma = math.sqrt(covariance(paths)[0, 0, 0])
    found = abs(motion_transfer(paths, np.array([[F, 0.0]]))[0, 0])
    assert 0.0 <= found - math.cos(2 * math.pi * F * sigma) < 1e-4


def test_means_and_covariance_of_the_path_between_the_samples() -> None:
    paths = random_paths(6, 12, 1e-7, 6)
    s = (np.arange(2000) + 0.5)[:, None] / 2000
    fine = (paths[:, :-1, None] * (1 - s) + paths[:, 1:, None] * s).reshape(6, -1, 2)
    assert np.abs(means(paths) - fine.mean(axis=1)).max() < 1e-20
    expected = np.array([np.cov(x.T, bias=True) for x in fine])
    assert np.abs(covariance(paths) - expected).max() < 1e-7 * expected.max()
    assert np.abs(means(centred(paths))).max() < 1e-21
    assert np.allclose(sizes(paths), np.hypot(*np.moveaxis(centred(paths), -1, 0)).max(axis=1))


@pytest.mark.parametrize("size", [1e-9, 3e-8, 2e-7])
def test_the_worst_direction_is_that_of_a_fine_grid(size: float) -> None:
    paths, angles = random_paths(8, 20, size, 7), math.pi * np.arange(20_000) / 20_000
    transfer, angle = worst_transfer(paths, F)
    f = F * np.column_stack([np.cos(angles), np.sin(angles)])
    on_grid = np.array([np.abs(motion_transfer(x[None], f))[0].min() for x in centred(paths)])
    assert (transfer <= on_grid + 1e-12).all() and (transfer >= on_grid - 1e-6).all()
    there = F * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None]
    assert np.allclose(np.abs(motion_transfer(paths, there))[:, 0], transfer, atol=1e-12)


def test_exposures_share_their_ends() -> None:
    error = np.arange(24.0).reshape(12, 2)
    paths = exposures(error, 1e-3, 5e-3)
    assert paths.shape == (2, 6, 2)
    assert (paths[0, -1] == paths[1, 0]).all() and (paths[1, -1] == error[10]).all()
    error[5] = np.nan
    assert missing(exposures(error, 1e-3, 5e-3)).tolist() == [True, True]
    with pytest.raises(ValueError, match=r"one exposure of 0.005 s and a sample, got 5 samples of 0.001 s"):
        exposures(error[:5], 1e-3, 5e-3)
    with pytest.raises(ValueError, match="window must be a whole number"):
        exposures(error, 1e-3, 4.5e-3)


GOOD = {"aperture_diameter": 1.5, "obscuration": 0.3, "wavelength": 550e-9, "pixel_mas": 38.0}


def along_x(shift: Any) -> Any:
    return np.stack([np.asarray(shift, dtype=float), np.zeros(np.size(shift))], axis=-1)


def o_neill(nu: float, e: float) -> float:
    """Transfer function of an annular aperture, O'Neill, J. Opt. Soc. Am. 46 (1956) 285, errata 46 (1956) 1096."""

    def circle(x: float) -> float:
        return 2 / math.pi * (math.acos(x) - x * math.sqrt(1 - x * x)) if x < 1 else 0.0

    a, b = circle(nu), e**2 * circle(nu / e)
    if nu <= (1 - e) / 2:
        c = -2 * e**2
    elif nu < (1 + e) / 2:
        chi = math.acos((1 + e**2 - 4 * nu**2) / (2 * e))
        part = math.atan((1 + e) / (1 - e) * math.tan(chi / 2))
        c = 2 * e / math.pi * math.sin(chi) + (1 + e**2) / math.pi * chi - 2 * (1 - e**2) / math.pi * part - 2 * e**2
    else:
        c = 0.0
    return (a + b + c) / (1 - e**2)


@pytest.mark.parametrize("e", [0.1, 0.3, 0.5, 0.8])
def test_the_annulus_is_that_of_o_neill(e: float) -> None:
    nu = np.linspace(0.0, 1.2, 247)  # off the places where circles touch: there the formula loses its digits
    found = AnnularPupil(1.5, e).autocorrelation(along_x(1.5 * nu))
    assert np.abs(found - [o_neill(x, e) for x in nu]).max() < 1e-9


def test_the_circle() -> None:
    nu = np.linspace(0.0, 1.0, 101)
    expected = 2 / math.pi * (np.arccos(nu) - nu * np.sqrt(1 - nu**2))
    assert np.abs(AnnularPupil(2.4).autocorrelation(along_x(2.4 * nu)) - expected).max() < 1e-12
    assert AnnularPupil(2.4).autocorrelation(along_x([2.5, 1e9])).tolist() == [0.0, 0.0]


def test_pixels_against_the_sum_written_out() -> None:
    """Whole pixels by sums, between them by an integral of the overlapping squares."""
    rng = np.random.default_rng(0)
    amplitude = rng.random((5, 7)) * np.exp(2j * rng.random((5, 7)))
    pupil = PixelPupil(amplitude, 0.1)
    total = np.sum(np.abs(amplitude) ** 2)
    padded = np.pad(amplitude, 8)
    for dy in range(-5, 6):
        for dx in range(-7, 8):
            shifted = np.roll(padded, (dy, dx), axis=(0, 1))
            expected = np.sum(padded * shifted.conj()) / total
            assert abs(pupil.autocorrelation(np.array([[0.1 * dx, 0.1 * dy]]))[0] - expected) < 1e-9
    fine = PixelPupil(np.kron(amplitude, np.ones((10, 10))), 0.01)
    shift = 0.01 * rng.integers(-80, 80, (200, 2)).astype(float)
    assert np.abs(fine.autocorrelation(shift) - pupil.autocorrelation(shift)).max() < 1e-9
    conjugate = pupil.autocorrelation(-shift).conj()
    assert np.abs(pupil.autocorrelation(shift) - conjugate).max() < 1e-12


def test_vanes_take_light() -> None:
    """Three vanes of 5 cm from the obscuration to the edge."""
    pupil = with_spider(1.5, 0.3, 3, 0.05)
    free = np.sum(np.abs(pupil.amplitude)) * pupil.scale**2
    expected = math.pi / 4 * 1.5**2 * (1 - 0.09) - 3 * 0.05 * (0.75 - 0.225)
    assert free == pytest.approx(expected, rel=2e-3)
    with pytest.raises(ValueError, match="spider_width must be at least 0 and below half of the aperture, got 1 m"):
        with_spider(1.5, 0.3, 3, 1.0)


def fits_file(data: Any, error: Any = None, **header: Any) -> bytes:
    fits = pytest.importorskip("astropy.io.fits")
    unit = fits.PrimaryHDU(data)
    unit.header.update(header)
    units = [unit] + ([] if error is None else [fits.ImageHDU(error, name="OPD")])
    stream = io.BytesIO()
    fits.HDUList(units).writeto(stream)
    return stream.getvalue()


def test_a_pupil_of_a_file() -> None:
    disc = np.hypot(*np.mgrid[-31.5:32, -31.5:32]) < 30
    content = fits_file(disc.astype(np.float32), PUPLSCAL=1.5 / 60)
    found = Optics(wavelength=550e-9, pixel_mas=38.0, pupil="a.fits", pupil_file=content)
    assert found.aperture.in_phase and found.aperture.extent == pytest.approx(1.5, rel=0.03)
    shift = along_x(np.linspace(0.0, 1.4, 20))
    expected = AnnularPupil(1.5).autocorrelation(shift)
    assert np.abs(found.aperture.autocorrelation(shift) - expected).max() < 0.02
    tilt = 1e-7 * np.arange(64.0)[None, :] * np.ones((64, 1))
    tilted = read_pupil(fits_file(disc.astype(float), tilt, PIXELSCL=0.025), 550e-9)
    assert not tilted.in_phase
    per_pixel = 2 * math.pi * 1e-7 / 550e-9
    one = tilted.autocorrelation(np.array([[0.025, 0.0]]))[0]
    assert np.angle(one) == pytest.approx(per_pixel)


def test_pupils_that_are_none() -> None:
    ones = np.ones((8, 8))
    for content, text in (
        (b"no file", "pupil must be a readable FITS file, got"),
        (fits_file(ones), "metres per pixel as PUPLSCAL or PIXELSCL in its header, got none"),
        (fits_file(ones, PUPLSCAL=-1.0), r"in its header, got -1\.0"),
        (fits_file(ones, PUPLSCAL="wide"), "in its header, got 'wide'"),
        (fits_file(0 * ones, PUPLSCAL=0.1), "pupil must transmit somewhere, got zeros only"),
        (fits_file(-ones, PUPLSCAL=0.1), "pupil must have amplitudes of 0 or more, got -1"),
        (fits_file(np.nan * ones, PUPLSCAL=0.1), "pupil must be finite, got 64 pixels that are not"),
        (fits_file(np.ones((2, 8, 8)), PUPLSCAL=0.1), "pupil must be a picture of real numbers"),
        (fits_file(ones, np.ones((3, 3)), PUPLSCAL=0.1), "OPD must have the shape of the pupil"),
        (fits_file(None), "pupil must be a FITS file with an image, got none"),
    ):
        with pytest.raises(ValueError, match=text) as raised:
            read_pupil(content, 550e-9)
        assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"pixel_mas": -38.0}, r"f: optics.pixel_mas must be above 0 mas, got -38"),
        ({"pixel_mas": math.nan}, "f: optics.pixel_mas must be a finite number above 0 mas, got nan"),
        ({"pixel_mas": "wide"}, "f: optics.pixel_mas must be a number above 0 mas, got 'wide'"),
        ({"obscuration": 1.0}, r"f: optics.obscuration must be at least 0 and below 1, got 1"),
        ({"wavelength": 550.0}, r"f: optics.wavelength must be above 0 and below 1 m, got 550"),
        ({"spider_vanes": 2.5}, r"f: optics.spider_vanes must be a whole number between 0 and 64, got 2\.5"),
        ({"aperture_diameter": True}, "f: optics.aperture_diameter must be a number above 0 m, got True"),
        ({"focus": 1.0}, r"f: unknown parameter 'optics.focus', expected one of: aperture_diameter, "),
        ({"pupil": 3}, r"f: optics.pupil must be a text \(FITS file .*\), got 3"),
        ({"pupil": "p.fits"}, "f: optics.pupil must be a FITS file, got 'p.fits' without its content"),
    ],
)
def test_optics_that_are_none(change: dict[str, Any], text: str) -> None:
    with pytest.raises(InputError, match=text):
        from_mapping({**GOOD, **change}, "f")


def test_files_of_optics(tmp_path: Path) -> None:
    file = tmp_path / "optics.toml"
    file.write_text("[optics]\naperture_diameter = 1.5\nwavelength = 550e-9\npixel_mas = 38\nmirror_distance = 1.5\n")
    table, pupil = load_optics(file)
    assert pupil == b"" and "mirror_distance" not in table
    found = from_mapping(table, "f")
    assert found.text == "aperture 1.5 m, 550 nm, pixel 38 mas"
    assert found.moment_weight == found.resolution == pytest.approx(550e-9 / 1.5)
    for content, text in (
        ("a = 1", r"optics.toml: must hold a table \[optics\]"),
        ("[optics]\nwavelength = 550e-9\n", "optics has no 'pixel_mas'"),
        ("[optics]\nwavelength = 550e-9\npixel_mas = 38.0\n", "optics has no 'aperture_diameter'"),
        ("[optics", "must be TOML"),
        ("[optics]\npupil = 'none.fits'\n", "cannot read the pupil .*none.fits: No such file"),
    ):
        file.write_text(content)
        with pytest.raises(InputError, match=text):
            load_optics(file)
    with pytest.raises(InputError, match="cannot read"):
        load_optics(tmp_path / "none.toml")


def test_a_large_pupil_file_is_refused(tmp_path: Path) -> None:
    with (tmp_path / "p.fits").open("wb") as file:
        file.truncate(PICTURE + 1)  # sparse: nothing is written
    with pytest.raises(InputError, match="larger than 256 MB"):
        optics_module.read_pupil_file(tmp_path / "p.fits")


def test_a_picture_of_any_number_of_pixels_is_refused_before_it_is_unpacked() -> None:
    fits = pytest.importorskip("astropy.io.fits")
    file = io.BytesIO()
    fits.CompImageHDU(np.zeros((50, 50), "float32")).writeto(file)
    large = file.getvalue().replace(b"ZNAXIS1 =                   50", b"ZNAXIS1 =              9999999")
    assert large != file.getvalue()
    with pytest.raises(ValueError, match="pictures must have at most 32000000 pixels together"):
        read_pupil(large, 1e-6)
