"""Sources of jitter: spectrum, cumulative RMS and the contribution of each disturbance line.

python examples/pointing_spectrum.py [BAG]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from pointing_analysis.indices import metrics, weights
from pointing_analysis.indices.errors import RAD_PER_MAS, performance_error
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.spectra import spectra

WINDOW = 0.02
with tempfile.TemporaryDirectory() as folder:
    if len(sys.argv) > 1:
        bag = Path(sys.argv[1])
    else:
        t = 1e-3 * np.arange(20_000)
        jitter = np.column_stack([60 * np.sin(88 * t) + 25 * np.sin(210 * t), 40 * np.cos(88 * t)])
        jitter += 5 * np.random.default_rng(0).standard_normal((20_000, 2))
        parameters = {"tones_rad_s": [88.0, 210.0, 520.0]}
        bag = write_bag(Path(folder) / "bag", {"truth/los": RAD_PER_MAS * jitter}, parameters=parameters)

    run = Run.open(bag)
    error = performance_error(run)
    spectrum = spectra.psd(error.values, error.dt)
    weight = weights.rpe_exact(2 * np.pi * spectrum.frequency, WINDOW)
    direct = np.hypot(*metrics.rpe_rms(error.values, error.dt, WINDOW))
    through = spectrum.cumulative_rms(weight)[-1]
    print(
        f"RPE rms in windows of 20 ms: {direct / RAD_PER_MAS:.2f} mas; {through / RAD_PER_MAS:.2f} mas by the spectrum"
    )
    lines = spectra.lines(error.values, error.dt, run.parameters.get("tones_rad_s", []), WINDOW)
    for line in lines:
        rms, rpe = line.rms / RAD_PER_MAS, line.rpe / RAD_PER_MAS
        print(f"{line.omega:8.1f} rad/s: {rms:7.2f} mas rms, {rpe:7.2f} mas in the RPE")
    rest = np.sqrt(max(direct**2 - sum(line.rpe**2 for line in lines), 0))
    print(f"everything else: {rest / RAD_PER_MAS:.2f} mas in the RPE")
