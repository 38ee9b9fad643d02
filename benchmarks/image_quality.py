"""Time of the transfer function of motion and of the figures of a star's image.

python benchmarks/image_quality.py [--exposures 10000] [--frequencies 64] [--json]
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np

from pointing_analysis.image.motion_blur import motion_transfer, worst_transfer
from pointing_analysis.image.optics import Optics
from pointing_analysis.image.quality import figures
from pointing_analysis.units import RAD_PER_MAS

SEGMENTS = 20
FIGURES = ("strehl", "ee50", "ee80", "ellipticity")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--exposures", type=int, default=10_000)
    parser.add_argument("--frequencies", type=int, default=64)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    rng, optics = (
        np.random.default_rng(0),
        Optics(wavelength=550e-9, pixel_mas=38.0, aperture_diameter=1.5, obscuration=0.3),
    )
    steps = rng.standard_normal((options.exposures, SEGMENTS + 1, 2))
    paths = 2 * RAD_PER_MAS * np.cumsum(steps, axis=1)
    frequencies = optics.cutoff * rng.uniform(-0.7, 0.7, (options.frequencies, 2))
    found = {"exposures": options.exposures, "segments": SEGMENTS, "frequencies": options.frequencies}
    for name, work in (
        ("transfer_cpu_s", lambda: motion_transfer(paths, frequencies)),
        ("worst_direction_cpu_s", lambda: worst_transfer(paths, optics.nyquist)),
        ("figures_cpu_s", lambda: figures(paths, optics, FIGURES)),
    ):
        begin = time.process_time()
        work()
        found[name] = round(time.process_time() - begin, 3)
    print(json.dumps(found) if options.json else "\n".join(f"{key} {value}" for key, value in found.items()))


if __name__ == "__main__":
    main()
