"""H-infinity norms of a lightly damped structure at many parameter values, beside SLICOT's AB13DD (Slycot, if
installed).

    python benchmarks/hinf_norm.py [--samples 40] [--modes 120] [--json]

The structure has 22 inputs and 2 outputs, modes from 0.1 to 2000 rad/s with damping 0.001 to 0.02, coordinates
that mix all
modes; every sample has other frequencies. Both sides get the same tolerance, one thread. Slycot is optional:
``pip install slycot`` (its wrapper is GPL-2, so it is no dependency of the project).
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
from threadpoolctl import threadpool_limits

from robust_design import hinf_norms

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


def slycot_norms(systems: list[tuple[np.ndarray, ...]]) -> list[float] | None:
    """Norms by AB13DD, or None where Slycot is not installed."""
    try:
        from slycot import ab13dd
    except ImportError:
        return None
    n = len(systems[0][0])
    return [float(ab13dd("C", "I", "N", "Z", n, 22, 2, A, np.eye(n), B, C, D, RTOL)[0]) for A, B, C, D in systems]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=40)
    parser.add_argument("--modes", type=int, default=120)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    systems = [structure(k, arguments.modes) for k in range(arguments.samples)]
    with threadpool_limits(1):
        hinf_norms(systems[:1], rtol=RTOL)
        begun = time.perf_counter()
        ours = hinf_norms(systems, rtol=RTOL)
        seconds = time.perf_counter() - begun
        begun = time.perf_counter()
        reference = slycot_norms(systems)
        slycot_seconds = time.perf_counter() - begun
    result: dict[str, object] = {
        "states": 2 * arguments.modes,
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
