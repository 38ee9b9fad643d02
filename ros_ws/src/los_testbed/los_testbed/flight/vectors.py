"""Vectors of the self test: seeded inputs, and the outputs of the testbed's laws.

The inputs are made by operations whose rounding is defined, so that every computer writes the same file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from lftkit.arrays import FloatArray, IntArray
from los_testbed.flight.laws import FlightLaws
from los_testbed.run.loop.command_gate import CommandGate
from titop_plant.interface import ESTIMATES, STAGES, TICK_NS

SEED = 35
CASE_TICKS = 12
"""Ticks of each case."""

FRAME = 4
"""Ticks from one camera frame to the next."""

VERDICTS = ("", "not_finite", "limit", "off_grid", "future", "duplicate", "late")
"""Reasons of a gate in the order of los_gate_verdict."""


@dataclass(frozen=True)
class LawTick:
    """Inputs of a tick and outputs of the laws.

    Parameters
    ----------
    first : bool
        Whether the laws are reset before it.
    stage : int
        Place in :data:`titop_plant.interface.STAGES`.
    measurement, estimate, command : ndarray, shapes (22,), (2,), (8,)
    """

    first: bool
    stage: int
    measurement: FloatArray
    estimate: FloatArray
    command: FloatArray


@dataclass(frozen=True)
class GateTick:
    """Command offered to a gate in a tick, its verdict, and the applied command.

    Parameters
    ----------
    offered : bool
    stamp, now : int
        [ns]
    candidate, applied : ndarray, shape (size of the command,)
    verdict : int
        Place in :data:`VERDICTS`.
    """

    offered: bool
    stamp: int
    now: int
    candidate: FloatArray
    verdict: int
    applied: FloatArray


def _ordinary(rng: np.random.Generator, width: int) -> FloatArray:
    return 1e-3 * rng.uniform(-1.0, 1.0, (CASE_TICKS, width))


def _to_the_limits(rng: np.random.Generator, width: int) -> FloatArray:
    """Twice the inputs in each tick: commands from well inside their limits to beyond them."""
    scale: FloatArray = np.ldexp(1e-5, np.arange(2 * CASE_TICKS))
    return rng.uniform(-1.0, 1.0, (len(scale), width)) * scale[:, None]


def _zeros(rng: np.random.Generator, width: int) -> FloatArray:
    return np.where(rng.random((CASE_TICKS, width)) < 0.5, 0.0, -0.0)


def _huge(rng: np.random.Generator, width: int) -> FloatArray:
    return 1e300 * rng.uniform(-1.0, 1.0, (CASE_TICKS, width))


def _subnormal(rng: np.random.Generator, width: int) -> FloatArray:
    return 5e-324 * rng.integers(-(1 << 40), 1 << 40, (CASE_TICKS, width)).astype(float)


def magnitudes(rng: np.random.Generator, width: int, rows: int = CASE_TICKS) -> FloatArray:
    """Inputs of all magnitudes, (rows, width): subnormal numbers to 1e300, of both signs."""
    size = rows, width
    values: FloatArray = np.ldexp(rng.uniform(1.0, 2.0, size), rng.integers(-1073, 997, size))
    values *= rng.choice([-1.0, 1.0], size)
    return values


CASES = MappingProxyType(
    {
        "ordinary": _ordinary,
        "to the limits": _to_the_limits,
        "zeros": _zeros,
        "1e300": _huge,
        "subnormal": _subnormal,
        "all magnitudes": magnitudes,
    }
)
"""Inputs by name; the camera is absent in three ticks of four."""


def without_frames(measurement: FloatArray, held: IntArray, rng: np.random.Generator) -> FloatArray:
    """The measurements with a camera that begins late, is slower than the loop and loses parts of its frames.

    The columns `held` are those of sensors that may lack a sample.
    """
    measured = measurement.copy()
    rows = np.arange(len(measured)) % FRAME != 1
    measured[np.ix_(rows, held)] = np.nan
    odd = np.flatnonzero(rows)[::2]
    partly = np.array([[1e-6, np.nan], [np.inf, 1e-6], [-np.inf, -1e-6]])
    measured[np.ix_(odd, held[:2])] = rng.choice(partly, len(odd))
    return measured


def law_ticks(laws: FlightLaws) -> Iterator[LawTick]:
    """Ticks of the laws of all :data:`CASES`, then of all stages one after the other."""
    rng, width, held = np.random.default_rng(SEED), laws.ports.measurements, laws.ports.held
    inputs = [without_frames(make(rng, width), held, rng) for make in CASES.values()]
    cases = [([len(STAGES) - 1] * len(measurement), measurement) for measurement in inputs]
    stages = [stage for stage in (3, 0, 1, 2, 3) for _ in range(3)]
    both = np.vstack([_ordinary(rng, width), _ordinary(rng, width)])
    cases.append((stages, without_frames(both[: len(stages)], held, rng)))
    for stage, measurement in cases:
        estimate, command = run_laws(laws, measurement, stage)
        for row in range(len(stage)):
            yield LawTick(row == 0, stage[row], measurement[row], estimate[row], command[row])


def run_laws(laws: FlightLaws, measurement: FloatArray, stages: list[int]) -> tuple[FloatArray, FloatArray]:
    """Estimates (n, 2) and commands (n, 8) of the laws of the testbed, from rest.

    Parameters
    ----------
    laws : FlightLaws
    measurement : ndarray, shape (n, m)
    stages : list of int
        Stage of each tick.
    """
    estimator, controller = laws.estimator(), laws.controller()
    estimate, command = np.zeros((len(measurement), ESTIMATES)), np.zeros((len(measurement), laws.ports.commands))
    with np.errstate(all="ignore"):
        for row, y in enumerate(measurement):
            if STAGES[stages[row]] != controller.loop:
                controller.switch(STAGES[stages[row]])
            estimator.step(y, estimate[row])
            controller.step(estimate[row], y[laws.measured], command[row])
    return estimate, command


def gate_ticks(gate: CommandGate, hold_ticks: int, fade_ticks: int) -> Iterator[GateTick]:
    """Ticks of a gate: commands with every fault, a gap in which it fades to zero, and the way back."""
    rng, size = np.random.default_rng(SEED), gate.codec.size
    names = ("not_finite", "infinite", "limit", "off_grid", "future", "duplicate", "late")
    faults = dict(zip(range(3, 17, 2), names))
    last = 20 + hold_ticks + fade_ticks + 5
    gate.begin(0)
    for k in range(1, last + fade_ticks + 5):
        now, applied = k * TICK_NS, np.zeros(size)
        candidate, stamp = gate.limit * rng.uniform(-1.0, 1.0, size), now - TICK_NS
        offered = k < 20 or k >= last - 1
        fault = "old" if k == last - 1 else faults.get(k, "")
        if fault in ("not_finite", "infinite"):
            candidate[-1] = np.nan if fault == "not_finite" else np.inf
        elif fault == "limit":
            candidate[0] = -np.nextafter(gate.limit, np.inf)
        else:
            late = {"off_grid": 1, "future": TICK_NS, "duplicate": -TICK_NS, "late": -3 * TICK_NS}
            stamp += (late | {"old": -(hold_ticks + 1) * TICK_NS}).get(fault, 0)
        if not fault and k % 4 == 0:
            candidate[0] = gate.limit
        before = dict(gate.rejected)
        if offered:
            gate.offer(bytes(gate.codec.encode(stamp, candidate)), now)
        rejected = [name for name, count in gate.rejected.items() if count != before.get(name, 0)]
        gate.apply(now, applied)
        yield GateTick(offered, stamp, now, candidate, VERDICTS.index(rejected[0] if rejected else ""), applied)


__all__ = ["SEED", "VERDICTS", "GateTick", "LawTick", "gate_ticks", "law_ticks", "magnitudes", "run_laws"]
