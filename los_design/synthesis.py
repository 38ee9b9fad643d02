"""Synthesis of the two controllers: design problem, tuner, sampled controller with its provenance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fsm_pma_controller.problem import actuator_plant, actuator_requirements, actuator_structure
from fsm_pma_controller.skyhook import sampled_controller
from los_design.options import DesignOptions
from los_design.provenance import commit
from los_design.starts import random_start, screened
from los_design.store import continuous, design_ports
from los_estimator.kalman import sampled_observer
from los_estimator.problem import kalman_start, observer_plant, observer_requirements, observer_structure
from lti import SampledSystem, StateSpace, state_space
from robust_design import RobustResult, TuningOptions, TuningResult, WorstCaseOptions, tune, tune_robust
from titop_plant.telescope.assembly import Telescope
from titop_plant.telescope.parameters import Parameters, design_basis, parameter_box, uncertain_parameters

START_SEEDS = (2,)
MAX_ITERATIONS, MAX_ROUNDS, MAX_NOMINAL_ITERATIONS = 40, 4, 250
"""Effort of a robust design (iterations in each round) and of a nominal one. These limits end a design, not the wall
limit: otherwise the result would depend on the speed of the machine."""
WORST_CASE_SEARCH = {"samples": 32, "climbs": 1, "iterations": 4}
"""Effort of the worst-case search of a robust design, see :class:`robust_design.WorstCaseOptions`."""


def design_observer(telescope: Telescope, parameters: Parameters, options: DesignOptions) -> SampledSystem:
    """Tune K_FSM from the Kalman observer with delay compensation; a nominal design also from the one without.

    Parameters
    ----------
    telescope, parameters
        Assembled telescope and its parameters.
    options : DesignOptions

    Returns
    -------
    SampledSystem
        K_FSM with the washout, ports of :mod:`los_estimator.runtime`; its provenance holds command, commit, parameters
        hash, seed, status, tuned values and the continuous controller.
    """
    plant = observer_plant(telescope, parameters, **options.hold_delays)
    structure = observer_structure(plant, camera_hold=options.implemented)
    leads = dict.fromkeys((options.loop_delay, 0.0) if options.nominal else (options.loop_delay,))
    starts = [kalman_start(structure, telescope, parameters, lead=lead) for lead in leads]
    requirements = observer_requirements(parameters, implemented=options.implemented)
    active = [] if options.nominal else screened(telescope, parameters, None, options.seed)
    result = _run(plant, requirements, structure, starts, active, parameters, options)
    tuned = result.controller
    system = state_space(tuned.A, tuned.B, tuned.C, tuned.D, design_ports("k-fsm")[0], design_ports("k-fsm")[1])
    return sampled_observer(
        system,
        parameters["sensors"]["washout"],
        name=f"K_FSM, {options.variant}",
        basis=design_basis(parameters),
        provenance=_provenance("k-fsm", result, parameters, options),
    )


def design_actuators(
    telescope: Telescope, parameters: Parameters, observer: SampledSystem, options: DesignOptions
) -> SampledSystem:
    """Tune K_PMA with the mirror loop of an observer closed, from random starts.

    Parameters
    ----------
    telescope, parameters
        Assembled telescope and its parameters.
    observer : SampledSystem
        K_FSM with its continuous form in the provenance.
    options : DesignOptions

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
    requirements = actuator_requirements(parameters, implemented=options.implemented)
    structure = actuator_structure(plant)
    starts = [structure.parameters_of(random_start(plant.system, seed)) for seed in START_SEEDS]
    active = [] if options.nominal else screened(telescope, parameters, observer, options.seed)
    result = _run(plant, requirements, structure, starts, active, parameters, options)
    tuned = result.controller
    system = state_space(tuned.A, tuned.B, tuned.C, tuned.D, design_ports("k-pma")[0], design_ports("k-pma")[1])
    return sampled_controller(
        system,
        parameters["sensors"]["washout"],
        name=f"K_PMA, {options.variant}",
        basis=design_basis(parameters),
        provenance=_provenance("k-pma", result, parameters, options),
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
    tuning = TuningOptions(
        starts=options.starts,
        seed=options.seed,
        wall_limit=options.wall_limit,
        workers=options.workers,
        iterations=MAX_NOMINAL_ITERATIONS if options.nominal else MAX_ITERATIONS,
        tolerance=1e-3,
        progress=options.progress,
    )
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


def _provenance(
    kind: str, result: RobustResult | TuningResult, parameters: Parameters, options: DesignOptions
) -> dict[str, Any]:
    """How a design was made, for its file."""
    tuning = result.tuning if isinstance(result, RobustResult) else result
    flags = (" --nominal" if options.nominal else "") + f" --loop-delay {options.loop_delay:g} --seed {options.seed}"
    flags += f" --starts {options.starts}" if options.starts else ""
    content: dict[str, Any] = {
        "command": f"los-testbed design {kind}{flags}",
        "commit": commit(),
        "seed": options.seed,
        "loop_delay": options.loop_delay,
        "status": result.status,
        "seconds": round(tuning.seconds, 1),
        "tuned_values": {
            name: float(f"{value:.6g}") for name, value in zip(tuning.requirement_names, tuning.values.max(axis=1))
        },
        "continuous": {key: getattr(tuning.controller, key).tolist() for key in "ABCD"},
    }
    if isinstance(result, RobustResult):
        content["active_models"] = [dict(values) for values in result.active]
        content["worst_cases"] = [
            {"requirement": w.requirement, "value": w.value, "omega": w.omega, "parameters": dict(w.parameters)}
            for w in result.worst
        ]
    return content
