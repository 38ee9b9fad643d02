"""Value of the mirror controller's problem over CPU seconds: eight models, as implemented, from the Kalman observer.

    python benchmarks/fsm_value.py --seconds 60 --json > value.json
    python benchmarks/fsm_value.py --picture docs/figures/fsm_value.png value.json [value_of_a_longer_run.json]

The models are the stored design's worst ones and corners of the parameter box. A point is the largest soft value of
the best feasible controller after a round of the smooth phase; ``{"cpu_seconds": [...], "value": [...], "evaluations":
[...]}``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from lftkit.arrays import FloatArray

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from threadpoolctl import threadpool_limits

from lftkit.tuning.descent.grid_source import Point
from lftkit.tuning.descent.smooth_phase import smooth_phase
from lftkit.tuning.problem import Problem
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.state_space_requirements import implemented_requirements
from los_estimator.problem import kalman_start, observer_plant, observer_structure
from titop_plant.telescope.load import load_telescope

DESIGN = Path(__file__).parents[1] / "los_estimator" / "designs" / "k_fsm.json"
MODELS = 8
FRUITLESS = 1e-5  # relative decrease by a smooth phase after which the next one begins elsewhere
PERTURBATIONS = -3.0, -1.0  # decades of the relative size of a perturbation of the best point


def problem_and_start() -> tuple[Problem, FloatArray]:
    """The problem and the Kalman observer's parameters."""
    telescope = load_telescope()
    options = DesignOptions()
    plant = observer_plant(telescope, **options.hold_delays)
    structure = observer_structure(plant, camera_hold=True)
    points = [dict(p) for p in _active_models(json.loads(DESIGN.read_text())) or [{}]]
    corners = telescope.corners()
    order = np.random.default_rng(0).permutation(len(corners))
    points = [*points, *(corners[k] for k in order)][:MODELS]
    models = [plant(p).named(f"m{i}") for i, p in enumerate(points)]
    requirements = implemented_requirements(telescope, "fsm")
    start = kalman_start(structure, telescope, lead=options.loop_delay)
    return Problem(models, requirements, structure, loop_delay=options.delay), start


def _active_models(tree: Any) -> list[dict[str, float]]:
    if isinstance(tree, dict):
        if "active_models" in tree:
            return list(tree["active_models"])
        return next((found for value in tree.values() if (found := _active_models(value))), [])
    return []


def measure(seconds: float) -> dict[str, list[float]]:
    """Descend for about this many CPU seconds.

    A smooth phase that ended by itself is followed by another one from its end and, where that found nothing, by others
    from perturbed copies of the best point.
    """
    problem, x = problem_and_start()
    rows: dict[str, list[float]] = {"cpu_seconds": [], "value": [], "evaluations": []}
    begin = time.process_time()
    time.monotonic = time.process_time  # the clock of the descents
    best, lowest, before = np.inf, x, 0

    def report(point: Point, evaluations: int) -> None:
        value = min(point.soft, best) if point.feasible else best
        if np.isfinite(value):  # JSON has no infinity
            rows["cpu_seconds"].append(time.process_time() - begin)
            rows["value"].append(value)
            rows["evaluations"].append(before + evaluations)

    rng = np.random.default_rng(0)
    while time.process_time() - begin < seconds:
        phase = smooth_phase(problem, x, 1_000_000, begin + seconds, 0.0, report=report)
        before += phase.evaluations
        fruitless = not (phase.point.feasible and phase.point.soft < best * (1.0 - FRUITLESS))
        if phase.point.feasible and phase.point.soft < best:
            lowest, best = phase.point.x, phase.point.soft
        x = perturbed(problem, lowest, rng) if fruitless else lowest
    return rows


def perturbed(problem: Problem, x: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A point near `x` at which all models are stable."""
    while True:
        size = 10.0 ** rng.uniform(*PERTURBATIONS)
        trial = x + size * np.abs(x) * rng.standard_normal(len(x))
        if problem.abscissa(trial) < -problem.min_decay:
            return np.asarray(trial)


def draw(files: list[Path], output: Path) -> None:
    """Picture of one or more runs."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter

    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.subplots()
    for file in files:
        rows = json.loads(file.read_text())
        axes.step(rows["cpu_seconds"], rows["value"], where="post", marker=".", label=file.stem)
    axes.set(xlabel="CPU time [s]", ylabel="largest soft value", yscale="log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xlim(left=0.0)
    axes.grid(visible=True, alpha=0.3)
    if len(files) > 1:
        axes.legend()
    figure.savefig(output, dpi=110)


def main() -> None:
    """Measure, or draw what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="CPU time after which no further round begins")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--picture", type=Path, help="file to draw the measured values of FILE into")
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE")
    options = parser.parse_args()
    if options.picture:
        draw(options.files, options.picture)
        return
    with threadpool_limits(1):
        rows = measure(options.seconds)
    if options.json:
        sys.stdout.write(json.dumps(rows) + "\n")
    else:
        for cpu, value, evaluations in zip(rows["cpu_seconds"], rows["value"], rows["evaluations"]):
            sys.stdout.write(f"{cpu:7.1f} s {value:.5f} ({evaluations:.0f} evaluations)\n")


if __name__ == "__main__":
    main()
