"""Noise of a telescope's guide camera over the magnitude of its star, as the file of `camera.noise_curve`.

python examples/guide_camera_noise.py [--parameters telescope.toml] [--magnitudes 10,12,14] [--frames 10000]
    [--exposures 0.02,0.04] [--seed 1] [--output noise.json]

Each frame shows a star at rest at a random place within a pixel. Stars that fewer than half of the frames see are left
out. The curve of titop_plant/telescope/camera_noise.json is that of the reference, for 0.02 and 0.04 s.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from pointing_analysis.image.noise_curve import NoiseCurve, measure, to_text
from pointing_analysis.units import RAD_PER_MAS
from titop_plant.telescope.guide_camera import star_camera
from titop_plant.telescope.load import REFERENCE, load_telescope


def numbers(text: str) -> list[float]:
    return [float(word) for word in text.split(",")]


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--parameters", type=Path, default=REFERENCE)
parser.add_argument("--magnitudes", type=numbers, default=[10.0, 12.0, 14.0])
parser.add_argument("--exposures", type=numbers, help="[s]; default: that of the telescope")
parser.add_argument("--frames", type=int, default=1000)
parser.add_argument("--seed", type=int, default=1)
parser.add_argument("--output", type=Path)
asked = parser.parse_args()

telescope, curves = load_telescope(asked.parameters), []
for exposure in asked.exposures or [telescope.camera.exposure]:
    cameras = [
        star_camera(
            telescope.image_optics,
            replace(telescope.camera, magnitude=magnitude, exposure=exposure),
            str(asked.parameters),
        )
        for magnitude in sorted(asked.magnitudes)
    ]
    points = [measure(camera, asked.frames, asked.seed) for camera in cameras]
    for point in points:
        mas = f"{point.noise / RAD_PER_MAS:.3f} mas (Cramer-Rao bound {point.bound / RAD_PER_MAS:.3f})"
        print(
            f"{1e3 * exposure:g} ms, magnitude {point.magnitude:g}: {mas}, {100 * point.without:.1f} % without angles"
        )
    curves.append(NoiseCurve.of(cameras[0], points))
if asked.output:
    asked.output.write_text(to_text(curves, {"frames": asked.frames, "seed": asked.seed}), "utf-8")
