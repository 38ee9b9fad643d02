"""The true line of sight of a run by the parts that run, without a bag."""

from __future__ import annotations

import numpy as np
from los_testbed.config import RunConfig
from los_testbed.loop.simulate import simulate
from los_testbed.parts.run_parts import RunParts, build_controller, build_estimator, build_plant


def true_los(config: RunConfig) -> np.ndarray:
    """Truth of every tick [rad], shape (n, 2)."""
    found: list[np.ndarray] = []
    estimator, controller = build_estimator(config), build_controller(config)
    estimator.reset()
    controller.reset()
    simulate(
        build_plant(config),
        estimator,
        controller,
        config.ticks,
        lambda block, rows: found.append(block.truth[:rows].copy()),
        RunParts(config).start.command,
    )
    return np.concatenate(found)
