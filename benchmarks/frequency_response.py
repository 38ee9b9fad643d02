"""Frequency response of the 204-state telescope beside that of python-control, in one run.

    python benchmarks/frequency_response.py --json

Disturbances (22) and commands (8) to the line of sight, 1000 points refined at the resonances, several parameter
samples. Times are CPU times of one thread. The errors of both are taken against a solution in extended precision at
some of the frequencies, relative to the norm of the block of each pair of ports. `ratio` compares with
python-control as installed: with Slycot it calls SLICOT's TB05AD, else one dense solution for each frequency.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import control
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from oracles.accurate_response import extended_response

from lftkit.analysis.frequency_grid import frequency_grid
from lftkit.analysis.frequency_response import frequency_response
from lftkit.systems.ports import port_slices
from lftkit.systems.system import System
from titop_plant.telescope.assembly import assembled_telescope

INPUTS = ("wheel_imbalance", "sadm_torque", "fsm_command", "pma_force")
OUTPUTS = ("los_controlled",)


CHECKED = 25  # frequencies of each sample at which the errors are taken


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--samples", type=int, default=4, help="parameter samples (default 4)")
    args = parser.parse_args()
    system = assembled_telescope().system[OUTPUTS, INPUTS]
    seconds, errors, points = {"ours": 0.0, "control": 0.0}, {"ours": 0.0, "control": 0.0}, 0
    for values in system.sample_values(np.random.default_rng(0), args.samples):
        data, member = system.at(values), system.at(values).to_control()
        omega = frequency_grid(np.linalg.eigvals(data.A), 1e-2, 1e4)
        points += omega.size
        chosen = np.linspace(0, omega.size - 1, CHECKED).astype(int)
        exact = extended_response(*data.matrices, omega[chosen])
        start = time.process_time()
        ours = frequency_response(data, omega)
        middle = time.process_time()
        theirs = control.frequency_response(member, omega).complex.transpose(2, 0, 1)
        seconds["control"] += time.process_time() - middle
        seconds["ours"] += middle - start
        for name, found in (("ours", ours), ("control", theirs)):
            errors[name] = max(errors[name], largest_error(data, found[chosen], exact))
    result = {
        "ratio": seconds["control"] / seconds["ours"],
        "slycot": control.exception.slycot_check(),
        "ours_error": errors["ours"],
        "control_error": errors["control"],
        "ours_s": seconds["ours"],
        "control_s": seconds["control"],
        "points": points,
        "states": system.order,
    }
    print(json.dumps(result) if args.json else "\n".join(f"{k:>24}  {v:.4g}" for k, v in result.items()))


def largest_error(data: System, found: np.ndarray, exact: np.ndarray) -> float:
    """Largest error of a block of a pair of ports relative to its norm."""
    worst = 0.0
    for rows in port_slices(data.outputs).values():
        for columns in port_slices(data.inputs).values():
            error, size = (
                np.sqrt(np.sum(np.abs(part[:, rows, columns]) ** 2, axis=(1, 2))) for part in (found - exact, exact)
            )
            worst = max(worst, float(np.max(error / size)))
    return worst


if __name__ == "__main__":
    main()
