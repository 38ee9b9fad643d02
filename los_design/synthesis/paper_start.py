"""Starts of a design of the paper's problem: the Kalman observer for K_FSM, random laws for K_PMA.

Random laws are compared after a short descent at few parameter points, with K_FSM if both are tuned, and the best of
them is designed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lftkit import SampledSystem
from lftkit.arrays import FloatArray
from lftkit.tuning import DescentOptions, descend
from lftkit.tuning.responses import ResponseSource, parameters_of
from lftkit.tuning.structures.structures import gain_matrix_of
from los_design.synthesis.options import DesignOptions
from los_design.synthesis.pair_problem import ACTUATORS
from los_design.synthesis.paper_problem import PaperTask
from los_design.synthesis.rounds import TOLERANCE
from los_design.synthesis.start_choice import at_points, largest
from los_design.synthesis.starts import random_law
from los_design.synthesis.store import continuous
from los_design.synthesis.task import first_points
from los_estimator.problem import kalman_of_order
from titop_plant.telescope.assembly import Telescope

Report = Callable[[str], None]
GAINS = 100.0, 10.0, 1.0, 0.1, 0.0
"""Of a random law: the largest of these at which the loop is stable at the points of the comparison."""
POINTS, STEPS = 4, 40
"""Random points of a comparison beside the nominal one, and steps of its descents."""


def choose_paper_start(
    task: PaperTask,
    telescope: Telescope,
    options: DesignOptions,
    observer: SampledSystem | None,
    report: Report,
    compared: list[dict[str, Any]],
) -> FloatArray:
    """Entries of both gain matrices that a design begins with.

    Parameters
    ----------
    task : PaperTask
    telescope : Telescope
    options : DesignOptions
    observer : SampledSystem or None
        K_FSM that is given; it stays as it is, or is the start where both are tuned.
    report : callable
        Receives one line for each start that is compared.
    compared : list of dict
        Gets the value of each start before and after its descent.

    Raises
    ------
    ValueError
        No start stabilises the telescope.
    """
    parameters = task.samples.open_loop.parameters
    guess = kalman_of_order(task.orders[0], telescope, parameters) if observer is None else continuous(observer).at({})
    mirror = gain_matrix_of(guess)
    if ACTUATORS not in task.tuned:
        x = parameters_of(task.blocks, [mirror, _law(task, 0, 0.0)])
        if not task.stable(x):
            raise ValueError("the Kalman observer must stabilise the telescope, got a loop that is not stable")
        return x
    points = first_points(task, 0 if options.nominal else POINTS)
    small, at = at_points(task, points), [task.samples.open_loop.values(point) for point in points]
    assert isinstance(small, PaperTask)
    problem, reached = small.problem(), list[tuple[float, FloatArray]]()
    for seed in range(max(1, options.starts)):
        laws = (parameters_of(task.blocks, [mirror, _law(task, options.seed + seed, gain)]) for gain in GAINS)
        law = next((law for law in laws if all(task.stable(law, values) for values in at)), None)
        if law is None:
            raise ValueError("K_FSM must stabilise the telescope without K_PMA, got one that does not")
        first = largest(problem, law)
        found = descend(ResponseSource(problem, task.stable), law, DescentOptions(STEPS, TOLERANCE, 0.0)).x
        found = found if all(task.stable(found, values) for values in at) else law
        reached.append((largest(problem, found), found))
        compared.append({"seed": options.seed + seed, "first": first, "reached": reached[-1][0]})
        report(f"random K_PMA, seed {options.seed + seed}: {first:.4g}, after a short descent {reached[-1][0]:.4f}")
    return min(reached, key=lambda entry: entry[0])[1]


def _law(task: PaperTask, seed: int, gain: float) -> FloatArray:
    """Gain matrix of a random law of the task's order."""
    return gain_matrix_of(random_law(seed, gain, task.orders[1]))
