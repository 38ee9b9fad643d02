"""Optics and guide cameras on the command line: verdicts, pictures, kernels, paths, measured noise; mistakes."""

from __future__ import annotations

import json
import math
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli.app import main
from support.command_line import refused

from pointing_analysis.image.centroid import noise_equivalent_angle
from pointing_analysis.image.export import kernel
from pointing_analysis.image.motion_blur import motion_transfer
from pointing_analysis.image.noise_curve import NoiseCurve, NoisePoint, curve_for, load_curves, measure
from pointing_analysis.image.optics import with_optics
from pointing_analysis.image.star_camera import StarCamera
from pointing_analysis.read.series import series
from pointing_analysis.report.image_figures import draw_pictures, image_views, siemens_star, stars
from pointing_analysis.report.report import view
from pointing_analysis.units import RAD_PER_MAS
from titop_plant.telescope.guide_camera import STORED_CURVES, star_camera
from titop_plant.telescope.load import load_telescope

MAS, ROOT = RAD_PER_MAS, Path(__file__).parents[4]
TABLE = {"aperture_diameter": 1.5, "obscuration": 0.3, "wavelength": 550e-9, "pixel_mas": 38.0}
OPTICS = "[optics]\naperture_diameter = 1.5\nobscuration = 0.3\nwavelength = 550e-9\npixel_mas = 38.0\n"
MISSION = """
[[requirement]]
text = "prob(MTF(20 ms, Nyquist) > 0.90) >= 0.9 at 95 % confidence"
[[requirement]]
text = "prob(EE80(20 ms) < 140 mas) >= 0.9 at 95 % confidence"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two seconds of noise of 3 mas as CSV, optics and requirements."""
    los = 3.0 * np.random.default_rng(0).standard_normal((2001, 2))
    rows = "".join(f"{k / 1000:.3f},{x:.6f},{y:.6f}\n" for k, (x, y) in enumerate(los.tolist()))
    (tmp_path / "los.csv").write_text(f"t,x,y\n{rows}")
    (tmp_path / "optics.toml").write_text(OPTICS)
    (tmp_path / "mission.toml").write_text(MISSION)
    return tmp_path


def source(folder: Path) -> list[str]:
    return [str(folder / "los.csv"), "--los", "x,y", "--unit", "mas", "--transient", "0"]


@pytest.mark.further
def test_from_samples_and_optics_to_a_verdict(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = folder / "page.html"
    options = ["--optics", str(folder / "optics.toml"), "--requirements", str(folder / "mission.toml")]
    main(["analyse", *source(folder), *options, "--output", str(page), "--json"])
    found = capsys.readouterr()
    content = json.loads(found.out.splitlines()[-1])
    first, second = content["requirements"]
    assert first["status"] == second["status"] == "compliant" and first["unit"] == ""
    assert first["quantity"] == "MTF(20 ms, Nyquist), 90 %" and first["lower_bound"] < first["quantile"] < 1.0
    assert content["image"]["exposures"] == 100 and 0.9 < content["image"]["strehl_p9"] < 1.0
    assert "bound" in found.err and "upper bound" not in found.err and "above 0.9" in found.err
    text = page.read_text()
    for name in ("star", "target", "mtf", "energy", "ellipticity"):
        assert f'<figure id="{name}">' in text
    assert 'data-label="Bound"' in text and "MTF(20 ms, Nyquist)" in text


def test_the_exposure_that_is_shown() -> None:
    """One exposure in 500 is bad: it is not shown; three in 500 are: the best of these is."""
    los = np.zeros((10_001, 2))
    los[21:39, 0] = 40.0 * np.linspace(-1, 1, 18)
    (one,), _ = image_views([view(with_optics(series(None, los, unit="mas", rate=1000.0), TABLE), "bench", 0.0)])
    assert one.shown_strehl == pytest.approx(1.0, abs=1e-9)
    los[2021:2039, 0] = 20.0 * np.linspace(-1, 1, 18)
    (three,), _ = image_views([view(with_optics(series(None, los, unit="mas", rate=1000.0), TABLE), "bench", 0.0)])
    assert three.shown_strehl == sorted(three.strehl)[1] < 0.99
    found = stars([three])
    assert found is not None and three.strehl_text in found.alt
    assert siemens_star().min() == 0.0 and 0.2 < siemens_star().mean() < 0.4


def test_a_kernel_has_the_transfer_of_the_motion() -> None:
    """To second order in the step; mean in the middle, sum 1."""
    paths = np.cumsum(np.random.default_rng(1).standard_normal((3, 21, 2)), axis=1) * 4 * MAS
    found, step = kernel(paths, 1 * MAS), 1 * MAS
    line = step * (np.arange(len(found)) - len(found) // 2)
    assert found.sum() == pytest.approx(1.0) and len(found) % 2 == 1
    assert abs(found.sum(axis=0) @ line) < 1e-3 * step and abs(found.sum(axis=1) @ line) < 1e-3 * step
    from pointing_analysis.image.motion_blur import centred

    for f in ([1e6, 0.0], [-5e5, 8e5]):
        wave = np.exp(-2j * np.pi * (f[0] * line[None, :] + f[1] * line[:, None]))
        expected = motion_transfer(centred(paths), np.array([f])).mean()
        assert abs(np.sum(found * wave) - expected) < 2e-3


@pytest.mark.further
def test_exports(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fits: Any = pytest.importorskip("astropy.io.fits")
    options = source(folder)
    main(["image", "export", *options, "--output", str(folder / "k.fits"), "--exposure", "0.02", "--json"])
    content = json.loads(capsys.readouterr().out.splitlines()[-1])
    with fits.open(folder / "k.fits") as file:
        header, picture = file[0].header, np.array(file[0].data)
    assert picture.shape == (content["places"],) * 2 and picture.sum() == pytest.approx(1.0)
    assert header["PIXELSCL"] == pytest.approx(1e-3) and header["EXPTIME"] == pytest.approx(0.02)
    assert (header["NEXPOS"], header["ORIGFILE"]) == (100, "los.csv")
    main(["image", "export", *options, "--output", str(folder / "p.csv"), "--exposure", "0.02", "--number", "7"])
    rows = np.genfromtxt(folder / "p.csv", delimiter=",", skip_header=2)
    los = np.genfromtxt(folder / "los.csv", delimiter=",", skip_header=1)
    assert rows.shape == (21, 3) and np.allclose(rows[:, 1:] * 1000, los[140:161, 1:], atol=1e-5)
    assert rows[0, 0] == pytest.approx(0.14)
    main(["image", "export", *options, "--output", str(folder / "p.fits"), "--path"])
    with fits.open(folder / "p.fits") as file:
        table = file[1]
        assert len(table.data) == 2001 and table.columns.units == ["s", "arcsec", "arcsec"]
    poppy_kernel = picture[::-1, ::-1]
    assert np.allclose(np.abs(np.fft.fft2(poppy_kernel)), np.abs(np.fft.fft2(picture)))


@pytest.mark.parametrize(
    ("arguments", "optics", "message"),
    [
        (["analyse"], OPTICS.replace("38.0", "-38.0"), "optics.pixel_mas must be above 0 mas, got -38"),
        (["analyse"], "[telescope]\na = 1\n", "must hold a table [optics]"),
        (["analyse"], OPTICS + 'pupil = "zeros.fits"\n', "pupil must transmit somewhere, got zeros only"),
        (["analyse", "--requirements", "long.toml"], OPTICS, "los.csv: exposure must be at most the"),
        (["image", "export", "--output", "k.fits", "--exposure", "5"], None, "must last for one exposure of 5 s"),
        (["image", "export", "--output", "k.txt"], None, "--output must end in .fits or .csv, got k.txt"),
        (
            ["image", "export", "--output", "k.csv", "--exposure", "0.02", "--number", "400"],
            None,
            "number of the exposure must be from 0 to 99, got 400",
        ),
    ],
)
def test_mistakes(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    optics: str | None,
    message: str,
) -> None:
    monkeypatch.chdir(folder)
    text = "prob(MTF(30 s, Nyquist) > 0.9) >= 0.997 at 95 % confidence"
    Path("long.toml").write_text(f'requirement = [{{ text = "{text}" }}]\n')
    options = []
    if optics is not None:
        if "fits" in optics:
            fits: Any = pytest.importorskip("astropy.io.fits")
            bare = fits.PrimaryHDU(np.zeros((8, 8)))
            bare.writeto("bare.fits")
            bare.header["PUPLSCAL"] = 0.1
            bare.writeto("zeros.fits")
        Path("optics.toml").write_text(optics)
        options = ["--optics", "optics.toml"]
    words = 2 if arguments[0] == "image" else 1
    assert message in refused(capsys, *arguments[:words], *source(folder), *arguments[words:], *options)
    assert not Path("new").exists() and not Path("k.fits").exists() and not Path("k.csv").exists()


def test_pictures_are_refused_by_what_is_wrong_with_the_run(tmp_path: Path) -> None:
    """The optics are named and the run is long enough, but 20 ms are 20.48 samples."""
    run = with_optics(series(None, np.zeros((3000, 2)), unit="mas", rate=1024.0), TABLE)
    with pytest.raises(ValueError, match=r"window must be a whole number .* got 20 ms"):
        draw_pictures([view(run, "bench", 0.0)], tmp_path)


REFERENCE = load_telescope()

STAR = star_camera(REFERENCE.image_optics, REFERENCE.camera, "reference.toml")


def user(folder: Path, camera: str = "", optics: str = "") -> Path:
    file = folder / "user.toml"
    file.write_text(
        f'base = "reference"\n[sensors]\ncamera = "magnitude"\n[camera]\n{camera}\n[optics]\n{optics}\n', "utf-8"
    )
    return file


def noise_of(file: Path) -> float:
    return load_telescope(file).camera_noise


@pytest.mark.parametrize(("magnitude", "exposure"), [(9.25, 0.02), (14.75, 0.04)])
def test_between_measured_stars_the_curve_is_what_is_measured_there(magnitude: float, exposure: float) -> None:
    """Other random numbers than those of the stored curve; four standard errors of both."""
    camera = StarCamera(STAR.optics, replace(STAR.camera, magnitude=magnitude, exposure=exposure))
    curve = curve_for(camera, load_curves(STORED_CURVES))
    assert curve is not None and curve.covers(magnitude) and magnitude not in curve.magnitude
    point = measure(camera, 1500, seed=2)
    error = math.sqrt(0.5 / 2.0 / 1500 / (1.0 - point.without) + 0.5 / 2.0 / 10_000)
    assert point.noise == pytest.approx(curve.at(camera), rel=4.0 * error)


def test_the_camera_of_the_loop_has_the_measure(tmp_path: Path) -> None:
    (curve,) = (c for c in load_curves(STORED_CURVES) if c.detector["exposure"] == 0.02)
    k = int(np.argmin(np.abs(curve.magnitude - 15.0)))
    assert noise_of(user(tmp_path, "magnitude = 15.0")) == pytest.approx(curve.noise[k], rel=1e-6)
    assert curve.noise[k] > 1.02 * curve.bound[k]
    late = noise_of(user(tmp_path, "magnitude = 15.0\nreadout_delay = 0.005"))
    assert late == pytest.approx(curve.noise[k], rel=1e-6)


@pytest.mark.parametrize("changed", ["magnitude = 17.0", "read_noise = 4.0", 'centroid = "moments"', "exposure = 0.01"])
def test_without_a_curve_it_is_the_bound(changed: str, tmp_path: Path) -> None:
    file = user(tmp_path, changed)
    own = load_telescope(file)
    assert noise_of(file) == noise_equivalent_angle(star_camera(own.image_optics, own.camera, str(file)))


def test_the_example_measures_the_curve_of_another_detector(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Moments: their bias makes them several times as bad as the bound for a bright star."""
    text = 'centroid = "moments"\nmagnitude = 11.3'
    file, stored = user(tmp_path, text), tmp_path / "mine.json"
    arguments = ["--parameters", str(file), "--magnitudes", "11,12,25", "--frames", "200", "--output", str(stored)]
    monkeypatch.setattr(sys, "argv", ["guide_camera_noise.py", *arguments])
    runpy.run_path(str(ROOT / "examples/guide_camera_noise.py"), run_name="__main__")
    (curve,) = json.loads(stored.read_text())["curves"]
    assert curve["magnitude"] == [11.0, 12.0]  # nobody sees the last one
    assert curve["noise_mas"][0] > 1.5 * curve["bound_mas"][0]
    found = noise_of(user(tmp_path, text + '\nnoise_curve = "mine.json"'))
    assert min(curve["noise_mas"]) < found / RAD_PER_MAS < max(curve["noise_mas"])
    assert found > 1.5 * noise_of(user(tmp_path, text))


CURVE = NoiseCurve.of(STAR, [NoisePoint(m, 1e-8, 1e-8, 0.0) for m in (12.0, 13.0)]).to_mapping()


@pytest.mark.parametrize(
    ("content", "camera", "message"),
    [
        (None, "", "cannot read .*curve.json: No such file"),
        ('{"curves": [{"detector": {}}]}', "", "must hold curves of examples/guide_camera_noise.py, got no magnitude"),
        (json.dumps({"curves": [{**CURVE, "noise_mas": [1.0, -1.0]}]}), "", "a noise that is not positive"),
        (json.dumps({"curves": [{**CURVE, "magnitude": [13.0, 12.0]}]}), "", "magnitudes that do not increase"),
        (json.dumps({"curves": [CURVE]}), "dark = 3.0", "noise_curve must have a curve of this detector, got none in"),
    ],
)
def test_a_curve_that_cannot_be_used_is_refused_in_one_line(
    content: str | None, camera: str, message: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / "curve.json").write_text(content, "utf-8")
    with pytest.raises(ValueError, match=message) as refused:
        load_telescope(user(tmp_path, f'noise_curve = "curve.json"\n{camera}'))
    assert "\n" not in str(refused.value)
