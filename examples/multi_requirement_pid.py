"""PID of a slow process with a delay: five requirements at once.

Process 2 / ((10 s + 1)(s + 1)) with 0.5 s of delay in the loop. Load disturbances are rejected as well as possible
(soft requirement). Hard requirements: peak sensitivity below 1.7, peak complementary sensitivity below 1.3 (margins),
command due to measurement noise at most 0.15 units rms (H2), no closed-loop pole faster than 12 rad/s.
"""

from __future__ import annotations

import numpy as np

from lftkit import System, transfer
from lftkit.tuning import ClosedLoopPoles, H2Gain, HinfGain, TuningOptions, TuningResult, pid, tune

DELAY = 0.5  # s
NOISE = 0.05  # standard deviation of the measurement's samples
PERIOD = 0.1  # s, of these samples


def process() -> System:
    """Ports: load, reference, noise, valve -> level, error, command, seen (input of the PID).

    The noise is filtered at 5 rad/s before the PID.
    """
    A = [[-0.1, 0.2, 0, 0], [0, -1, 0, 0], [0, 0, -5, 0], [-5, 0, 0, -5]]
    B = [[0, 0, 0, 0], [1, 0, 0, 1], [0, 0, 5, 0], [0, 5, 0, 0]]
    C = [[1, 0, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 0], [0, 0, -1, 1]]
    D = np.zeros((4, 4))
    D[1, 1] = D[2, 3] = 1.0
    inputs = [("load", 1), ("reference", 1), ("noise", 1), ("valve", 1)]
    outputs = [("level", 1), ("error", 1), ("command", 1), ("seen", 1)]
    return System(A, B, C, D, inputs, outputs, "process")


REQUIREMENTS = [
    # a load step must leave no steady error (integral action), so the weight is almost an integrator
    HinfGain("load", "level", weight_out=transfer([1, 0.2], [1, 1e-4], name="1/s"), name="load rejection"),
    HinfGain("reference", "error", bound=1.7, hard=True, name="sensitivity peak"),
    HinfGain("reference", "level", bound=1.3, hard=True, name="overshoot"),
    H2Gain(
        "noise",
        "command",
        bound=0.15,
        weight_in=transfer([NOISE * np.sqrt(PERIOD)], [0.02, 1], name="noise"),
        hard=True,
        name="noise on the command",
    ),
    ClosedLoopPoles(max_frequency=12.0, name="speed"),
]


def main() -> TuningResult:
    """Design and report."""
    structure = pid("seen", "valve", derivative_filter=0.3)
    result = tune(
        [process()],
        REQUIREMENTS,
        structure,
        initial=[[0.5, 0.05, 0.1]],
        loop_delay=DELAY,
        options=TuningOptions(starts=1, wall_limit=600.0),
    )
    assert result.certificate is not None
    kp, ki, kd = result.x
    print(f"{result.status}: Kp {kp:.4g}, Ki {ki:.4g}, Kd {kd:.4g} ({result.seconds:.1f} s)")
    for name, value, certified in zip(result.requirement_names, result.values[:, 0], result.certificate.values[:, 0]):
        print(f"  {name:22s} {value:8.4f}   certified {certified:8.4f}")
    return result


if __name__ == "__main__":
    main()
