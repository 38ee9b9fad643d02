"""Start of a design of the implemented loop: stored for the reference telescope, the best of several for others.

For another telescope the starts are the stored pair of controllers, the stored start, and the Kalman observer with the
stored K_PMA and with random ones. Where the stored pair does not stabilise the telescope, it is carried over: tuned in
a few steps at telescopes between the reference and this one. The starts that stabilise it are compared at few
parameter points, the best ones after a short descent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from los_design.options import DesignOptions
from los_design.pair_problem import ACTUATORS, Samples, blocks, pair_problem
from los_design.rounds import Task, first_points
from los_design.starts import random_law, stored_start
from los_design.store import continuous, load_designs
from los_estimator.problem import kalman_start, observer_plant, observer_structure
from lti import SampledSystem, StateSpace
from robust_design.frequency_domain import DescentOptions, ResponseProblem, descend, parameters_of
from titop_plant.telescope.assembly import Telescope
from titop_plant.telescope.parameters import Parameters, load_parameters, parameters_hash

FloatArray = NDArray[np.float64]
Pair = Sequence[FloatArray]
"""Gain matrices ``[A, B; C, D]`` of K_FSM and K_PMA."""
Report = Callable[[str], None]
CORNERS = 8
"""Random corners of the box at which a start must be stable, beside the nominal point."""
LAW_SEEDS, LAW_GAINS = (2, 3, 4), (100.0, 10.0, 1.0, 0.0)
"""Random K_PMA beside the Kalman observer: of each seed the one with the largest of these gains that is stable."""
POINTS, STEPS, COMPARED, GOOD = 6, 12, 3, 1.0
"""Random points of a comparison, steps of its descents, how many starts descend, and the value that ends it."""
TELESCOPES, SMALLEST, TUNED = 8, 1.0 / 16.0, 12
"""Carrying over: most telescopes on the way, smallest part of the way in one step, steps of the descent at each."""
STORED_START = "the stored start"


def choose_start(
    task: Task,
    task_of: Callable[[Parameters], Task],
    telescope: Telescope,
    parameters: Parameters,
    options: DesignOptions,
    observer: SampledSystem | None,
    report: Report,
) -> FloatArray:
    """Entries of both gain matrices that a design begins with.

    Parameters
    ----------
    task : Task
    task_of : callable
        The same task for other parameters of the telescope.
    telescope, parameters
        Assembled telescope and its parameters.
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
    given = None if observer is None else gain_matrix(continuous(observer).data_at({}))
    own, at = blocks(parameters, task.tuned), _corners(task, options.seed)

    def stable(pair: Pair) -> bool:
        x = parameters_of(own, pair)
        return all(task.stable(x, values) for values in at)

    stored = [given if given is not None else gain_matrix(stored_start("k-fsm")), gain_matrix(stored_start("k-pma"))]
    if parameters_hash(parameters) == parameters_hash(load_parameters()) and stable(stored):
        return parameters_of(own, stored)
    report("another telescope than that of the stored start: starts are compared")
    k_fsm, k_pma = (gain_matrix(continuous(system).data_at({})) for system in load_designs("implemented"))
    pair = [given if given is not None else k_fsm, k_pma]
    starts: dict[str, Pair] = {"the stored pair": pair, STORED_START: stored}
    if given is None:
        starts["the Kalman observer with the stored K_PMA"] = [_kalman(telescope, parameters, options), k_pma]
    found = {name: parameters_of(own, start) for name, start in starts.items() if stable(start)}
    if "the stored pair" not in found:
        carried = _carried_over(task_of, parameters_of(own, pair), parameters, options, report)
        found |= {} if carried is None else {"the stored pair, carried over": carried}
    if ACTUATORS in task.tuned:
        first = given if given is not None else starts["the Kalman observer with the stored K_PMA"][0]
        for seed in LAW_SEEDS:
            laws = ([first, gain_matrix(random_law(seed, gain))] for gain in LAW_GAINS)
            law = next((start for start in laws if stable(start)), None)
            found |= {} if law is None else {f"a random K_PMA, seed {seed}": parameters_of(own, law)}
    if not found:
        raise ValueError("K_FSM must stabilise the telescope with a small K_PMA, got one that does not")
    return _best(task, found, 0 if options.nominal else POINTS, report)


def _corners(task: Task, seed: int) -> list[dict[str, float]]:
    """The nominal point and random corners."""
    loop, rng = task.samples.open_loop, np.random.default_rng(seed)
    return [{}, *(loop.values(point) for point in np.round(rng.uniform(size=(CORNERS, len(loop.names)))))]


def _kalman(telescope: Telescope, parameters: Parameters, options: DesignOptions) -> FloatArray:
    structure = observer_structure(observer_plant(telescope, parameters, **options.hold_delays), camera_hold=True)
    return structure.gain_matrix(kalman_start(structure, telescope, parameters, lead=options.loop_delay))


def _best(task: Task, found: Mapping[str, FloatArray], points: int, report: Report) -> FloatArray:
    """The start with the lowest largest value after a short descent at few points."""
    problem, values = _few_points(task, points), {}
    for name, x in found.items():
        value = _largest(problem, x)
        values[name] = value if np.isfinite(value) else np.inf
    reached: dict[str, tuple[float, FloatArray]] = {}
    for name in sorted(found, key=lambda name: values[name])[:COMPARED]:
        x = _descended(task, problem, found[name], points, STEPS)
        value = _largest(problem, x)
        reached[name] = value if np.isfinite(value) else np.inf, x
        report(f"start from {name}: {values[name]:.4f}, after a short descent {value:.4f}")
        if value < GOOD:
            break
    return min(reached.values(), key=lambda entry: entry[0])[1]


def _few_points(task: Task, points: int) -> ResponseProblem:
    samples = Samples(task.samples.open_loop)
    samples.add(np.array(first_points(task, points)))
    return pair_problem(samples, task.stages, task.tuned, task.workers.count)


def _descended(task: Task, problem: ResponseProblem, x: FloatArray, points: int, steps: int) -> FloatArray:
    """Result of a descent, or its start where the result is not stable at all of the points."""
    at = [task.samples.open_loop.values(point) for point in first_points(task, points)]
    if not np.isfinite(_largest(problem, x)):
        return x
    lower = descend(problem, x, task.stable, DescentOptions(iterations=steps, target=0.97)).x
    return lower if all(task.stable(lower, values) for values in at) else x


def _largest(problem: ResponseProblem, x: FloatArray) -> float:
    return max(float(problem.values(x).max()), float(problem.noise(x).max(initial=0.0)))


def _carried_over(
    task_of: Callable[[Parameters], Task], x: FloatArray, parameters: Parameters, options: DesignOptions, report: Report
) -> FloatArray | None:
    """A pair that stabilises the reference telescope, tuned on the way to another one until it stabilises that.

    A step of the way that the pair does not bear is halved. None where that is too small, or the way too long.
    """
    reference, reached, step = load_parameters(), 0.0, 0.5
    for _ in range(TELESCOPES):
        ahead = min(1.0, reached + step)
        try:
            task = task_of(between(reference, parameters, ahead))
        except ValueError:  # no telescope: a residual mass that is negative, for example
            task = None
        if task is None or not all(task.stable(x, values) for values in _corners(task, options.seed)):
            step /= 2.0
            if step < SMALLEST:
                return None
            continue
        report(f"the stored pair stabilises a telescope at {ahead:.3g} of the way")
        if ahead == 1.0:
            return x
        reached, step = ahead, min(2.0 * step, 1.0 - ahead)
        x = _descended(task, _few_points(task, POINTS), x, POINTS, TUNED)
    return None


def between(one: Any, other: Any, part: float) -> Any:
    """Parameters at a part of the way from one telescope to another: real numbers change, all else is the other's.

    Examples
    --------
    >>> between({"mass": 2.0, "modes": 3, "k": [1.0, 2.0]}, {"mass": 4.0, "modes": 5, "k": [3.0, 2.0]}, 0.25)
    {'mass': 2.5, 'modes': 5, 'k': [1.5, 2.0]}
    """
    if isinstance(other, Mapping) and isinstance(one, Mapping):
        return {key: between(one[key], value, part) if key in one else value for key, value in other.items()}
    if isinstance(other, list) and isinstance(one, list) and len(one) == len(other):
        return [between(a, b, part) for a, b in zip(one, other)]
    if isinstance(other, float) and isinstance(one, (int, float)) and not isinstance(one, bool):
        return other if part == 1.0 else one + part * (other - one)
    return other


def gain_matrix(system: StateSpace) -> FloatArray:
    """``[A, B; C, D]``."""
    return np.block([[system.A, system.B], [system.C, system.D]])
