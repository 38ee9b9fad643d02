"""The exported C beside the compiled kernel of the testbed, bit by bit, on random inputs of all magnitudes.

    python benchmarks/flight_code.py --steps 1e8 --json                      # the shipped pair
    python benchmarks/flight_code.py --random 50 --steps 5e6 --json          # 50 random controllers of order 1 to 12

Each block of ticks begins at rest, with one of the four stages. Its inputs are ordinary, of all magnitudes, subnormal
or near 1e300, in turn; the limits of its commands are the largest number or, in every other round, those of the laws.
The camera is absent in three ticks of four; in some of them one of its values is NaN or infinite. The last ticks of a
block have sums that overflow, and then an acceleration that is NaN. `finite` is the share of ticks whose answers are
all finite; sign and payload of a NaN are not compared.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import math
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from los_testbed.flight.export import render
from los_testbed.flight.laws import FlightLaws, laws_of
from los_testbed.flight.tables import HEADER, UNITS
from los_testbed.flight.vectors import magnitudes, without_frames

from fsm_pma_controller.runtime import FsmPmaController
from lftkit import Port, SampledSystem
from lftkit.arrays import FloatArray
from los_estimator.runtime import LosEstimator
from titop_plant.interface import DT, ESTIMATES, K_FSM_INPUTS, K_FSM_OUTPUTS, K_PMA_INPUTS, K_PMA_OUTPUTS, STAGES, TRUTH
from titop_plant.simulation.compilation import kernel
from titop_plant.simulation.kernel_arrays import (
    ControllerArrays,
    Course,
    ObserverArrays,
    SensorArrays,
    StepArrays,
    TickRecord,
)
from titop_plant.telescope.load import load_telescope

PORTS = load_telescope().loop_ports
"""Sensors and actuators of the laws."""

BLOCK, ODD = 1000, 30
"""Ticks of a block; ticks at its end with sums that overflow, of which the last five follow a NaN."""

KINDS = ("ordinary", "all magnitudes", "subnormal", "1e300")
BUILDS = tuple((compiler, level) for compiler in ("gcc", "clang") for level in ("-O0", "-O1", "-O2", "-O3"))
DRIVER = """
#include "los_flight.h"
void drive(int stage, double mirror, double force, long rows, const double *y, double *estimate, double *command)
{
    los_k_fsm observer;
    los_controller controller;
    long row;
    los_k_fsm_init(&observer);
    los_controller_init(&controller);
    los_controller_switch(&controller, (los_stage)stage);
    los_controller_limit(&controller, mirror, force);
    for (row = 0; row < rows; ++row) {
        los_k_fsm_step(&observer, &y[row * LOS_MEASUREMENTS], &estimate[row * LOS_ESTIMATES]);
        los_controller_step(&controller, &estimate[row * LOS_ESTIMATES],
                            &y[row * LOS_MEASUREMENTS + LOS_ACCEL_IP], &command[row * LOS_COMMANDS]);
    }
}
"""


def random_system(
    rng: np.random.Generator, order: int, inputs: tuple[Port, ...], outputs: tuple[Port, ...]
) -> SampledSystem:
    """A stable system whose numbers are of many magnitudes, some of them zero or subnormal."""
    rows, columns = order + sum(p.size for p in outputs), order + sum(p.size for p in inputs)
    matrix = rng.standard_normal((rows, columns)) * 10.0 ** rng.uniform(-8, 3, (rows, columns))
    matrix[rng.random(matrix.shape) < 0.1] = 0.0
    matrix[rng.random(matrix.shape) < 0.05] = -3e-320
    A = matrix[:order, :order]
    A /= max(1.0, 1.1 * np.abs(A).sum(axis=1).max())
    return SampledSystem(A, matrix[:order, order:], matrix[order:, :order], matrix[order:, order:], inputs, outputs, DT)


def random_laws(rng: np.random.Generator, order: int) -> FlightLaws:
    """Observer of this order, proof-mass law of order 1 to 12, gain and limits at random."""
    k_fsm = random_system(rng, order, K_FSM_INPUTS, K_FSM_OUTPUTS)
    k_pma = random_system(rng, int(rng.integers(1, 13)), K_PMA_INPUTS, K_PMA_OUTPUTS)
    sensitivity, mirror, force = (float(value) for value in 10.0 ** rng.uniform([-3, -4, 0], [1, 4, 12]))
    limits = {"los_sensitivity": sensitivity, "fsm_authority": mirror, "pma_authority": force}
    return FlightLaws.of(
        LosEstimator(k_fsm, PORTS.of_law("k_fsm")), FsmPmaController(k_pma, PORTS.of_law("k_pma"), **limits)
    )


def inputs(rng: np.random.Generator, kind: str, rows: int = BLOCK) -> FloatArray:
    """Measurements (rows, 22) of a block."""
    size = rows, PORTS.measurements
    if kind == "ordinary":
        found = rng.standard_normal(size)
    elif kind == "all magnitudes":
        found = magnitudes(rng, PORTS.measurements, rows)
    elif kind == "subnormal":
        found = 5e-324 * rng.integers(-(1 << 51), 1 << 51, size).astype(float)
    else:
        found = 1e300 * rng.uniform(-1.0, 1.0, size)
    found[-ODD:] = 1.7e308 * rng.uniform(-1.0, 1.0, (ODD, PORTS.measurements))
    found[-5, rng.integers(18)] = np.nan
    return without_frames(found, PORTS.held, rng)


@dataclass(frozen=True)
class Setting:
    """Stage, and the largest mirror angle [rad] and force [N]."""

    stage: str
    mirror: float
    force: float


def by_kernel(laws: FlightLaws, setting: Setting, measurement: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Estimates (n, 2) and commands (n, 8) of the compiled kernel from rest.

    Its plant has one state that stays 1, no motion and no disturbance: a sample is its noise, -0.0 + noise + -0.0, and
    commands have no effect.
    """
    compiled = kernel()
    assert compiled is not None
    rows = len(measurement)
    node = np.full((1, 1, 1 + PORTS.measurements + TRUTH), -0.0)
    node[0, 0, 0] = 1.0
    none, values = np.zeros((0, 0)), np.zeros(1 + PORTS.commands)
    values[0] = 1.0
    step = StepArrays(0, np.zeros(0), np.zeros(0), none, np.zeros((1, 1)), none, none, node)
    sensors = SensorArrays(measurement, np.full(PORTS.measurements, -0.0), np.zeros((rows, PORTS.measurements), bool))
    estimator, controller = laws.estimator(), laws.controller(setting.stage)
    controller.limit(setting.mirror, setting.force)
    law, product = controller.k_pma, estimator.k_fsm.product
    assert isinstance(law, SampledSystem)
    held = estimator.held
    widths = (PORTS.measurements, TRUTH, ESTIMATES, PORTS.commands)
    record = TickRecord(*(np.empty((rows, width)) for width in widths))
    compiled.loop(
        step,
        values,
        np.ones(PORTS.commands),
        Course(np.zeros(rows), np.zeros((rows + 1, 0))),
        sensors,
        ObserverArrays(product.columns, product.values, held.parts, held.columns, held.values),
        ControllerArrays(
            law.product.columns,
            law.product.values,
            laws.measured.start,
            np.array(controller.closed, dtype=np.int64),
            controller.mirror_gain,
            controller.limits,
            np.zeros(PORTS.commands),
        ),
        record,
    )
    if differing(record.measurement, measurement):
        raise RuntimeError("the kernel must see the measurement as it is, got another one")
    return record.estimate, record.command


class Exported:
    """The exported C of some laws, built as a shared library in a folder."""

    def __init__(self, laws: FlightLaws, folder: Path, compiler: str, *options: str) -> None:
        units = [f"{unit}.c" for unit in UNITS]
        for name, text in {**render(laws, (HEADER, *units)), "drive.c": DRIVER}.items():
            (folder / name).write_text(text, "utf-8")
        library = folder / "drive.so"
        sources = (str(folder / name) for name in (*units, "drive.c"))
        line = [compiler, "-std=c99", "-ffp-contract=off", *options, "-fPIC", "-shared", *sources, "-o", str(library)]
        subprocess.run(line, check=True)
        self._drive = ctypes.CDLL(str(library)).drive

    def answers(self, setting: Setting, measurement: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Estimates (n, 2) and commands (n, 8) from rest."""
        rows = len(measurement)
        estimate, command = np.empty((rows, ESTIMATES)), np.empty((rows, PORTS.commands))
        pointers = (ctypes.c_void_p(array.ctypes.data) for array in (measurement, estimate, command))
        limits = ctypes.c_double(setting.mirror), ctypes.c_double(setting.force)
        self._drive(STAGES.index(setting.stage), *limits, ctypes.c_long(rows), *pointers)
        return estimate, command


def differing(found: FloatArray, expected: FloatArray) -> int:
    """Values whose bits differ; a NaN is the same as any NaN."""
    other = found.view(np.uint64) != expected.view(np.uint64)
    return int(np.count_nonzero(other & ~(np.isnan(found) & np.isnan(expected)))) if other.any() else 0


@dataclass
class Comparison:
    """Ticks that were compared, ticks with finite answers only, values that differ."""

    steps: int = 0
    finite: int = 0
    differing: int = 0

    def block(self, laws: FlightLaws, exported: Exported, rng: np.random.Generator, number: int) -> None:
        """Compare a block; kinds of inputs, stages and limits follow from its number."""
        measurement = inputs(rng, KINDS[number % len(KINDS)])
        turn, which = divmod(number // len(KINDS), len(STAGES))
        limits = (sys.float_info.max,) * 2 if turn % 2 == 0 else laws.authority
        setting = Setting(STAGES[-1 - which], *limits)
        expected = by_kernel(laws, setting, measurement)
        for found, wanted in zip(exported.answers(setting, measurement), expected):
            self.differing += differing(found, wanted)
        self.steps += BLOCK
        self.finite += int(np.isfinite(np.hstack(expected)).all(axis=1).sum())


def compare(pairs: int, steps: int, seed: int, builds: tuple[tuple[str, str], ...]) -> dict[str, object]:
    """Compare the shipped pair (`pairs` 0) or random ones, `steps` in all; one compiler and level after the other."""
    rng, total, begin = np.random.default_rng(seed), Comparison(), time.process_time()
    laws = [random_laws(rng, 1 + k % 12) for k in range(pairs)] or [laws_of()] * len(builds)
    blocks = math.ceil(steps / BLOCK / len(laws))
    for k, one in enumerate(laws):
        with tempfile.TemporaryDirectory(prefix="los_testbed_bench_") as folder:
            exported = Exported(one, Path(folder), *builds[k % len(builds)])
            for number in range(blocks):
                total.block(one, exported, rng, number)
    return {
        "controllers": pairs or "shipped",
        "builds": [" ".join(build) for build in builds],
        "steps": total.steps,
        "finite": round(total.finite / total.steps, 4),
        "values_differing": total.differing,
        "cpu_seconds": round(time.process_time() - begin, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=float, default=1e6, help="steps in all (default 1e6)")
    parser.add_argument("--random", type=int, default=0, metavar="N", help="N random pairs, not the shipped one")
    parser.add_argument("--seed", type=int, default=2035)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    builds = tuple(build for build in BUILDS if shutil.which(build[0]))
    if not builds or kernel() is None:
        sys.exit("flight_code.py needs gcc or clang, and numba")
    found = compare(args.random, round(args.steps), args.seed, builds)
    print(json.dumps(found) if args.json else "\n".join(f"{key:18} {value}" for key, value in found.items()))
    sys.exit(1 if found["values_differing"] else 0)


if __name__ == "__main__":
    main()
