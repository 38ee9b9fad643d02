"""What no controller of any order can do better on the published plants: one JSON object.

    python benchmarks/full_order_gap.py [--plants AC3,REA1]

For each plant the norm of the full-order H-infinity controller, the numerical and the proven lower bound (null where
there is none), and the processor time of both.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from tuning import plants

from lftkit.synthesis import hinfsyn, lower_bound_proof
from lftkit.tuning.published_plants import PLANTS


def measured(name: str) -> dict[str, Any]:
    """One row."""
    plant, start = plants()[name](), time.process_time()
    found, proven = hinfsyn(plant, "y", "u"), lower_bound_proof(plant, "y", "u")
    bounds = {"lower": found.lower, "proven": proven.level}
    return {
        "plant": name,
        "states": plant.order,
        "full_order": found.value,
        **{key: value if np.isfinite(value) else None for key, value in bounds.items()},
        "cpu_seconds": round(time.process_time() - start, 2),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plants", default=",".join(PLANTS), help="names, separated by commas")
    names = parser.parse_args().plants.split(",")
    if unknown := sorted(set(names) - set(plants())):
        parser.error(f"--plants must be among {', '.join(plants())}, got {', '.join(unknown)}")
    print(json.dumps({"plants": [measured(name) for name in names]}))


if __name__ == "__main__":
    main()
