"""Making the flown controllers: problems, tuner, files with their birth certificate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fsm_pma_controller.problem import ORDER as ACTUATOR_ORDER
from fsm_pma_controller.problem import actuator_plant, actuator_requirements, actuator_structure
from fsm_pma_controller.runtime import DT
from fsm_pma_controller.skyhook import flown_controller
from los_estimator.kalman import flown_observer
from los_estimator.problem import kalman_start, observer_plant, observer_requirements, observer_structure
from los_testbed.as_flown import flown_loop
from los_testbed.flown_norms import weighted_response
from los_testbed.run_record import commit
from robust_design import (
    Model,
    RobustResult,
    TuningOptions,
    TuningResult,
    WorstCaseOptions,
    tune,
    tune_robust,
)
from titop_plant.simulation import flown_plant
from titop_plant.telescope.assembly import Telescope
from titop_plant.telescope.control_plant import HOLD
from titop_plant.telescope.parameters import (
    Parameters,
    parameter_box,
    parameter_corners,
    parameters_hash,
    uncertain_parameters,
)
from uncertain_systems import SampledSystem, UncertainSystem, state_space

FLOWN_DELAY = 1.5e-3
CAMERA_PERIOD = 0.02
ROOMS = {"k-fsm": "los_estimator", "k-pma": "fsm_pma_controller"}
SCREEN_SAMPLES = 32
SCREEN_BANDS = (50.0, 300.0, 430.0, 520.0, 800.0)
START_SEEDS = (2,)
START_POLES = (20.0, 400.0)
START_GAIN = 100.0
ITERATIONS, ROUNDS, NOMINAL_ITERATIONS = 40, 4, 250
"""Effort of a robust design (in each round) and of a nominal one: what ends it must not be the wall limit, or the
result would depend on the machine's speed."""
VARIANTS = ("flown", "flown_nominal", "paper", "paper_nominal")


@dataclass(frozen=True)
class DesignOptions:
    """What to design and how long to try.

    Parameters
    ----------
    nominal : bool
        On the nominal model alone instead of the whole box of parameters.
    loop_delay : float
        0: the paper's continuous problem; else as flown, with sensor noise and a held camera [s].
    starts : int
        Random starts.
    seed : int
    wall_limit : float
        Seconds.
    workers : int
        Processes for the starts.
    progress : bool
    """

    nominal: bool = False
    loop_delay: float = FLOWN_DELAY
    starts: int = 0
    seed: int = 0
    wall_limit: float = 1800.0
    workers: int = 1
    progress: bool = False

    @property
    def as_flown(self) -> bool:
        """With delay, held camera and noise requirements."""
        return self.loop_delay > 0.0

    @property
    def held(self) -> dict[str, float]:
        """What is held, for the plants: camera frames and commands [s]."""
        if not self.as_flown:
            return {}
        return {"camera_period": CAMERA_PERIOD, "command_hold": min(HOLD, self.loop_delay)}

    @property
    def delay(self) -> float:
        """The loop delay without the mean delay of held commands, which is in the plant [s]."""
        return max(0.0, self.loop_delay - HOLD)

    @property
    def variant(self) -> str:
        """Name of the stored design."""
        return ("flown" if self.as_flown else "paper") + ("_nominal" if self.nominal else "")


def design_file(kind: str, variant: str = "flown") -> Path:
    """Where a design is stored.

    Raises
    ------
    ValueError
        Unknown kind or variant.
    """
    if kind not in ROOMS or variant not in VARIANTS:
        raise ValueError(
            f"expected one of {', '.join(ROOMS)} and one of {', '.join(VARIANTS)}, got {kind!r} and {variant!r}"
        )
    stem = kind.replace("-", "_") + ("" if variant == "flown" else f"_{variant}")
    return Path(str(import_module(ROOMS[kind]).__file__)).parent / "designs" / f"{stem}.json"


def continuous(system: SampledSystem) -> UncertainSystem:
    """The continuous controller that a stored design was sampled from, without washout.

    Raises
    ------
    ValueError
        The file does not hold it.
    """
    matrices = system.provenance.get("continuous")
    if not isinstance(matrices, Mapping):
        raise ValueError(f"{system.name}: the file holds no continuous controller, only the sampled one")
    return state_space(matrices["A"], matrices["B"], matrices["C"], matrices["D"], system.inputs, system.outputs)


def design_observer(telescope: Telescope, parameters: Parameters, options: DesignOptions) -> SampledSystem:
    """Tune K_FSM, started from the Kalman observer: with its delay made up for, on the nominal model also without.

    The tuner gets stuck at some starts (the noise in the relative error is stiff); one model is cheap to try from two.
    """
    plant = observer_plant(telescope, parameters, **options.held)
    structure = observer_structure(plant, held_camera=options.as_flown)
    leads = dict.fromkeys((options.loop_delay, 0.0) if options.nominal else (options.loop_delay,))
    starts = [kalman_start(structure, telescope, parameters, lead=lead) for lead in leads]
    requirements = observer_requirements(parameters, as_flown=options.as_flown)
    first = [] if options.nominal else screened(telescope, parameters, None, options.seed)
    result = _run(plant, requirements, structure, starts, first, parameters, options)
    found = result.controller
    system = state_space(found.A, found.B, found.C, found.D, _ports("k-fsm")[0], _ports("k-fsm")[1])
    return flown_observer(
        system,
        parameters["sensors"]["washout"],
        name=f"K_FSM, {options.variant}",
        provenance=_certificate("k-fsm", result, parameters, options),
    )


def design_actuators(
    telescope: Telescope, parameters: Parameters, observer: SampledSystem, options: DesignOptions
) -> SampledSystem:
    """Tune K_PMA on top of an observer, from random starts."""
    plant = actuator_plant(
        telescope,
        parameters,
        continuous(observer),
        loop_delay=options.delay,
        **options.held,
    )
    requirements = actuator_requirements(parameters, as_flown=options.as_flown)
    structure = actuator_structure(plant)
    starts = [structure.parameters_of(random_start(plant.system, seed)) for seed in START_SEEDS]
    first = [] if options.nominal else screened(telescope, parameters, observer, options.seed)
    result = _run(plant, requirements, structure, starts, first, parameters, options)
    found = result.controller
    system = state_space(found.A, found.B, found.C, found.D, _ports("k-pma")[0], _ports("k-pma")[1])
    return flown_controller(
        system,
        parameters["sensors"]["washout"],
        name=f"K_PMA, {options.variant}",
        provenance=_certificate("k-pma", result, parameters, options),
    )


def screened(
    telescope: Telescope, parameters: Parameters, observer: SampledSystem | None, seed: int
) -> list[dict[str, float]]:
    """Parameter points to begin a robust design with: the worst relative error in each band of peaks.

    Of all corners and some random points, those where the stage before (the isolator alone, or with an observer the
    mirror loop) has its largest peak in each of the bands :data:`SCREEN_BANDS`.
    """
    system, rng = flown_plant(telescope, parameters), np.random.default_rng(seed)
    chosen = parameter_corners(parameters) + system.sample_values(rng, SCREEN_SAMPLES)
    k_fsm, k_pma = observer or _zero_controller("k-fsm"), _zero_controller("k-pma")
    loop, frame_ticks = "isolator" if observer is None else "fsm", round(CAMERA_PERIOD / DT)
    worst: dict[int, tuple[float, dict[str, float]]] = {}
    for values in chosen:
        plant = system.data_at(values)
        closed = flown_loop(plant, k_fsm, k_pma, loop=loop, frame_ticks=frame_ticks)
        omega, _, relative = weighted_response(closed, plant, parameters, SCREEN_BANDS[0])
        band = np.searchsorted(SCREEN_BANDS, omega)
        for i in range(1, len(SCREEN_BANDS)):
            peak = float(relative[band == i].max())
            if peak > worst.get(i, (0.0, {}))[0]:
                worst[i] = (peak, values)
    unique: list[dict[str, float]] = []
    for _, values in worst.values():
        if values not in unique:
            unique.append(values)
    return unique


def _zero_controller(kind: str) -> SampledSystem:
    inputs, outputs = _ports(kind)
    rows, columns = (sum(p.size for p in ports) for ports in (outputs, inputs))
    none = np.zeros((0, 0))
    return SampledSystem(none, none, none, np.zeros((rows, columns)), inputs, outputs, DT, "zero")


def random_start(plant: UncertainSystem, seed: int) -> Model:
    """A stable random K_PMA of order 4 that hardly does anything: poles spread over the isolator's band."""
    rng = np.random.default_rng(seed)
    poles = -np.geomspace(*START_POLES, ACTUATOR_ORDER)
    ports = [plant.output_port("accel_Ip")], [plant.input_port("pma_force")]
    B = rng.standard_normal((ACTUATOR_ORDER, 6))
    C = START_GAIN * rng.standard_normal((6, ACTUATOR_ORDER))
    return Model(np.diag(poles), B, C, np.zeros((6, 6)), *ports, f"start {seed}")  # type: ignore[arg-type]


def _ports(kind: str) -> tuple[Any, Any]:
    runtime = import_module(f"{ROOMS[kind]}.runtime")
    return runtime.INPUTS, runtime.OUTPUTS


def _run(
    plant: Any,
    requirements: Any,
    structure: Any,
    starts: Sequence[Any],
    first: Sequence[Mapping[str, float]],
    parameters: Parameters,
    options: DesignOptions,
) -> RobustResult | TuningResult:
    nominal = {name: p.nominal for name, p in uncertain_parameters(parameters).items()}
    tuning = TuningOptions(
        starts=options.starts,
        seed=options.seed,
        wall_limit=options.wall_limit,
        workers=options.workers,
        iterations=NOMINAL_ITERATIONS if options.nominal else ITERATIONS,
        tolerance=1e-3,
        progress=options.progress,
    )
    if options.nominal:
        models: list[Model] = [plant(nominal)]
        return tune(models, requirements, structure, initial=starts, loop_delay=options.delay, options=tuning)
    search = WorstCaseOptions(samples=32, climbs=1, iterations=4, seed=options.seed)
    return tune_robust(
        plant,
        parameter_box(parameters),
        requirements,
        structure,
        nominal=nominal,
        active=first,
        initial=starts,
        loop_delay=options.delay,
        most_rounds=ROUNDS,
        options=tuning,
        search=search,
    )


def _certificate(
    kind: str, result: RobustResult | TuningResult, parameters: Parameters, options: DesignOptions
) -> dict[str, Any]:
    """Birth certificate of a design."""
    tuning = result.tuning if isinstance(result, RobustResult) else result
    found = tuning.controller
    flags = (" --nominal" if options.nominal else "") + f" --loop-delay {options.loop_delay:g} --seed {options.seed}"
    content: dict[str, Any] = {
        "command": f"los-testbed design {kind}{flags}",
        "commit": commit(),
        "parameters_hash": parameters_hash(parameters),
        "seed": options.seed,
        "loop_delay": options.loop_delay,
        "status": result.status,
        "seconds": round(tuning.seconds, 1),
        "tuned_values": {
            name: float(f"{value:.6g}") for name, value in zip(tuning.requirement_names, tuning.values.max(axis=1))
        },
        "continuous": {key: getattr(found, key).tolist() for key in "ABCD"},
    }
    if isinstance(result, RobustResult):
        content["active_models"] = [dict(values) for values in result.active]
        content["worst_cases"] = [
            {"requirement": w.requirement, "value": w.value, "omega": w.omega, "parameters": dict(w.parameters)}
            for w in result.worst
        ]
    return content
