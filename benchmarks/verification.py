"""Processor time of a verification, by its parts, beside that of a plain closing of all channels.

    python benchmarks/verification.py [--points 24] [--json]

- ``closing``: microseconds per point and frequency for the responses of the stage fsm+pma at 300 points: with all 48
  channels one by one, with the 32 that are left, and for many points at once (:mod:`lftkit.analysis.lft_response`).
- ``verify``: seconds of :func:`los_design.verification.verification.check_implemented` for the stored pair at some of
  the verification's points: stability by eigenvalues and the grid grow with their number, the rest hardly.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
from processor_time import least
from threadpoolctl import threadpool_limits

from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.lft_response import LftResponse
from los_design.search.worst_points import load_adversarial
from los_design.synthesis.store import load_designs
from los_design.verification.verification import check_implemented, verification_points
from los_loop.implemented_loop import ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope

CLOSED, OMEGA = 300, 80.0


def closing(open_loop: OpenLoop) -> dict[str, float]:
    """Microseconds per point and frequency."""
    loop, system = ImplementedLoop(open_loop, *load_designs("implemented"), "fsm+pma"), open_loop.system
    points = np.random.default_rng(0).uniform(size=(CLOSED, len(open_loop.names)))
    at = loop.at(OMEGA)
    q, p, m = len(system.channels), *at.lft.T11.shape
    G = FrequencyResponse.of(system.A, system.B, system.C, system.D).at([OMEGA])[0]
    rng = np.random.default_rng(1)
    all_channels = LftResponse(G[:q, :q], rng.normal(size=(p, q)) + 0j, rng.normal(size=(q, m)) + 0j, at.lft.T11)
    places = [open_loop.names.index(name) for name in system.channels]
    values = open_loop.low + points * open_loop.width - open_loop.nominal
    delta = loop.delta(points)
    times = {
        "all_channels_us": least(lambda: all_channels.closed(values[:, places].astype(complex))),
        "kept_channels_us": least(lambda: at.lft.closed(delta)),
        "many_points_us": least(lambda: at.lft.closed(delta, open_loop.angle)),
    }
    found = {name: 1e6 * seconds / CLOSED for name, seconds in times.items()}
    return found | {"ratio": found["all_channels_us"] / found["many_points_us"]}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=24)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.points < 1:
        parser.error(f"--points must be at least 1, got {options.points}")
    telescope = load_telescope()
    with threadpool_limits(1):
        system = control_loop_plant(telescope)
        at = verification_points(telescope, system, 200) + load_adversarial()
        at = at[:: max(1, len(at) // options.points)][: options.points]
        begin = time.process_time()
        check = check_implemented(system, telescope, *load_designs("implemented"), at)
        seconds = time.process_time() - begin
        result: dict[str, Any] = {
            "closing": {
                k: round(v, 2) for k, v in closing(OpenLoop(system, telescope, telescope.loop_ports.used_by())).items()
            },
            "verify": {"points": check.count, "stable": check.stable, "cpu_s": round(seconds, 2)},
        }
    print(json.dumps(result) if options.json else json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
