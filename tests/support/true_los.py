"""The true line of sight of a run by the parts that run, without a bag."""

from __future__ import annotations

import numpy as np
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.closed_loop import SimulatedLoop


def true_los(config: RunConfig) -> np.ndarray:
    """Truth of every tick [rad], shape (n, 2)."""
    found: list[np.ndarray] = []
    SimulatedLoop.of(RunParts(config)).run(config.ticks, lambda block, rows: found.append(block.truth[:rows].copy()))
    return np.concatenate(found)
