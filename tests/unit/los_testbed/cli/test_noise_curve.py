"""The measured noise of a guide camera: Monte Carlo, file, interpolation, and the camera of the loop that has it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from los_testbed.cli.app import main

from pointing_analysis.image.centroid import noise_equivalent_angle
from pointing_analysis.image.noise_curve import NoiseCurve, NoisePoint, curve_for, load_curves, measure
from pointing_analysis.image.star_camera import StarCamera
from pointing_analysis.units import RAD_PER_MAS
from titop_plant.telescope.guide_camera import STORED_CURVES, star_camera
from titop_plant.telescope.load import load_telescope

REFERENCE = load_telescope()
STAR = star_camera(REFERENCE.image_optics, REFERENCE.camera, "reference.toml")


def user(folder: Path, camera: str = "", optics: str = "") -> Path:
    file = folder / "user.toml"
    file.write_text(f'[sensors]\ncamera = "magnitude"\n[camera]\n{camera}\n[optics]\n{optics}\n', "utf-8")
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


def test_the_camera_of_the_loop_has_the_measured_noise(tmp_path: Path) -> None:
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


def test_a_command_measures_the_curve_of_another_detector(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Moments: their bias makes them several times as bad as the bound for a bright star."""
    monkeypatch.setenv("COLUMNS", "160")
    text = 'centroid = "moments"\nmagnitude = 11.3'
    file, stored = user(tmp_path, text), tmp_path / "mine.json"
    arguments = ["--parameters", str(file), "--magnitudes", "11,12,25", "--frames", "200", "--output", str(stored)]
    main(["image", "noise", *arguments, "--json"])
    told = capsys.readouterr()
    printed = json.loads(told.out.splitlines()[-1])
    assert [line.split()[3] for line in told.err.splitlines() if line.startswith("│")] == ["11", "12", "25"]
    (curve,) = printed["curves"]
    assert curve["magnitude"] == [11.0, 12.0] and printed["frames"] == 200  # nobody sees the last one
    assert curve["noise_mas"][0] > 1.5 * curve["bound_mas"][0]
    assert json.loads(stored.read_text())["curves"] == printed["curves"]
    found = noise_of(user(tmp_path, text + '\nnoise_curve = "mine.json"'))
    assert min(curve["noise_mas"]) < found / RAD_PER_MAS < max(curve["noise_mas"])
    assert found > 1.5 * noise_of(user(tmp_path, text))


CURVE = NoiseCurve.of(STAR, [NoisePoint(m, 1e-8, 1e-8, 0.0) for m in (12.0, 13.0)]).to_mapping()


@pytest.mark.parametrize(
    ("content", "camera", "message"),
    [
        (None, "", "cannot read .*curve.json: No such file"),
        ('{"curves": [{"detector": {}}]}', "", "must hold curves of `los-testbed image noise`, got no magnitude"),
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
