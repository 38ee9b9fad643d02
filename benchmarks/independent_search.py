"""Search for a member and a frequency above a proven bound, independent of the search of the designs.

    python benchmarks/independent_search.py --stage fsm+pma --seconds 300 --seed 20261123

Random starts, frequency among the variables: log-uniform in the figure's band, each parameter at an end, at random or
at its nominal value. From the best of a handful three methods of scipy climb in turn over log frequency and parameters:
a simplex (Nelder and Mead), Powell's directions, a quasi-Newton method (L-BFGS-B) with central differences. Nothing of
``los_design.search`` is used: no grid, no bands, no stored worst point, no derivative of the loop. The time is divided
among the figures and the noise. Then, for the worst point of each figure:

- ``periodic``: the value by the exact periodic solution of the sampled loop (:mod:`los_loop.sampled_loop_norms`), which
  shares nothing with the response that the search climbs on but the telescope's matrices;
- ``run``: the amplitude of the worst tone at these parameters in a run in process, without noise, over the limit, and
  over what the periodic solution predicts (of APE and tones of the relative error; ``--no-run`` leaves it out).

The noise of the sensors has no frequency: its root mean square by the periodic covariances of the sampled loop, and
its largest part along one axis, climb over the parameters with L-BFGS-B and differences from random members.

The exit code is 1 if a value is above its bound or a run differs by more than 0.1 %.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from los_testbed.config.members import member_settings
from los_testbed.config.run_config import RunConfig
from los_testbed.run.loop.simulate import run_in_process
from scipy import linalg, optimize
from threadpoolctl import threadpool_limits

from lftkit.arrays import FloatArray
from los_design.synthesis.store import load_designs
from los_design.verification.loop_models import figures_of
from los_design.verification.statements import SHIPPED
from los_loop.implemented_loop import ImplementedLoop, LoopMetric
from los_loop.noise import noise_covariances
from los_loop.open_loop import OpenLoop
from los_loop.sampled_loop_norms import weighted_gains
from los_loop.worst_tone import INDICES
from pointing_analysis.read.run import Run
from titop_plant.interface import DT
from titop_plant.telescope.control_plant import control_loop_plant
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.weights import rpe_weight

HANDFUL, EVALUATIONS = 24, 260
"""Random points of which the best is climbed from, and most evaluations of a climb without differences."""
STEP, ITERATIONS = 1e-5, 40
"""Half of a central difference (log frequency, and parts of the ranges), and most iterations that use them."""
NOISY, COARSE, FEW = 12, 1e-3, 8
"""Of noise: random members of which the best is climbed from, difference, most iterations."""
LOWEST = 3e-3
"""Least frequency [rad/s]."""
CLOSE = 1e-3
"""Largest difference of a run from its prediction."""


def random_point(chance: np.random.Generator, size: int) -> FloatArray:
    """A point of the unit cube, each coordinate at an end, in the middle or anywhere."""
    anywhere = chance.uniform(size=size)
    kind = chance.uniform(size=size)
    ends: FloatArray = np.where(kind < 0.6, np.round(anywhere), np.where(kind < 0.7, 0.5, anywhere))
    return ends


class Value:
    """Gain of a figure over log frequency and the unit cube, clipped to the ranges; the largest one is kept."""

    def __init__(self, loop: ImplementedLoop, metric: LoopMetric) -> None:
        self.loop, self.metric = loop, metric
        self.band = float(np.log(max(metric.band[0], LOWEST))), float(np.log(metric.band[1]))
        self.best: tuple[float, float, FloatArray] = (0.0, 1.0, np.zeros(len(loop.names)))

    def gains(self, log_omega: float, points: FloatArray) -> FloatArray:
        """At one frequency and some points (N, 7)."""
        omega, points = float(np.exp(np.clip(log_omega, *self.band))), np.clip(points, 0.0, 1.0)
        found = self.loop.gains(self.loop.at(omega), self.metric, points)
        k = int(found.argmax())
        if found[k] > self.best[0]:
            self.best = float(found[k]), omega, points[k]
        return found

    def __call__(self, x: FloatArray) -> float:
        return -float(self.gains(x[0], x[1:][None])[0])

    def with_slope(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Value and its differences, to one side at an edge."""
        limits = np.array([self.band, *([(0.0, 1.0)] * (len(x) - 1))])
        ends = np.clip(x[:, None] + np.array([-STEP, STEP]), limits[:, :1], limits[:, 1:])
        points = np.tile(x[1:], (2 * (len(x) - 1) + 1, 1))
        for k in range(1, len(x)):
            points[2 * k - 1 : 2 * k + 1, k - 1] = ends[k]
        here = self.gains(x[0], points)
        beside = [self.gains(at, x[1:][None])[0] for at in ends[0]]
        both = np.concatenate([[beside], here[1:].reshape(-1, 2)])
        return -float(here[0]), -(both[:, 1] - both[:, 0]) / np.ptp(ends, axis=1)


def simplex(value: Value, x: FloatArray, chance: np.random.Generator) -> None:
    """Climb with the method of Nelder and Mead."""
    corners = np.vstack([x] * (len(x) + 1))
    corners[1, 0] += 0.02 * chance.choice((-1.0, 1.0))
    for k in range(1, len(x)):
        corners[k + 1, k] += 0.25 if x[k] < 0.5 else -0.25
    options = {"initial_simplex": corners, "maxfev": EVALUATIONS, "xatol": 1e-6, "fatol": 1e-7}
    optimize.minimize(value, x, method="Nelder-Mead", options=options)


def directions(value: Value, x: FloatArray, chance: np.random.Generator) -> None:
    """Climb with Powell's method, the first directions in random order."""
    first = np.diag([0.02, *([0.5] * (len(x) - 1))])[chance.permutation(len(x))]
    bounds = [value.band, *([(0.0, 1.0)] * (len(x) - 1))]
    options = {"direc": first, "maxfev": EVALUATIONS, "xtol": 1e-5, "ftol": 1e-7}
    optimize.minimize(value, x, method="Powell", bounds=bounds, options=options)


def quasi_newton(value: Value, x: FloatArray, chance: np.random.Generator) -> None:
    """Climb with differences; a hundredth of log frequency counts as much as the range of a parameter."""
    scale = np.array([0.01, *([1.0] * (len(x) - 1))])

    def scaled(y: FloatArray) -> tuple[float, FloatArray]:
        found, slope = value.with_slope(y * scale)
        return found, slope * scale

    bounds = [(value.band[0] / scale[0], value.band[1] / scale[0]), *([(0.0, 1.0)] * (len(x) - 1))]
    optimize.minimize(
        scaled, x / scale, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": ITERATIONS, "ftol": 1e-9}
    )


METHODS = (simplex, directions, quasi_newton)


def climbed(
    loop: ImplementedLoop, metric: LoopMetric, chance: np.random.Generator, until: float
) -> tuple[float, float, FloatArray, dict[str, int], dict[str, float]]:
    """Largest value before a processor time, its frequency and point; number of climbs and value of each method."""
    value, size = Value(loop, metric), len(loop.names)
    climbs, reached = {m.__name__: 0 for m in METHODS}, {m.__name__: 0.0 for m in METHODS}
    best = value.best
    while time.process_time() < until:
        starts = []
        for log_omega in chance.uniform(*value.band, size=HANDFUL // 4):
            points = np.array([random_point(chance, size) for _ in range(4 * HANDFUL)])
            values = value.gains(log_omega, points)
            starts.append((float(values.max()), log_omega, points[int(values.argmax())]))
        _, log_omega, point = max(starts, key=lambda start: start[0])
        method = METHODS[sum(climbs.values()) % len(METHODS)]
        value.best = (0.0, 1.0, point)
        method(value, np.concatenate([[log_omega], point]), chance)
        climbs[method.__name__] += 1
        reached[method.__name__] = max(reached[method.__name__], value.best[0])
        best = max(best, value.best, key=lambda found: found[0])
    return *best, climbs, reached


def noisiest(
    loop: ImplementedLoop, bounds: list[dict[str, float]], chance: np.random.Generator, until: float
) -> dict[str, Any]:
    """Largest noise of members, over both axes and along one, of the absolute and the relative error [rad]."""
    size, seen = len(loop.names), {f"{e}, {k}": 0.0 for e in ("absolute", "relative") for k in ("rms", "along")}
    members = 0

    def noise(x: FloatArray) -> FloatArray:
        nonlocal members
        members += 1
        plant = loop.system.at(loop.values(np.clip(x, 0.0, 1.0)))
        found = noise_covariances(plant, *loop.pair, loop.telescope, loop=loop.stage)
        values = np.sqrt([value for c in found for value in (np.trace(c), linalg.eigvalsh(c)[-1])])
        seen.update({name: max(seen[name], float(value)) for name, value in zip(seen, values)})
        return np.asarray(values)

    while time.process_time() < until:
        for k in range(len(seen)):
            points = [random_point(chance, size) for _ in range(NOISY)]
            start = max(points, key=lambda x, k=k: noise(x)[k])
            scale = noise(start)[k] * 1e-3

            def slope(x: FloatArray, k: int = k, scale: float = scale) -> tuple[float, FloatArray]:
                here, steps = noise(x)[k], np.where(x < 0.5, COARSE, -COARSE)
                beside = [noise(x + step)[k] for step in np.diag(steps)]
                return -here / scale, -(np.array(beside) - here) / steps / scale

            box = [(0.0, 1.0)] * size
            optimize.minimize(slope, start, jac=True, method="L-BFGS-B", bounds=box, options={"maxiter": FEW})
            if time.process_time() > until:
                break
    claimed = [bound[kind] for bound in bounds for kind in ("rms", "along")]
    kept = all(value <= bound for value, bound in zip(seen.values(), claimed))
    return {"found": seen, "bound": dict(zip(seen, claimed)), "members": members, "kept": kept}


def periodic(loop: ImplementedLoop, metric: LoopMetric, omega: float, point: FloatArray) -> float:
    """Value by the periodic solution over the limit, sidebands of the camera included."""
    plant, closed = loop.sampled_at(loop.values(point))
    response, relative = weighted_gains(closed, plant, loop.telescope, np.array([omega]))
    gain = float(relative[0]) if metric.relative else float(linalg.svdvals(response[0, metric.rows])[0])
    return gain / metric.limit


def measured(loop: ImplementedLoop, metric: LoopMetric, omega: float, point: FloatArray) -> dict[str, float]:
    """A run in process at the point, with its worst tone and without noise: amplitude of the line of sight.

    ``value`` is what the run measures, over the limit, by a fit of the tone to the record, which begins in the steady
    state; ``ratio`` is measured over the periodic solution at the tone's frequency.
    """
    config = RunConfig(
        mode="inprocess",
        scenario="worst_case",
        worst_of=metric.name,
        loop=loop.stage,
        duration=float(np.ceil(max(10.0, 2.5 * 2.0 * np.pi / omega))),
        noise=False,
        **member_settings(loop.values(point), loop.telescope),
    )
    with tempfile.TemporaryDirectory() as folder:
        run_in_process(config, Path(folder) / "bag")
        run = Run.open(Path(folder) / "bag")
        los = np.array(run["truth/los"].values)
        (at,) = np.atleast_1d(run.parameters["tones_rad_s"])
    at = float(at)
    wave = at * DT * np.arange(len(los))
    fitted, *_ = linalg.lstsq(np.column_stack([np.cos(wave), np.sin(wave), np.ones(len(los))]), los)
    weight = float(rpe_weight(at, loop.telescope.weights.rpe_window)) if metric.relative else 1.0
    value = float(linalg.norm(fitted[:2])) * weight / metric.limit
    return {"omega": at, "value": value, "ratio": value / periodic(loop, metric, at, point)}


def main() -> None:
    """Search, compare with the bounds, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stage", default="fsm+pma")
    parser.add_argument(
        "--seconds", type=float, default=300.0, help="of processor time, all figures and the noise together"
    )
    parser.add_argument("--seed", type=int, default=20261123)
    parser.add_argument("--no-run", action="store_true")
    options = parser.parse_args()
    telescope, shipped = load_telescope(), json.loads(SHIPPED.read_text("utf-8"))
    open_loop = OpenLoop(control_loop_plant(telescope), telescope, telescope.loop_ports.used_by())
    loop = ImplementedLoop(open_loop, *load_designs("implemented"), options.stage)
    chance = np.random.default_rng(options.seed)
    metrics = figures_of(telescope, options.stage, telescope.loop_ports.used_by())
    found: dict[str, dict[str, Any]] = {}
    with threadpool_limits(1):
        for name, metric in metrics.items():
            (bound,) = (r["level"] for r in shipped["figures"] if (r["stage"], r["figure"]) == (options.stage, name))
            until = time.process_time() + options.seconds / (len(metrics) + 1)
            value, omega, point, climbs, reached = climbed(loop, metric, chance, until)
            row = {"found": value, "bound": bound, "omega": omega, "climbs": climbs, "reached": reached}
            row["periodic"] = periodic(loop, metric, omega, point)
            row["values"] = loop.values(point)
            if not options.no_run and name in INDICES:
                row["run"] = measured(loop, metric, omega, point)
            row["kept"] = value <= bound and row["periodic"] <= bound and near(row.get("run"))
            found[name] = row
            sys.stderr.write(f"{options.stage}, {name}: {row}\n")
        until = time.process_time() + options.seconds / (len(metrics) + 1)
        found["noise"] = noisiest(loop, shipped["noise"][options.stage], chance, until)
    print(json.dumps({"stage": options.stage, "seed": options.seed, "figures": found}, indent=1))
    sys.exit(not all(row["kept"] for row in found.values()))


def near(run: dict[str, float] | None) -> bool:
    """Whether a run measured what was predicted; without one nothing is said against it."""
    return run is None or abs(run["ratio"] - 1.0) < CLOSE


if __name__ == "__main__":
    main()
