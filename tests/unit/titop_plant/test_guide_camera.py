"""The guide camera in the model of the loop: low-pass of the exposure, noise of the star, the hash."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from titop_plant.telescope.guide_camera import exposure_low_pass
from titop_plant.telescope.load import load_telescope

REFERENCE = load_telescope()


def user(folder: Path, text: str) -> str:
    file = folder / "user.toml"
    file.write_text(text, "utf-8")
    return str(file)


@pytest.mark.parametrize(("exposure", "delay", "ratio"), [(0.02, 0.0, 16), (0.02, 0.002, 8), (0.005, 0.02, 8)])
def test_the_low_pass_is_the_exposure_up_to_the_second_order(exposure: float, delay: float, ratio: float) -> None:
    """At half of the frequency an eighth of the difference to the exposure; without delay it is one order higher."""
    c0, c1, c2 = exposure_low_pass(exposure, delay)
    omega = np.array([2.0, 1.0]) / (exposure + delay) / 10.0
    s = 1j * omega
    exact = np.exp(-s * delay) * (1.0 - np.exp(-s * exposure)) / (s * exposure)
    error = np.abs(c0 / (s**2 + c1 * s + c2) - exact)
    assert 1e-9 < error[1] < 1e-3
    assert error[0] / error[1] == pytest.approx(ratio, rel=0.05)


def test_the_vector_camera_and_its_designs_are_as_they_were(tmp_path: Path) -> None:
    """The table of the guide camera counts only where low-pass and noise follow from it."""
    own = load_telescope(user(tmp_path, "[camera]\nmagnitude = 9.0\nexposure = 0.01\n"))
    assert own.camera.magnitude == 9.0 and not own.takes_images
    assert own.parameters_hash == REFERENCE.parameters_hash
    assert own.to_mapping()["sensors"] == REFERENCE.to_mapping()["sensors"]


def test_a_star_makes_low_pass_and_noise(tmp_path: Path) -> None:
    values = {}
    for magnitude in (10.0, 12.0, 14.0):
        text = f'[sensors]\ncamera = "magnitude"\n[camera]\nmagnitude = {magnitude}\n'
        values[magnitude] = load_telescope(user(tmp_path, text))
    sensors = [own.to_mapping()["sensors"] for own in values.values()]
    assert all(tuple(s["camera_filter"]) == exposure_low_pass(0.02, 0.002) for s in sensors)
    noise = [s["camera_noise"] for s in sensors]
    # a bright star: the noise of its photons alone, so the root of their number; a faint one has more
    assert noise[1] / noise[0] > 10.0**0.4 and noise[2] / noise[1] > noise[1] / noise[0]
    hashes = {own.parameters_hash for own in values.values()} | {REFERENCE.parameters_hash}
    assert len(hashes) == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[sensors]\ncamera = "film"\n', "line 2: 'sensors.camera' must be vector, magnitude or image, got 'film'"),
        ("[camera]\nwindow = 8\n", "camera.window must be an odd number from 7 to 63, got 8"),
        ("[camera]\nexposure = 0.0205\n", "line 2: 'camera.exposure' must be whole milliseconds, got 0.0205 s"),
        ("[camera]\nexposure = 0.0\n", "line 2: 'camera.exposure' must be whole milliseconds, got 0.0 s"),
        ("[camera]\nreadout_delay = -0.001\n", "camera.readout_delay' must be whole milliseconds, got -0.001 s"),
        ('[sensors]\ncamera = "image"\ncamera_noise = 1e-8\n', "line 3: 'sensors.camera_noise' must be absent"),
        ('[sensors]\ncamera = "image"\n[optics]\npupil = "no.fits"\n', "cannot read the pupil .*no.fits"),
    ],
)
def test_a_camera_that_cannot_be_used_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        load_telescope(user(tmp_path, text))
    assert "\n" not in str(refused.value)
