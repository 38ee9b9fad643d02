"""Robust PID of a mass on a spring and a damper, all three uncertain.

    m = 3 kg +- 40 %,  c = 1 N s/m +- 20 %,  k = 2 N/m +- 30 %

One PID for every value: the worst case of the weighted sensitivity is minimised, with bounds on the noise
amplification (measurement noise to force) and on the damping ratio of the closed loop. The tuner starts with
the nominal values and adds the worst parameter values found until the search finds nothing worse.
"""

from __future__ import annotations

from collections.abc import Mapping

from lftkit import System, transfer
from lftkit.tuning import (
    ClosedLoopPoles,
    HinfGain,
    RobustOptions,
    TuningOptions,
    TuningResult,
    WorstCaseOptions,
    pid,
    tune_robust,
)

BOX = {"m": (1.8, 4.2), "c": (0.8, 1.2), "k": (1.4, 2.6)}


def build(p: Mapping[str, float]) -> System:
    """Ports: reference [m], noise [m], force [N] -> error [m], effort [N], seen [m] (measured error)."""
    m, c, k = p["m"], p["c"], p["k"]
    return System(
        [[0, 1], [-k / m, -c / m]],
        [[0, 0, 0], [0, 0, 1 / m]],
        [[-1, 0], [0, 0], [-1, 0]],
        [[1, 0, 0], [0, 0, 1], [1, -1, 0]],
        [("reference", 1), ("noise", 1), ("force", 1)],
        [("error", 1), ("effort", 1), ("seen", 1)],
    )


# the error may be 1 % at 0.01 rad/s, equal to the reference at about 0.4 rad/s, and twice the reference above
TRACKING = transfer([0.5, 0.4], [1, 0.004], name="tracking")

REQUIREMENTS = [
    HinfGain("reference", "error", weight_out=TRACKING, name="tracking"),
    HinfGain("noise", "effort", bound=60.0, hard=True, name="noise amplification"),
    ClosedLoopPoles(min_damping=0.3, name="damping"),
]


def main() -> TuningResult:
    """Design and report."""
    structure = pid("seen", "force", derivative_filter=0.05)
    result = tune_robust(
        build,
        BOX,
        REQUIREMENTS,
        structure,
        initial=[[5.0, 1.0, 2.0]],
        options=RobustOptions(TuningOptions(starts=0, wall_limit=600.0), WorstCaseOptions(samples=30, climbs=1)),
    )
    kp, ki, kd = result.x
    print(f"{result.status}: Kp {kp:.3g}, Ki {ki:.3g}, Kd {kd:.3g}; {result.advice}")
    for r in result.rounds:
        print(f"  {r.models} models: tuned {r.soft:.3f}, worst found {r.worst_soft:.3f} (hard {r.worst_hard:.3f})")
    for w in result.worst:
        where = ", ".join(f"{name} {value:.3g}" for name, value in w.parameters.items())
        print(f"  {w.requirement}: {w.value:.3f} at {where}")
    return result


if __name__ == "__main__":
    main()
