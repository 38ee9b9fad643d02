"""Frequency response of the 204-state telescope: ours against python-control's, in one run.

    python benchmarks/frequency_response.py --json

Disturbances (22) and commands (8) to the line of sight and the accelerometers of the platform, 1000 points refined
at the resonances, several parameter samples. The difference is relative to the norm of the block of each pair of ports
at each frequency; paths that cancel to less than 1e-9 of their largest gain are left out (they have no digits in
either).
"""

from __future__ import annotations

import argparse
import json
import os
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import control
import numpy as np

from lti.frequency_grid import frequency_grid
from lti.frequency_response import frequency_response
from lti.ports import port_slices
from titop_plant.simulation import telescope

INPUTS = ("wheel_imbalance", "sadm_torque", "fsm_command", "pma_force")
OUTPUTS = ("los_controlled",)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--samples", type=int, default=4, help="parameter samples (default 4)")
    args = parser.parse_args()
    system = telescope().system[OUTPUTS, INPUTS]
    ours_s = control_s = difference = 0.0
    points = 0
    for values in system.sample_values(np.random.default_rng(0), args.samples):
        data, member = system.data_at(values), system.at(values)
        omega = frequency_grid(np.linalg.eigvals(data.A), 1e-2, 1e4)
        points += omega.size
        start = time.perf_counter()
        ours = frequency_response(data, omega)
        ours_s += time.perf_counter() - start
        start = time.perf_counter()
        theirs = control.frequency_response(member, omega).complex.transpose(2, 0, 1)
        control_s += time.perf_counter() - start
        difference = max(difference, largest_difference(data, ours, theirs))
    result = {
        "ratio": control_s / ours_s,
        "max_relative_difference": difference,
        "ours_s": ours_s,
        "control_s": control_s,
        "points": points,
        "states": system.order,
    }
    print(json.dumps(result) if args.json else "\n".join(f"{k:>24}  {v:.4g}" for k, v in result.items()))


def largest_difference(data, ours: np.ndarray, theirs: np.ndarray) -> float:
    worst = 0.0
    for rows in port_slices(data.outputs).values():
        for columns in port_slices(data.inputs).values():
            error, size = (
                np.sqrt(np.sum(np.abs(part[:, rows, columns]) ** 2, axis=(1, 2))) for part in (ours - theirs, theirs)
            )
            loud = size > 1e-9 * size.max()
            worst = max(worst, float(np.max(error[loud] / size[loud])))
    return worst


if __name__ == "__main__":
    main()
