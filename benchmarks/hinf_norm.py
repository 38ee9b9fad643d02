"""H-infinity norms of lightly damped loops at many parameter values, beside SLICOT's AB13DD (Slycot, if installed).

    python benchmarks/hinf_norm.py [--case telescope|structure|small] [--samples 40] [--json]

``telescope`` is the closed loop of the reference telescope with the stored K_FSM and K_PMA, as implemented, with the
delay as a Padé approximation, from normalised disturbances (22) through their weight to the relative error (2): about
320 states. ``structure`` is synthetic: modes from 0.1 to 2000 rad/s with damping 0.001 to 0.02 in coordinates that mix
all modes. ``small`` is a table of random systems of 1 to 12 states with two inputs and outputs, in continuous and in
discrete time: the time of ``hinf_norm`` in times of AB13DD, median of three runs. Every sample has other parameters.
Both sides get the same tolerance and one thread; times are CPU times. Slycot is optional: ``pip install slycot`` (its
wrapper is GPL-2, so it is no dependency of the project).
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
from threadpoolctl import threadpool_limits

from lftkit.analysis.norms import hinf_norm, hinf_norms

RTOL = 1e-6


def structure(sample: int, modes: int) -> tuple[np.ndarray, ...]:
    """(A, B, C, D) of one parameter sample."""
    rng = np.random.default_rng(0)
    w, zeta = np.sort(10 ** rng.uniform(-1, 3.3, modes)), 10 ** rng.uniform(-3, -1.7, modes)
    w = w * (1 + 0.2 * np.random.default_rng(sample + 1).uniform(-1, 1, modes))
    A = np.zeros((2 * modes, 2 * modes))
    i = np.arange(modes)
    A[2 * i, 2 * i + 1], A[2 * i + 1, 2 * i], A[2 * i + 1, 2 * i + 1] = w, -w, -2 * zeta * w
    B, C = np.zeros((2 * modes, 22)), np.zeros((2, 2 * modes))
    B[1::2], C[:, ::2] = rng.normal(size=(modes, 22)), rng.normal(size=(2, modes)) / w
    T = np.eye(2 * modes) + 0.2 * rng.normal(size=A.shape) / np.sqrt(2 * modes)
    inverse = np.linalg.inv(T)
    return T @ A @ inverse, T @ B, C @ inverse, np.zeros((2, 22))


def telescope_loops(samples: int) -> list[tuple[np.ndarray, ...]]:
    """(A, B, C, D) of the closed and weighted loop, nominal and random parameters."""
    from fsm_pma_controller.problem import MEASUREMENTS, actuator_plant
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
    ports = tuple(plant.system.output_port(name) for name in MEASUREMENTS)
    law = System(data.A, data.B, data.C, data.D, ports, data.outputs, "K_PMA")
    requirement = next(r for r in implemented_requirements(telescope, "fsm+pma") if r.name == "fast")
    points = [{}, *plant.system.sample_values(np.random.default_rng(0), samples - 1)]
    return [requirement.weighted(AssembledLoop(plant(values), law, options.delay)).matrices for values in points]


def random_system(rng: np.random.Generator, states: int, discrete: bool) -> tuple[np.ndarray, ...]:
    """(A, B, C, D): slowest decay 0.01 to 1 rad/s, or largest pole 0.5 to 0.999; every second one without D."""
    A = rng.normal(size=(states, states))
    poles = np.linalg.eigvals(A)
    if discrete:
        A *= (1.0 - 10.0 ** rng.uniform(-3.0, -0.3)) / np.abs(poles).max()
    else:
        A -= (poles.real.max() + 10.0 ** rng.uniform(-2.0, 0.0)) * np.eye(states)
    return A, rng.normal(size=(states, 2)), rng.normal(size=(2, states)), rng.integers(0, 2) * rng.normal(size=(2, 2))


def small(samples: int) -> list[dict[str, object]]:
    """Mean CPU time of a norm and its ratio to AB13DD's, for systems of few states."""
    rng, rows = np.random.default_rng(0), []
    for dt in (None, 1.0):
        for states in (1, 2, 3, 4, 6, 8, 10, 12):
            systems = [random_system(rng, states, dt is not None) for _ in range(samples)]
            ours, theirs = [], []
            hinf_norm(*systems[0], dt=dt, rtol=RTOL)
            for _ in range(3):
                begin = time.process_time()
                norms = [hinf_norm(*system, dt=dt, rtol=RTOL) for system in systems]
                ours.append((time.process_time() - begin) / samples)
                begin = time.process_time()
                reference = slycot_norms(systems, "C" if dt is None else "D")
                theirs.append((time.process_time() - begin) / samples)
            row = {"time": "continuous" if dt is None else "discrete", "states": states, "seconds": np.median(ours)}
            if reference is not None:
                row["slycot_seconds"] = np.median(theirs)
                row["times_slycot"] = np.median(np.divide(ours, theirs))
                row["relative_difference"] = max(abs(n.value / r - 1) for n, r in zip(norms, reference))
            rows.append(row)
    return rows


def slycot_norms(systems: list[tuple[np.ndarray, ...]], time_domain: str = "C") -> list[float] | None:
    """Norms by AB13DD, or None where Slycot is not installed."""
    try:
        from slycot import ab13dd
    except ImportError:
        return None
    norms = []
    for A, B, C, D in systems:
        n, (p, m) = len(A), D.shape
        norms.append(float(ab13dd(time_domain, "I", "S", "D", n, m, p, A, np.eye(n), B, C, D, RTOL)[0]))
    return norms


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--case", choices=("telescope", "structure", "small"), default="telescope")
    parser.add_argument("--samples", type=int, default=20)
    parser.add_argument("--modes", type=int, default=120, help="of the structure")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if arguments.case == "small":
        with threadpool_limits(1):
            rows = small(arguments.samples)
        for row in rows:
            print(
                json.dumps(row)
                if arguments.json
                else "  ".join(f"{k} {v:.3g}" if k != "time" else v for k, v in row.items())
            )
        return
    if arguments.case == "telescope":
        systems = telescope_loops(arguments.samples)
    else:
        systems = [structure(k, arguments.modes) for k in range(arguments.samples)]
    with threadpool_limits(1):
        hinf_norms(systems[:1], rtol=RTOL)
        start_time = time.process_time()
        ours = hinf_norms(systems, rtol=RTOL)
        seconds = time.process_time() - start_time
        start_time = time.process_time()
        reference = slycot_norms(systems)
        slycot_seconds = time.process_time() - start_time
    result: dict[str, object] = {
        "case": arguments.case,
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
