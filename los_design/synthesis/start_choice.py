"""Start of a design of the implemented loop: stored for the reference telescope, the best of several for others.

For another telescope the starts are the stored pair of controllers, the stored start, and the Kalman observer with the
stored K_PMA and with random ones. Those that stabilise it are compared at few parameter points, the best ones after a
short descent. With its margins the stored pair stabilises telescopes that differ much from the reference: isolators of
a 25th or four times of the stiffness, 200 kg more in the payload.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from lftkit import SampledSystem
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.tuning import DescentOptions, descend
from lftkit.tuning.responses import ControllerBlock, ResponseProblem, ResponseSource, parameters_of
from lftkit.tuning.structures.structures import gain_matrix_of
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.pair_problem import ACTUATORS, blocks
from los_design.synthesis.rounds import TOLERANCE
from los_design.synthesis.starts import random_law, stored_start
from los_design.synthesis.store import continuous, load_designs, of_shipped_designs
from los_design.synthesis.task import Task, first_points
from los_estimator.problem import kalman_start, observer_plant, observer_structure
from titop_plant.telescope.telescope import Telescope

Pair = Sequence[FloatArray]
"""Gain matrices ``[A, B; C, D]`` of K_FSM and K_PMA."""
Report = Callable[[str], None]
CORNERS = 8
"""Random corners of the box at which a start must be stable, beside the nominal point."""
LAW_SEEDS, LAW_GAINS = (2, 3, 4), (100.0, 10.0, 1.0, 0.0)
"""Random K_PMA beside the Kalman observer: of each seed the one with the largest of these gains that is stable."""
POINTS, STEPS, COMPARED, GOOD = 6, 12, 2, 1.0
"""Random points of a comparison, steps of its descents, how many starts descend, and the value that ends it."""
DEVICE_PART, WITH_DEVICES = 0.1, ", with some use of the sensors and actuators at places"
"""What such a start uses of them, beside its use of the platform's accelerometer and of the forces: from exact zero,
steps in proportion to the size of an entry would hardly leave."""
STORED_START, STORED_PAIR, KALMAN = "the stored start", "the stored pair", "the Kalman observer with the stored K_PMA"


def choose_start(
    task: Task,
    telescope: Telescope,
    options: DesignOptions,
    observer: SampledSystem | None,
    report: Report,
) -> FloatArray:
    """Entries of both gain matrices that a design begins with.

    Parameters
    ----------
    task : Task
    telescope : Telescope
    options : DesignOptions
    observer : SampledSystem or None
        K_FSM that is given, if it is not tuned.
    report : callable
        Receives one line for each start that is compared.

    Raises
    ------
    ValueError
        No start stabilises the telescope.
    """
    gain_matrix = None if observer is None else gain_matrix_of(continuous(observer).at({}))
    tunable, at = blocks(telescope, task.tuned), _corners(task, options.seed)

    def entries(pair: Pair, part: float = 0.0) -> FloatArray:
        return parameters_of(tunable, [_widened(M, block, part) for M, block in zip(pair, tunable)])

    def stable(x: FloatArray) -> bool:
        return all(task.stable(x, values) for values in at)

    stored = [
        gain_matrix if gain_matrix is not None else gain_matrix_of(stored_start("k-fsm")),
        gain_matrix_of(stored_start("k-pma")),
    ]
    devices = bool(telescope.placed_sensors or telescope.placed_actuators)
    if of_shipped_designs(telescope) and not devices and stable(entries(stored)):
        return entries(stored)
    report("another telescope than that of the stored start: starts are compared")
    k_fsm, k_pma = (gain_matrix_of(continuous(system).at({})) for system in load_designs("implemented"))
    starts: dict[str, Pair] = {
        STORED_PAIR: [gain_matrix if gain_matrix is not None else k_fsm, k_pma],
        STORED_START: stored,
    }
    if gain_matrix is None:
        starts[KALMAN] = [_kalman(telescope, options), k_pma]
    if ACTUATORS in task.tuned:
        mirror = starts[STORED_PAIR if gain_matrix is not None else KALMAN][0]
        for seed in LAW_SEEDS:
            laws = ([mirror, gain_matrix_of(random_law(seed, gain))] for gain in LAW_GAINS)
            starts[f"a random K_PMA, seed {seed}"] = next((start for start in laws if stable(entries(start))), [])
    made = {name: entries(start) for name, start in starts.items() if start}
    if devices:
        made |= {f"{name}{WITH_DEVICES}": entries(start, DEVICE_PART) for name, start in starts.items() if start}
    candidates = {name: x for name, x in made.items() if stable(x)}
    if not candidates:
        raise InputError("K_FSM must stabilise the telescope with a small K_PMA, got one that does not")
    return _best(task, candidates, 0 if options.nominal else POINTS, report)


def _widened(M: FloatArray, block: ControllerBlock, part: float) -> FloatArray:
    """A gain matrix with columns and rows of sensors and actuators at places: random, `part` of the size of others."""
    n, (rows, columns) = block.order, block.shape
    out = np.zeros((rows, columns))
    out[: len(M), : M.shape[1]] = M
    rng = np.random.default_rng(0)
    if columns > M.shape[1] and block.free[0, -1]:
        size = float(np.sqrt(np.mean(M[:n, n : n + 3] ** 2)))
        out[:n, M.shape[1] :] = part * size * rng.standard_normal((n, columns - M.shape[1]))
    if rows > len(M) and block.free[-1, 0]:
        size = float(np.sqrt(np.mean(M[n:, :n] ** 2)))
        out[len(M) :, :n] = part * size * rng.standard_normal((rows - len(M), n))
    return out


def _corners(task: Task, seed: int) -> list[dict[str, float]]:
    """The nominal point and random corners."""
    loop, rng = task.samples.open_loop, np.random.default_rng(seed)
    return [{}, *(loop.values(point) for point in np.round(rng.uniform(size=(CORNERS, len(loop.names)))))]


def _kalman(telescope: Telescope, options: DesignOptions) -> FloatArray:
    structure = observer_structure(observer_plant(telescope, **options.hold_delays), camera_hold=True)
    return structure.gain_matrix(kalman_start(structure, telescope, lead=options.loop_delay))


def _best(task: Task, candidates: Mapping[str, FloatArray], count: int, report: Report) -> FloatArray:
    """The start with the lowest largest value after a short descent at few points."""
    points = first_points(task, count)
    problem = at_points(task, points).problem()
    at = [task.samples.open_loop.values(point) for point in points]
    values = {name: largest(problem, x) for name, x in candidates.items()}
    reached: list[tuple[float, FloatArray]] = []
    for name in sorted(candidates, key=lambda name: values[name])[:COMPARED]:
        x = descended(task, problem, candidates[name])
        if not all(task.stable(x, point) for point in at):
            x = candidates[name]
        value = largest(problem, x)
        report(f"start from {name}: {values[name]:.4f}, after a short descent {value:.4f}")
        reached.append((value, x))
        if value < GOOD:
            break
    return min(reached, key=lambda entry: entry[0])[1]


def at_points(task: Task, points: Sequence[FloatArray]) -> Task:
    """The same task with samples at some points alone."""
    samples = type(task.samples)(task.samples.open_loop)
    samples.add(np.array(points))
    return replace(task, samples=samples)


def descended(task: Task, problem: ResponseProblem, x: FloatArray) -> FloatArray:
    """Result of a short descent."""
    if not np.isfinite(largest(problem, x)):
        return x
    options = DescentOptions(iterations=STEPS, tolerance=TOLERANCE, target=0.97)
    return descend(ResponseSource(problem, task.stable), x, options).x


def largest(problem: ResponseProblem, x: FloatArray) -> float:
    """Largest value of all gains and noises; infinite where a loop is singular."""
    value = max(float(problem.values(x).max()), float(problem.noise(x).max(initial=0.0)))
    return value if np.isfinite(value) else np.inf
