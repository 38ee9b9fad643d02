"""Fixed-order H-infinity autopilot of a missile (COMPleib AC4; Fares, Apkarian and Noll 2001).

Controllers of order 0, 1, 2 and 4 on the same generalised plant, compared with the full-order optimum 0.5573 (two
Riccati equations).
"""

from __future__ import annotations

from lftkit.tuning import HinfGain, TuningOptions, TuningResult, state_space, tune
from lftkit.tuning.published_plants import PLANTS

FULL_ORDER_OPTIMUM = 0.557291  # python-control 0.10.2, hinfsyn


def main() -> dict[int, TuningResult]:
    """Design and report."""
    plant = PLANTS["AC4"]()
    results = {}
    for order in (0, 1, 2, 4):
        structure = state_space([("y", 2)], [("u", 1)], order)
        options = TuningOptions(starts=3, wall_limit=600.0)
        result = tune([plant], [HinfGain("w", "z", name="autopilot")], structure, options=options)
        assert result.certificate is not None
        print(
            f"order {order}: {result.soft:.5f} (certified below {result.certificate.upper.max():.5f}, {result.status}, "
            f"{result.seconds:.1f} s); full-order optimum {FULL_ORDER_OPTIMUM}"
        )
        results[order] = result
    return results


if __name__ == "__main__":
    main()
