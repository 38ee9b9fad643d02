"""Evaluate a bag against user-defined requirements; where the data are too few, print how long a run must be.

python examples/pointing_verdict.py [BAG ...]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.verdict import judge, parse

REQUIREMENTS = [
    parse("prob(|RPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence"),
    parse("prob(|RPE(20 ms)| < 40 mas) >= 0.95 at 95 % confidence"),
    parse("prob(|APE_x| < 0.1 arcsec) >= 0.99 at 90 % confidence"),
    parse("prob(|PDE(20 ms, 1 s)| < 30 mas) >= 0.95 at 95 % confidence"),
]

with tempfile.TemporaryDirectory() as folder:
    bags = [Path(argument) for argument in sys.argv[1:]]
    if not bags:  # ten seconds of white jitter: too short for 99.7 %
        los = 8 * RAD_PER_MAS * np.random.default_rng(0).standard_normal((11_000, 2))
        bags = [write_bag(Path(folder) / "bag", {"truth/los": los})]
    runs = [Run.open(bag) for bag in bags]
    for requirement in REQUIREMENTS:
        verdict = judge(requirement, runs)
        q, scale, unit = verdict.quantile, requirement.scale, requirement.unit
        print(requirement)
        print(f"    {verdict.status}: quantile {q.value / scale:.3g} {unit}, at most {q.upper / scale:.3g} {unit}")
        if verdict.status == "not enough data":
            print(f"    {verdict.seconds:g} s recorded, {verdict.seconds_needed:.1f} s would decide")
