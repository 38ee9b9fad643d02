"""Cost of a tick of plant, observer and controller: the dense product that runs had before, and the present code.

    python benchmarks/tick.py [--ticks 20000] [--durations 20,80] [--member 10] [--json]

Microseconds of processor time, the least of five measurements each, all in one process, scenario ``imbalance`` (53
tones) and ``design`` (5 tones):

``dense``     one product with the 232 x (216 + 2 K) matrix of a tick and five products a law, as runs had
``numpy``     the present code without numba, tick by tick
``compiled``  the present code in compiled loops
``ratio``     dense over compiled; ``times_real_time``: 1000 over compiled

``with_bag`` is the processor time that a further second of a recorded run in one process costs, from two durations, and
how many times faster than real time that is. ``member`` are processor seconds of a member of a campaign at depth
``time``, its start computed anew, in the scenarios ``design`` and ``worst_case``, and of its preparation alone. The
largest difference between the signals of dense and compiled code, over the largest value of each column, is
``difference``.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from los_testbed.campaign.dataset import Campaign
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.campaign.sampling import MemberParameters
from los_testbed.config.run_config import RunConfig
from los_testbed.parts import start as run_start
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop import compiled_loop
from los_testbed.run.loop.closed_loop import SIGNALS, SampleBlock, SimulatedLoop
from los_testbed.run.loop.simulate import run_in_process
from processor_time import least

from titop_plant.held_samples import HeldSamples
from titop_plant.interface import CAMERA, FORCES, MIRROR, PLATFORM
from titop_plant.simulation import build, compilation
from titop_plant.simulation.plant_step import step_matrix


class Law:
    """A sampled system with five products a step, as `lftkit.SampledSystem` had them."""

    def __init__(self, system: Any, state: np.ndarray) -> None:
        self.system, self.x = system, state.copy()
        self.next, self.feed = np.empty_like(state), np.empty_like(state)
        self.through = np.empty(system.C.shape[0])

    def step(self, u: np.ndarray, out: np.ndarray) -> None:
        k = self.system
        np.matmul(k.C, self.x, out=out)
        np.matmul(k.D, u, out=self.through)
        np.add(out, self.through, out=out)
        np.matmul(k.A, self.x, out=self.next)
        np.matmul(k.B, u, out=self.feed)
        np.add(self.next, self.feed, out=self.x)


class DenseLoop:
    """Plant, observer and controller as runs had them: one product with the matrix of a tick."""

    def __init__(self, parts: RunParts) -> None:
        plant, tones = parts.family.plant_and_tones(parts.physical)
        self.matrix, self.turn = step_matrix(plant, tones), np.exp(1j * tones.frequency * 1e-3)
        self.n, self.limits = plant.A.shape[0], parts.family.ports.limits
        self.z, self.out = np.zeros(self.matrix.shape[1]), np.zeros(self.matrix.shape[0])
        self.commands, self.measurements = parts.ports.commands, parts.ports.measurements
        self.phasors = self.z[self.n + self.commands :].view(complex)
        self.z[: self.n], self.phasors[:] = parts.start.states.plant, 1.0
        self.sensors = parts.family._sensors(parts.physical)
        self.noise = np.random.default_rng(np.random.SeedSequence(self.sensors.seed).spawn(2)[0])
        self.block, self.tick = np.zeros((64, self.measurements)), 0
        self.observer = Law(parts.k_fsm, parts.start.states.k_fsm)
        self.forces = Law(parts.k_pma, parts.start.states.k_pma)
        self.held, self.seen, self.force = HeldSamples(parts.ports.sensors), np.zeros(self.measurements), np.zeros(6)
        self.held.values[:] = parts.start.states.camera
        controller = parts.controller()
        self.gain, self.authority = controller.mirror_gain, controller.limits

    def plant(self, command: np.ndarray, y: np.ndarray, truth: np.ndarray) -> None:
        n, v = self.n, self.z[self.n : self.n + self.commands]
        np.minimum(command, self.limits, out=v)
        np.maximum(v, -self.limits, out=v)
        np.matmul(self.matrix, self.z, out=self.out)
        if self.tick % 64 == 0:
            self.noise.standard_normal(out=self.block)
            self.block *= self.sensors.sigma
        np.add(self.out[n : n + self.measurements], self.block[self.tick % 64], out=y)
        y += self.sensors.bias
        truth[:] = self.out[n + self.measurements :]
        if self.tick % self.sensors.frame_ticks:
            y[CAMERA] = np.nan
        self.z[:n] = self.out[:n]
        np.multiply(self.phasors, self.turn, out=self.phasors)
        self.tick += 1

    def step(self, command: np.ndarray, y: np.ndarray, truth: np.ndarray, los: np.ndarray, u: np.ndarray) -> None:
        self.plant(command, y, truth)
        self.seen[:] = y
        self.held.fill(self.seen)
        self.observer.step(self.seen, los)
        self.forces.step(y[PLATFORM], self.force)
        np.multiply(los, self.gain, out=u[MIRROR])
        u[FORCES] = self.force
        np.minimum(u, self.authority, out=u)
        np.maximum(u, -self.authority, out=u)
        command[:] = u


def dense(parts: RunParts, ticks: int) -> np.ndarray:
    """Signals of a run with the dense product, (ticks, 34)."""
    loop, rows = DenseLoop(parts), np.zeros((ticks, 34))
    command = parts.start.command.copy()
    for row in rows:
        loop.step(command, row[:22], row[22:24], row[24:26], row[26:])
    return rows


def present(parts: RunParts, ticks: int, compiled: bool, keep: bool = False) -> list[np.ndarray]:
    """The same with the present code, in blocks; none of them if they are not kept."""
    plant, estimator, controller = parts.plant(), parts.estimator(), parts.controller()
    estimator.reset()
    controller.reset()
    found: list[np.ndarray] = []

    def sink(block: SampleBlock, rows: int) -> None:
        if keep:
            found.append(np.hstack([getattr(block, name)[:rows] for name in SIGNALS]))

    usual = compiled_loop.kernel_for
    compiled_loop.kernel_for = (lambda ticks: compilation.kernel()) if compiled else (lambda ticks: None)
    try:
        used = parts.used["k_fsm"], parts.used["k_pma"]
        SimulatedLoop(plant, estimator, controller, parts.ports, used, parts.start.command).run(ticks, sink)
    finally:
        compiled_loop.kernel_for = usual
    return found


def tick(scenario: str, ticks: int) -> dict[str, float]:
    """Microseconds of a tick."""
    parts = RunParts(RunConfig(mode="inprocess", scenario=scenario, duration=ticks / 1000))
    few = max(1, ticks // 20)
    runs = {
        "dense": (lambda count: dense(parts, count), few),
        "numpy": (lambda count: present(parts, count, False), few),
        "compiled": (lambda count: present(parts, count, True), ticks),
    }
    before = np.nan_to_num(dense(parts, few))
    made = {compiled: np.vstack(present(parts, few, compiled, keep=True)) for compiled in (False, True)}
    found: dict[str, float] = {}
    for name, (run, count) in runs.items():  # a run of two ticks is what is made before the first one
        found[f"{name}_us"] = 1e6 * (least(lambda: run(count)) - least(lambda: run(2))) / (count - 2)  # noqa: B023
    scale = np.abs(before).max(axis=0)
    found["ratio"] = found["dense_us"] / found["compiled_us"]
    found["times_real_time"] = 1000.0 / found["compiled_us"]
    found["difference"] = float((np.abs(np.nan_to_num(made[True]) - before).max(axis=0) / scale).max())
    if made[False].tobytes() != made[True].tobytes():
        raise SystemExit("numpy and compiled code differ")
    return found


def with_bag(durations: list[float]) -> dict[str, float]:
    """Cost of a further second of a recorded run."""
    seconds = []
    for duration in durations:
        config = RunConfig(mode="inprocess", scenario="design", duration=duration)
        with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
            names = iter(range(100))
            seconds.append(least(lambda: run_in_process(config, Path(folder) / str(next(names))), 3))  # noqa: B023
    cost = (seconds[1] - seconds[0]) / (durations[1] - durations[0])
    return {"cpu_ms_per_s": 1e3 * cost, "times_real_time": 1.0 / cost}


def member(scenario: str, duration: float) -> dict[str, float]:
    """Processor seconds of a member of a campaign, mean of three, and of its start alone."""
    base = RunConfig(mode="inprocess", scenario=scenario, duration=duration)
    evaluator = MemberEvaluator.of(base)
    rows = [row for _, chunk in Campaign.of(base, "uniform", 4, 1, "time", {}).chunks() for row in chunk][:4]
    evaluator.rows(rows[:1], "time")
    seconds, preparation = 0.0, 0.0
    for row in rows[1:]:
        forget()
        start = time.process_time()
        evaluator.rows([row], "time")
        seconds += time.process_time() - start
        forget()
        parts = RunParts(replace(base, **MemberParameters.of().settings(row)), evaluator.controllers)
        start = time.process_time()
        parts.start  # noqa: B018
        evaluator.family.build(parts.physical, parts.start.states.plant)
        preparation += time.process_time() - start
    return {"cpu_s": seconds / 3, "preparation_cpu_s": preparation / 3}


def forget() -> None:
    """What is kept of the last runs; a collection of garbage does not fall into what is measured next."""
    run_start._found.clear()
    build._design_tones.cache_clear()
    gc.collect()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ticks", type=int, default=20000)
    parser.add_argument("--durations", default="20,80", help="of the recorded runs [s]")
    parser.add_argument("--member", type=float, default=10.0, help="duration of the runs of members [s]")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if compilation.kernel() is None:
        raise SystemExit("numba must be installed: pip install 'los-testbed[fast]'")
    result: dict[str, Any] = {
        "tick": {scenario: tick(scenario, arguments.ticks) for scenario in ("design", "imbalance")},
        "with_bag": with_bag([float(text) for text in arguments.durations.split(",")]),
        "member": {scenario: member(scenario, arguments.member) for scenario in ("design", "worst_case")},
    }
    print(json.dumps(result) if arguments.json else json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
