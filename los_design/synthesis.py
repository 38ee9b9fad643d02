"""Synthesis of the two controllers: design problem, tuner, sampled controller with its provenance.

A robust design of the implemented loop is made in rounds (:mod:`los_design.rounds`): tune, search the sampled loop for
worse parameters, add them. Nominal designs and those of the paper's continuous problem use the tuner's own scheme.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fsm_pma_controller.problem import FORCE_SHARE, actuator_plant, actuator_requirements, actuator_structure
from fsm_pma_controller.skyhook import sampled_controller
from los_design.options import DesignOptions
from los_design.provenance import commit
from los_design.rounds import Effort, Outcome, Task, design_in_rounds
from los_design.starts import random_start, screened, stabilises, stored_start, zero_controller
from los_design.store import continuous, design_ports
from los_design.worst_points import Search, SearchOptions
from los_estimator.kalman import sampled_observer
from los_estimator.problem import kalman_start, observer_plant, observer_requirements, observer_structure
from lti import SampledSystem, StateSpace, state_space
from robust_design import RobustResult, TuningOptions, TuningResult, WorstCaseOptions, tune, tune_robust
from robust_design.structures import controller
from titop_plant.simulation import control_loop_plant
from titop_plant.structures.kinematics import FloatArray
from titop_plant.telescope.assembly import Telescope
from titop_plant.telescope.budget import MAX_SENSITIVITY, TUNED_FORCE_SENSITIVITY, TUNED_SENSITIVITY, error_budget
from titop_plant.telescope.parameters import Parameters, design_basis, parameter_box, uncertain_parameters

START_SEEDS = (2,)
MAX_ITERATIONS, MAX_ROUNDS, MAX_NOMINAL_ITERATIONS = 40, 4, 250
"""Effort of a robust design of the paper's problem (iterations in each round) and of a nominal one. These limits end a
design, not the wall limit: otherwise the result would depend on the speed of the machine."""
WORST_CASE_SEARCH = {"samples": 32, "climbs": 1, "iterations": 4}
"""Effort of the worst-case search of the paper's problem, see :class:`robust_design.WorstCaseOptions`."""

RELAXATIONS = ((1.0, 15), (0.5, 15))
"""Steps from the Kalman observer to the budget: relaxation of the requirements and iterations."""

FIRST_POINTS, FIRST_SEARCH = 5, SearchOptions(frequencies=200, points=40, ascents=40, iterations=15)
"""Worst points of the start, each in another frequency band, that a design begins with, and their search."""

QUICK = SearchOptions(frequencies=300, points=40, ascents=60, iterations=25)
THOROUGH = SearchOptions(frequencies=500, points=60, ascents=200, iterations=30, seed=1000)
EFFORT = Effort(rounds=8, iterations=25, quick=QUICK, thorough=THOROUGH)
SHORT_EFFORT = Effort(rounds=3, iterations=15, quick=FIRST_SEARCH, thorough=QUICK)
"""Effort of a design in rounds; the short one is for trials and tests."""

GOAL = 0.96
"""A round's tuning ends when every requirement is met with this to spare: what is left is for points not yet known."""

Report = Callable[[str], None]


def _silent(text: str) -> None:
    """Report nothing."""


def design_observer(
    telescope: Telescope, parameters: Parameters, options: DesignOptions, report: Report = _silent
) -> SampledSystem:
    """Tune K_FSM from the Kalman observer.

    Parameters
    ----------
    telescope, parameters
        Assembled telescope and its parameters.
    options : DesignOptions
    report : callable
        Receives one line for each step.

    Returns
    -------
    SampledSystem
        K_FSM with the washout, ports of :mod:`los_estimator.runtime`; its provenance holds command, commit, parameters
        hash, seed, status, tuned values and the continuous controller.
    """
    plant = observer_plant(telescope, parameters, **options.hold_delays)
    structure = observer_structure(plant, camera_hold=options.implemented)
    if options.implemented:
        result: Outcome | RobustResult | TuningResult = _implemented_observer(
            telescope, parameters, plant, structure, options, report
        )
    else:
        starts = [kalman_start(structure, telescope, parameters)]
        active = [] if options.nominal else screened(telescope, parameters, None, options.seed)
        requirements = observer_requirements(parameters, implemented=False)
        result = _run(plant, requirements, structure, starts, active, parameters, options)
    tuned = result.controller
    system = state_space(tuned.A, tuned.B, tuned.C, tuned.D, design_ports("k-fsm")[0], design_ports("k-fsm")[1])
    return sampled_observer(
        system,
        parameters["sensors"]["washout"],
        name=f"K_FSM, {options.variant}",
        basis=design_basis(parameters),
        provenance=_provenance("k-fsm", result, options),
    )


def _implemented_observer(
    telescope: Telescope, parameters: Parameters, plant: Any, structure: Any, options: DesignOptions, report: Report
) -> Outcome | TuningResult:
    """From the stored start, or the Kalman observer in steps, to the budget; a robust design in rounds."""
    system, none = control_loop_plant(telescope, parameters), zero_controller("k-pma")
    active: list[dict[str, float]] = [{}]
    if not options.nominal:
        isolator = Search(system, parameters, zero_controller("k-fsm"), none, "isolator", FIRST_SEARCH)
        active += [dict(p.parameters) for p in isolator.run(["fast"])["fast"][: FIRST_POINTS // 2]]
    models = [plant(values) for values in active]
    x = structure.parameters_of(stored_start("k-fsm", plant.system))
    if not stabilises(x, models, structure, options.delay):
        report("the stored start does not stabilise this telescope: start from the Kalman observer")
        x = kalman_start(structure, telescope, parameters, lead=options.loop_delay)
        for relaxation, iterations in RELAXATIONS:
            relaxed = observer_requirements(parameters, implemented=True, relaxation=relaxation)
            limits = _tuning(options, iterations)
            found = tune(models, relaxed, structure, initial=[x], loop_delay=options.delay, options=limits)
            x = found.x
            report(f"requirements relaxed by {relaxation:g}: tuned {found.soft:.3f}")
    requirements = observer_requirements(parameters, implemented=True)
    if options.nominal:
        limits = _tuning(options, MAX_NOMINAL_ITERATIONS)
        return tune(models, requirements, structure, initial=[x], loop_delay=options.delay, options=limits)
    washout, basis = parameters["sensors"]["washout"], design_basis(parameters)

    def sampled(K: StateSpace) -> SampledSystem:
        ported = state_space(K.A, K.B, K.C, K.D, *design_ports("k-fsm"))
        return sampled_observer(ported, washout, name="K_FSM", basis=basis)

    def search(k_fsm: SampledSystem, effort: SearchOptions) -> Search:
        return Search(system, parameters, k_fsm, none, "fsm", effort)

    budget, limit = error_budget(parameters), parameters["weights"]["rpe_limit"]
    bounds = {
        "APE": ("APE", 1.0),
        "slow": ("slow", limit / budget.slow),
        "fast": ("fast", limit / budget.fast_mirror),
        "mirror": ("mirror", 1.0),
        "sensitivity, mirror": ("sensitivity", MAX_SENSITIVITY / TUNED_SENSITIVITY),
    }
    task = Task(plant, requirements, structure, options.delay, sampled, search, bounds)
    effort = SHORT_EFFORT if options.short else EFFORT
    active = [{}, *_first_points(search(sampled(controller(structure, x)), FIRST_SEARCH))]
    return design_in_rounds(task, x, active, effort, _tuning(options, effort.iterations, GOAL), report)


def _first_points(search: Search) -> list[dict[str, float]]:
    """Parameters of the worst fast tones of different bands."""
    return [dict(p.parameters) for p in search.run(["fast"])["fast"][:FIRST_POINTS]]


def design_actuators(
    telescope: Telescope,
    parameters: Parameters,
    observer: SampledSystem,
    options: DesignOptions,
    report: Report = _silent,
) -> SampledSystem:
    """Tune K_PMA with the mirror loop of an observer closed, from random starts.

    Parameters
    ----------
    telescope, parameters
        Assembled telescope and its parameters.
    observer : SampledSystem
        K_FSM with its continuous form in the provenance.
    options : DesignOptions
    report : callable
        Receives one line for each step.

    Returns
    -------
    SampledSystem
        K_PMA with the washout, ports of :mod:`fsm_pma_controller.runtime`; provenance as for K_FSM.
    """
    plant = actuator_plant(
        telescope,
        parameters,
        continuous(observer),
        loop_delay=options.delay,
        **options.hold_delays,
    )
    structure = actuator_structure(plant)
    starts = [structure.parameters_of(random_start(plant.system, seed)) for seed in START_SEEDS]
    if options.implemented:
        stored = structure.parameters_of(stored_start("k-pma", plant.system))
        if stabilises(stored, [plant({})], structure, options.delay):
            starts = [stored]
    if options.implemented and not options.nominal:
        result: Any = _implemented_actuators(
            telescope, parameters, observer, plant, structure, starts[0], options, report
        )
    else:
        requirements = actuator_requirements(parameters, implemented=options.implemented)
        active = [] if options.nominal else screened(telescope, parameters, observer, options.seed)
        result = _run(plant, requirements, structure, starts, active, parameters, options)
    tuned = result.controller
    system = state_space(tuned.A, tuned.B, tuned.C, tuned.D, design_ports("k-pma")[0], design_ports("k-pma")[1])
    return sampled_controller(
        system,
        parameters["sensors"]["washout"],
        name=f"K_PMA, {options.variant}",
        basis=design_basis(parameters),
        provenance=_provenance("k-pma", result, options),
    )


def _implemented_actuators(
    telescope: Telescope,
    parameters: Parameters,
    observer: SampledSystem,
    plant: Any,
    structure: Any,
    start: FloatArray,
    options: DesignOptions,
    report: Report,
) -> Outcome:
    """In rounds, beginning with the worst points of the mirror alone and of the start."""
    washout, basis = parameters["sensors"]["washout"], design_basis(parameters)
    system = control_loop_plant(telescope, parameters)

    def sampled(K: StateSpace) -> SampledSystem:
        ported = state_space(K.A, K.B, K.C, K.D, *design_ports("k-pma"))
        return sampled_controller(ported, washout, name="K_PMA", basis=basis)

    def search(k_pma: SampledSystem, effort: SearchOptions) -> Search:
        return Search(system, parameters, observer, k_pma, "fsm+pma", effort)

    effort = SHORT_EFFORT if options.short else EFFORT
    alone = Search(system, parameters, observer, zero_controller("k-pma"), "fsm", FIRST_SEARCH)
    active = [{}, *_first_points(alone)]
    budget, fine = error_budget(parameters), parameters["weights"]["rpe_limit_fine"]
    bounds = {
        "fast": ("fast", fine / budget.fast),
        "slow": ("slow", fine / budget.tone),
        "force": ("force", 1.0 / FORCE_SHARE),
        "APE": ("APE", 1.0),
        "mirror": ("mirror", 1.0),
        "sensitivity, mirror": ("sensitivity, mirror", 1.0),
        "sensitivity, forces": ("sensitivity, forces", MAX_SENSITIVITY / TUNED_FORCE_SENSITIVITY),
    }
    requirements = actuator_requirements(parameters, implemented=True)
    task = Task(plant, requirements, structure, options.delay, sampled, search, bounds)
    return design_in_rounds(task, start, active, effort, _tuning(options, effort.iterations, GOAL), report)


def _tuning(options: DesignOptions, iterations: int, target: float = -np.inf) -> TuningOptions:
    return TuningOptions(
        starts=options.starts,
        seed=options.seed,
        wall_limit=options.wall_limit,
        workers=options.workers,
        iterations=iterations,
        tolerance=1e-3,
        target=target,
        progress=options.progress,
    )


def _run(
    plant: Any,
    requirements: Any,
    structure: Any,
    starts: Sequence[Any],
    active: Sequence[Mapping[str, float]],
    parameters: Parameters,
    options: DesignOptions,
) -> RobustResult | TuningResult:
    nominal = {name: p.nominal for name, p in uncertain_parameters(parameters).items()}
    tuning = _tuning(options, MAX_NOMINAL_ITERATIONS if options.nominal else MAX_ITERATIONS)
    if options.nominal:
        models: list[StateSpace] = [plant(nominal)]
        return tune(models, requirements, structure, initial=starts, loop_delay=options.delay, options=tuning)
    search = WorstCaseOptions(**WORST_CASE_SEARCH, seed=options.seed)
    return tune_robust(
        plant,
        parameter_box(parameters),
        requirements,
        structure,
        nominal=nominal,
        active=active,
        initial=starts,
        loop_delay=options.delay,
        max_rounds=MAX_ROUNDS,
        options=tuning,
        search=search,
    )


def _provenance(kind: str, result: RobustResult | TuningResult | Outcome, options: DesignOptions) -> dict[str, Any]:
    """How a design was made, for its file."""
    tuning = result if isinstance(result, TuningResult) else result.tuning
    flags = (" --nominal" if options.nominal else "") + f" --loop-delay {options.loop_delay:g} --seed {options.seed}"
    flags += f" --starts {options.starts}" if options.starts else ""
    content: dict[str, Any] = {
        "command": f"los-testbed design {kind}{flags}",
        "commit": commit(),
        "seed": options.seed,
        "loop_delay": options.loop_delay,
        "status": str(result.status),
        "seconds": round(tuning.seconds, 1),
        "tuned_values": {
            name: float(f"{value:.6g}") for name, value in zip(tuning.requirement_names, tuning.values.max(axis=1))
        },
        "continuous": {key: getattr(tuning.controller, key).tolist() for key in "ABCD"},
    }
    if not isinstance(result, TuningResult):
        content["active_models"] = [dict(values) for values in result.active]
    if isinstance(result, RobustResult):
        content["worst_cases"] = [
            {"requirement": w.requirement, "value": w.value, "omega": w.omega, "parameters": dict(w.parameters)}
            for w in result.worst
        ]
    elif isinstance(result, Outcome):
        content["worst_cases"] = result.worst_cases()
    return content
