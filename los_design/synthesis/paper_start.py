"""Starts of a design of the paper's problem: the Kalman observer for K_FSM, random laws for K_PMA, or given ones.

Random laws are compared after a short descent at few parameter points, with K_FSM if both are tuned, and the best of
them is designed. A given start may be of lower order: it gets states that have no effect yet.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lftkit import SampledSystem
from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.tuning import DescentOptions, descend
from lftkit.tuning.responses import ResponseSource, parameters_of
from lftkit.tuning.structures.structures import gain_matrix_of
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.pair_problem import ACTUATORS
from los_design.synthesis.paper_problem import PaperTask
from los_design.synthesis.rounds import TOLERANCE
from los_design.synthesis.start_choice import at_points, largest
from los_design.synthesis.starts import padded, random_law
from los_design.synthesis.store import continuous
from los_design.synthesis.task import first_points
from los_estimator.problem import kalman_of_order

Report = Callable[[str], None]
GAINS = 100.0, 10.0, 1.0, 0.1, 0.0
"""Of a random law: the largest of these at which the loop is stable at the points of the comparison."""
POINTS, STEPS = 4, 40
"""Random points of a comparison beside the nominal one, and steps of its descents."""


def choose_paper_start(
    task: PaperTask,
    options: DesignOptions,
    observer: SampledSystem | None,
    law: SampledSystem | None,
    report: Report,
    compared: list[dict[str, Any]],
) -> FloatArray:
    """Entries of both gain matrices that a design begins with.

    Parameters
    ----------
    task : PaperTask
    options : DesignOptions
    observer : SampledSystem or None
        K_FSM that is given; it stays as it is, or is the start where it is tuned.
    law : SampledSystem or None
        K_PMA that is the start; without it random ones are compared.
    report : callable
        Receives one line for each start that is compared.
    compared : list of dict
        Gets the value of each start before and after its descent.

    Raises
    ------
    ValueError
        No start stabilises the telescope, or a given one is of higher order.
    """
    order, telescope = task.orders[0], task.samples.open_loop.telescope
    if observer is None:
        mirror = gain_matrix_of(kalman_of_order(order, telescope))
    else:
        mirror = gain_matrix_of(padded(continuous(observer).at({}), order))
    if ACTUATORS in task.tuned and law is None:
        return _best_random(task, mirror, options, report, compared)
    force = _law(task, 0, 0.0) if law is None else gain_matrix_of(padded(continuous(law).at({}), task.orders[1]))
    x = parameters_of(task.blocks, [mirror, force])
    if not task.stable(x):
        name = "the Kalman observer" if observer is None else "the start"
        raise InputError(f"{name} must stabilise the telescope, got a loop that is not stable")
    return x


def _best_random(
    task: PaperTask, mirror: FloatArray, options: DesignOptions, report: Report, compared: list[dict[str, Any]]
) -> FloatArray:
    """The best of the random laws beside a K_FSM, after short descents."""
    points = first_points(task, 0 if options.nominal else POINTS)
    small, at = at_points(task, points), [task.samples.open_loop.values(point) for point in points]
    assert isinstance(small, PaperTask)
    problem, reached = small.problem(), list[tuple[float, FloatArray]]()
    for seed in range(max(1, options.starts)):
        laws = (parameters_of(task.blocks, [mirror, _law(task, options.seed + seed, gain)]) for gain in GAINS)
        law = next((law for law in laws if all(task.stable(law, values) for values in at)), None)
        if law is None:
            raise InputError("K_FSM must stabilise the telescope without K_PMA, got one that does not")
        first = largest(problem, law)
        descended = descend(ResponseSource(problem, task.stable), law, DescentOptions(STEPS, TOLERANCE, 0.0)).x
        descended = descended if all(task.stable(descended, values) for values in at) else law
        reached.append((largest(problem, descended), descended))
        compared.append({"seed": options.seed + seed, "first": first, "reached": reached[-1][0]})
        report(f"random K_PMA, seed {options.seed + seed}: {first:.4g}, after a short descent {reached[-1][0]:.4f}")
    return min(reached, key=lambda entry: entry[0])[1]


def _law(task: PaperTask, seed: int, gain: float) -> FloatArray:
    """Gain matrix of a random law of the task's order."""
    return gain_matrix_of(random_law(seed, gain, task.orders[1]))
