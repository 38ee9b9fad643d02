"""Several bags side by side in one report, for instance the four loop stages.

python examples/compare_stages.py BAG BAG ... [--output report.html]
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.report.report import write_report
from pointing_analysis.requirements.summary import summarise

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("bags", nargs="*", type=Path)
parser.add_argument("--output", type=Path)
arguments = parser.parse_args()

with tempfile.TemporaryDirectory() as folder:
    bags = arguments.bags
    if not bags:  # two stages of a synthetic telescope
        t = 1e-3 * np.arange(6000)
        for loop, scale in (("isolator", 150.0), ("fsm", 20.0)):
            los = scale * RAD_PER_MAS * np.column_stack([np.sin(88 * t), np.cos(88 * t)])
            parameters = {"loop": loop, "tones_rad_s": [88.0]}
            bags.append(write_bag(Path(folder) / loop, {"truth/los": los}, parameters=parameters))
    runs = [Run.open(bag) for bag in bags]
    for run in runs:
        s = summarise(run)
        relative = f"RPE rms {s.rpe_rms:.3g}, {100 * s.probabilities.rpe:g} % {s.rpe_quantile:.3g} mas"
        print(f"{run.title:10s} APE max {s.ape_max:.3g} arcsec, {relative}")
    page = write_report(runs, arguments.output or Path(folder) / "report.html")
    print(
        f"report of {page.stat().st_size // 1000} kB"
        + (f": {page}" if arguments.output else " (give --output to keep it)")
    )
