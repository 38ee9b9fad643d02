"""The tuner beside BFGS on the published plants, each with the processor time that the tuner took."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from lftkit.benchmarks.bfgs import by_bfgs, restarted
from lftkit.systems.system import System
from lftkit.tuning import HinfGain, TuningOptions, state_space, tune
from lftkit.tuning.published_plants import BEST_KNOWN, PLANTS


def compared(plants: Sequence[str] = tuple(PLANTS), order: int = 0, seconds: float = 60.0) -> Iterator[dict[str, Any]]:
    """One row for each plant: certified values of both, the published one of static controllers, the status."""
    for name in plants:
        plant = PLANTS[name]()
        row: dict[str, Any] = {
            "plant": name,
            "order": order,
            "best_known": BEST_KNOWN.get(name) if order == 0 else None,
        }
        row |= tuned(plant, order, seconds)
        yield {**row, "bfgs": finite(restarted(plant, order, row["seconds"], by_bfgs))}


def tuned(plant: System, order: int, seconds: float) -> dict[str, Any]:
    """The tuner's certified value with default options."""
    structure = state_space([plant.outputs[1]], [plant.inputs[1]], order)
    start_time, start_cpu = time.monotonic(), time.process_time()
    result = tune([plant], [HinfGain(("w",), ("z",))], structure, options=TuningOptions(wall_limit=seconds))
    used, cpu = time.monotonic() - start_time, time.process_time() - start_cpu
    ours = result.certificate.upper.max() if result.certificate and result.certificate.stable else np.inf
    return {"ours": finite(ours), "status": str(result.status), "seconds": used, "cpu_seconds": cpu}


def finite(value: float) -> float | None:
    """A number for JSON; None for a method that found no stable loop."""
    return float(value) if np.isfinite(value) else None
