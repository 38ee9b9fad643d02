"""Open a bag and list its content: topics, rates, units, gaps.

python examples/read_bag.py [BAG]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run

with tempfile.TemporaryDirectory() as folder:
    if len(sys.argv) > 1:
        bag = Path(sys.argv[1])
    else:  # a small bag with two missing samples and a dropped camera frame
        rng = np.random.default_rng(0)
        stamps = np.delete(10**9 + 10**6 * np.arange(1000), [400, 401])
        camera = rng.standard_normal((50, 2))
        camera[7] = np.nan
        signals = {"truth/los": 1e-7 * rng.standard_normal((998, 2)), "camera/los": camera}
        bag = write_bag(Path(folder) / "bag", signals, periods={"camera/los": 20}, stamps={"truth/los": stamps})

    run = Run.open(bag)
    print(run)
    for problem in run.problems:
        print("note:", problem)
    for name in run.topics:
        topic = run[name]
        state = topic.integrity
        print(
            f"{name:18s} {len(topic):7d} samples  every {1e3 * topic.period:g} ms  [{topic.unit}]  "
            f"{state.missing} missing, {state.duplicates} twice, {state.nan} with NaN"
        )
        for start, missing in state.gaps[:3]:
            print(f"{'':18s} gap of {missing} samples after {start:.3f} s")
