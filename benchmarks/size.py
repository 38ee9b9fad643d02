"""Cost of a plant against its number of states.

    python benchmarks/size.py [--states 100,204,400,800] [--ticks 20000] [--json]

The plants are random oscillators with the ports of the telescope, 1 to 3000 rad/s, damping ratio 0.005, so small in
their outputs that the loop leaves them alone. ``preparation_s`` are processor seconds of modal coordinates and of the
matrices of a tick, ``tick_us`` microseconds of a compiled tick of plant, observer and controller, least of five.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from types import SimpleNamespace
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from processor_time import least
from tick import present

from lftkit import Port, System
from titop_plant.interface import TRUTH
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_step import plant_step

DISTURBANCES, MEASUREMENTS, COMMANDS = 22, 22, 8
OUTPUT = 1e-9
"""Size of the outputs of a random plant."""


def random_plant(states: int) -> System:
    """Oscillators with the ports of the telescope, their modes mixed by a random orthogonal matrix."""
    rng, modes = np.random.default_rng(states), states // 2
    omega = np.geomspace(1.0, 3000.0, modes) * rng.uniform(0.98, 1.02, modes)
    A = np.zeros((2 * modes, 2 * modes))
    A[:modes, modes:] = np.diag(omega)
    A[modes:, :modes] = -np.diag(omega)
    A[modes:, modes:] = -0.01 * np.diag(omega)
    turn, _ = np.linalg.qr(rng.standard_normal(A.shape))
    B = rng.standard_normal((len(A), COMMANDS + DISTURBANCES))
    C = OUTPUT * rng.standard_normal((MEASUREMENTS + TRUTH, len(A)))
    inputs = (Port("u", COMMANDS), Port("d", DISTURBANCES))
    outputs = (Port("y", MEASUREMENTS), Port("los", TRUTH))
    return System(turn @ A @ turn.T, turn @ B, C @ turn.T, np.zeros((len(C), B.shape[1])), inputs, outputs)


def cost(states: int, ticks: int) -> dict[str, float]:
    """Preparation and tick of a plant with so many states."""
    parts = RunParts(RunConfig(mode="inprocess", scenario="design", duration=ticks / 1000))
    system, tones = random_plant(states), parts.family.tones(parts.physical)
    begin = time.process_time()
    step = plant_step(system, tones)
    seconds = time.process_time() - begin
    sensors, limits = parts.family._sensors(parts.physical), parts.family.ports.limits

    def plant() -> Plant:
        return Plant(ConstantStep(step, np.zeros(system.order), np.unique(tones.frequency)), sensors, limits)

    kept = {name: getattr(parts, name) for name in ("estimator", "controller", "start", "ports", "used")}
    made: Any = SimpleNamespace(plant=plant, **kept)
    each = [least(lambda: present(made, count, True)) for count in (2, ticks)]  # noqa: B023
    return {"preparation_s": seconds, "tick_us": 1e6 * (each[1] - each[0]) / (ticks - 2)}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", default="100,204,400,800")
    parser.add_argument("--ticks", type=int, default=20000)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    result: dict[str, Any] = {text: cost(int(text), arguments.ticks) for text in arguments.states.split(",")}
    print(json.dumps({"states": result}) if arguments.json else json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
