"""Search for a member and a frequency above a proven bound, independent of the search of the designs.

    python benchmarks/independent_search.py --stage fsm+pma --seconds 300 --seed 20261123

Random starts, frequency among the variables: log-uniform in the figure's band, each parameter at an end, at random or
at its nominal value. From the best of a handful a simplex (Nelder and Mead, no gradient) climbs over log frequency and
parameters. Nothing of ``los_design.search`` is used: no grid, no bands, no stored worst point, no gradient. The time
is divided among the figures. Then, for the worst point of each figure:

- ``periodic``: the value by the exact periodic solution of the sampled loop (:mod:`los_loop.sampled_loop_norms`), which
  shares nothing with the response that the search climbs on but the telescope's matrices;
- ``run``: the amplitude of the worst tone at these parameters in a run in process, without noise, over the limit, and
  over what the periodic solution predicts (of APE and tones of the relative error; ``--no-run`` leaves it out).

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
from los_testbed.config import RunConfig
from los_testbed.loop.simulate import run_in_process
from los_testbed.variants import member_settings
from scipy import linalg, optimize
from threadpoolctl import threadpool_limits

from lftkit.arrays import FloatArray
from los_design.synthesis.store import load_designs
from los_design.verification.loop_models import figures_of
from los_design.verification.statements import SHIPPED
from los_loop.implemented_loop import ImplementedLoop, LoopMetric
from los_loop.open_loop import OpenLoop
from los_loop.sampled_loop_norms import weighted_gains
from los_loop.worst_tone import INDICES
from pointing_analysis.read.run import Run
from titop_plant.interface import DT
from titop_plant.simulation.build import control_loop_plant, telescope
from titop_plant.telescope.parameters import load_parameters
from titop_plant.telescope.weights import rpe_weight

HANDFUL, EVALUATIONS = 24, 260
"""Random points of which the best is climbed from, and most evaluations of a climb."""
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


def climbed(
    loop: ImplementedLoop, metric: LoopMetric, chance: np.random.Generator, until: float
) -> tuple[float, float, FloatArray, int]:
    """Largest value that climbs reach before a processor time, its frequency and point, and how many climbs."""
    low, high = np.log(max(metric.band[0], LOWEST)), np.log(metric.band[1])
    size = len(loop.names)
    best: tuple[float, float, FloatArray] = (0.0, 1.0, np.zeros(size))
    climbs = 0

    def value(x: FloatArray) -> float:
        omega = float(np.exp(np.clip(x[0], low, high)))
        return -float(loop.gains(loop.at(omega), metric, np.clip(x[1:], 0.0, 1.0)[None])[0])

    while time.process_time() < until:
        starts = []
        for omega in chance.uniform(low, high, size=HANDFUL // 4):
            points = np.array([random_point(chance, size) for _ in range(4 * HANDFUL)])
            values = loop.gains(loop.at(float(np.exp(omega))), metric, points)
            starts.append((float(values.max()), omega, points[int(values.argmax())]))
        _, omega, point = max(starts, key=lambda start: start[0])
        simplex = np.vstack([np.concatenate([[omega], point])] * (size + 2))
        simplex[1, 0] += 0.02 * chance.choice((-1.0, 1.0))
        for k in range(size):
            simplex[k + 2, k + 1] += 0.25 if point[k] < 0.5 else -0.25
        found = optimize.minimize(
            value,
            simplex[0],
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "maxfev": EVALUATIONS, "xatol": 1e-6, "fatol": 1e-7},
        )
        climbs += 1
        if -float(found.fun) > best[0]:
            best = -float(found.fun), float(np.exp(np.clip(found.x[0], low, high))), np.clip(found.x[1:], 0.0, 1.0)
    return *best, climbs


def periodic(loop: ImplementedLoop, metric: LoopMetric, omega: float, point: FloatArray) -> float:
    """Value by the periodic solution over the limit, sidebands of the camera included."""
    plant, closed = loop.sampled_at(loop.values(point))
    response, relative = weighted_gains(closed, plant, loop.parameters, np.array([omega]))
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
        **member_settings(loop.values(point)),
    )
    with tempfile.TemporaryDirectory() as folder:
        run_in_process(config, Path(folder) / "bag")
        run = Run.open(Path(folder) / "bag")
        los = np.array(run["truth/los"].values)
        (at,) = np.atleast_1d(run.parameters["tones_rad_s"])
    at = float(at)
    wave = at * DT * np.arange(len(los))
    fitted, *_ = linalg.lstsq(np.column_stack([np.cos(wave), np.sin(wave), np.ones(len(los))]), los)
    weight = float(rpe_weight(at, loop.parameters["weights"]["rpe_window"])) if metric.relative else 1.0
    value = float(linalg.norm(fitted[:2])) * weight / metric.limit
    return {"omega": at, "value": value, "ratio": value / periodic(loop, metric, at, point)}


def main() -> None:
    """Search, compare with the bounds, and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stage", default="fsm+pma")
    parser.add_argument("--seconds", type=float, default=300.0, help="of processor time, all figures together")
    parser.add_argument("--seed", type=int, default=20261123)
    parser.add_argument("--no-run", action="store_true")
    options = parser.parse_args()
    parameters, bounds = load_parameters(), json.loads(SHIPPED.read_text("utf-8"))["figures"]
    open_loop = OpenLoop(control_loop_plant(telescope(), parameters), parameters)
    loop = ImplementedLoop(open_loop, *load_designs("implemented"), options.stage)
    chance = np.random.default_rng(options.seed)
    metrics = figures_of(parameters, options.stage)
    found: dict[str, dict[str, Any]] = {}
    with threadpool_limits(1):
        for name, metric in metrics.items():
            (bound,) = (r["level"] for r in bounds if (r["stage"], r["figure"]) == (options.stage, name))
            until = time.process_time() + options.seconds / len(metrics)
            value, omega, point, climbs = climbed(loop, metric, chance, until)
            row = {"found": value, "bound": bound, "omega": omega, "climbs": climbs}
            row["periodic"] = periodic(loop, metric, omega, point)
            row["values"] = loop.values(point)
            if not options.no_run and name in INDICES:
                row["run"] = measured(loop, metric, omega, point)
            row["kept"] = value <= bound and row["periodic"] <= bound and near(row.get("run"))
            found[name] = row
            sys.stderr.write(f"{options.stage}, {name}: {row}\n")
    print(json.dumps({"stage": options.stage, "seed": options.seed, "figures": found}, indent=1))
    sys.exit(not all(row["kept"] for row in found.values()))


def near(run: dict[str, float] | None) -> bool:
    """Whether a run measured what was predicted; without one nothing is said against it."""
    return run is None or abs(run["ratio"] - 1.0) < CLOSE


if __name__ == "__main__":
    main()
