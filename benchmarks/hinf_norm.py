"""H-infinity norms of the telescope's loops at many parameter values, beside SLICOT's AB13DD (Slycot, if installed).

    python benchmarks/hinf_norm.py [--samples 40] [--json]

The closed loop of the reference telescope with the stored K_FSM and K_PMA, as implemented, with the delay as a Padé
approximation, from normalised disturbances (22) through their weight to the relative error (2): about 320 states. Every
sample has other parameters. Both sides get the same tolerance and one thread; times are CPU times. Slycot is optional:
``pip install slycot`` (its wrapper is GPL-2, so it is no dependency of the project). Systems of other orders:
``python -m lftkit.benchmarks norms``.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
from threadpoolctl import threadpool_limits

from lftkit.analysis.norms import hinf_norms
from lftkit.benchmarks.norms import RTOL, slycot_norms


def telescope_loops(samples: int) -> list[tuple[np.ndarray, ...]]:
    """(A, B, C, D) of the closed and weighted loop, nominal and random parameters."""
    from fsm_pma_controller.problem import MEASURED_NAMES, actuator_plant
    from lftkit import System
    from lftkit.tuning.requirements.assembled_loop import AssembledLoop
    from los_design.synthesis.options import DesignOptions
    from los_design.synthesis.state_space_requirements import implemented_requirements
    from los_design.synthesis.store import continuous, load_designs
    from titop_plant.telescope.load import load_telescope

    telescope = load_telescope()
    k_fsm, k_pma = load_designs("implemented")
    options = DesignOptions()
    plant = actuator_plant(telescope, continuous(k_fsm), loop_delay=options.delay, **options.hold_delays)
    data = continuous(k_pma).at({})
    ports = tuple(plant.system.output_port(name) for name in MEASURED_NAMES)
    law = System(data.A, data.B, data.C, data.D, ports, data.outputs, "K_PMA")
    requirement = next(r for r in implemented_requirements(telescope, "fsm+pma") if r.name == "fast")
    points = [{}, *plant.system.sample_values(np.random.default_rng(0), samples - 1)]
    return [requirement.weighted(AssembledLoop(plant(values), law, options.delay)).matrices for values in points]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    systems = telescope_loops(arguments.samples)
    with threadpool_limits(1):
        hinf_norms(systems[:1], rtol=RTOL)
        start_time = time.process_time()
        ours = hinf_norms(systems, rtol=RTOL)
        seconds = time.process_time() - start_time
        start_time = time.process_time()
        reference = slycot_norms(systems)
        slycot_seconds = time.process_time() - start_time
    result: dict[str, object] = {
        "states": len(systems[0][0]),
        "samples": arguments.samples,
        "rtol": RTOL,
        "seconds_per_norm": seconds / len(systems),
        "certificates": sorted({n.certificate for n in ours}),
        "ratio": None,
        "relative_difference": None,
    }
    if reference is not None:
        result["slycot_seconds_per_norm"] = slycot_seconds / len(systems)
        result["ratio"] = slycot_seconds / seconds
        result["relative_difference"] = max(abs(n.value / r - 1) for n, r in zip(ours, reference))
    if arguments.json:
        print(json.dumps(result))
    else:
        for key, value in result.items():
            print(f"{key:26s} {value}")
        if reference is None:
            print("slycot is not installed: no comparison")


if __name__ == "__main__":
    main()
