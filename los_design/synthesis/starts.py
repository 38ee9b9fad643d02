"""Starts of a robust design: parameter points at which the previous stage is worst, and random controllers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from fsm_pma_controller.problem import ORDER as ACTUATOR_ORDER
from lftkit import SampledSystem, System
from lftkit.systems.ports import spread_columns
from los_design.synthesis.store import design_ports
from los_loop.sampled_loop import sampled_loop
from los_loop.sampled_loop_norms import weighted_response
from titop_plant.interface import DT, K_PMA_INPUTS
from titop_plant.simulation.build import control_loop_plant
from titop_plant.telescope.assembly import Telescope
from titop_plant.telescope.parameters import Parameters, parameter_corners

SCREEN_SAMPLES = 32
SCREEN_BANDS = (50.0, 300.0, 430.0, 520.0, 800.0)
START_POLES = (20.0, 400.0)
START_GAIN = 100.0


def screened(
    telescope: Telescope, parameters: Parameters, observer: SampledSystem | None, seed: int
) -> list[dict[str, float]]:
    """First active parameter points of a robust design: those with the largest relative error in each frequency band.

    The candidates are all corners and :data:`SCREEN_SAMPLES` random points. In each of the bands between the
    frequencies :data:`SCREEN_BANDS` the one is chosen at which the previous stage (the isolator alone, or with an
    observer the mirror loop) has its largest peak.

    Parameters
    ----------
    telescope, parameters
        Assembled telescope and its parameters.
    observer : SampledSystem or None
        K_FSM of the mirror loop; None: the isolator alone.
    seed : int
        Seed of the random points.

    Returns
    -------
    list of dict
        Different points, at most one for each band.
    """
    system, rng = control_loop_plant(telescope, parameters), np.random.default_rng(seed)
    candidates = parameter_corners(parameters) + system.sample_values(rng, SCREEN_SAMPLES)
    k_fsm, k_pma = observer or zero_controller("k-fsm"), zero_controller("k-pma")
    loop, sensitivity = "isolator" if observer is None else "fsm", float(parameters["fsm"]["los_sensitivity"])
    worst: dict[int, tuple[float, dict[str, float]]] = {}
    for values in candidates:
        plant = system.at(values)
        closed = sampled_loop(plant, k_fsm, k_pma, loop=loop, los_sensitivity=sensitivity)
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


def stored_start(kind: str) -> System:
    """The stored continuous controller ("k-fsm", "k-pma") that a design of the implemented loop starts from."""
    path = Path(__file__).with_name(f"start_{kind.replace('-', '_')}.json")
    content = json.loads(path.read_text(encoding="utf-8"))
    A, B, C, D = (np.array(content[key], dtype=float) for key in "ABCD")
    inputs, outputs = design_ports(kind)
    known = [port for port in inputs if port.name in content["inputs"]]
    B, D = (spread_columns(matrix, known, inputs) for matrix in (B, D))
    return System(A, B, C, D, inputs, outputs, f"start of {kind}")


def zero_controller(kind: str) -> SampledSystem:
    """A controller of a kind whose outputs are zero."""
    inputs, outputs = design_ports(kind)
    rows, columns = (sum(p.size for p in ports) for ports in (outputs, inputs))
    none = np.zeros((0, 0))
    return SampledSystem(none, none, none, np.zeros((rows, columns)), inputs, outputs, DT, "zero")


def random_law(seed: int, gain: float = START_GAIN, order: int = ACTUATOR_ORDER) -> System:
    """A stable random K_PMA with small gain: poles spread over the isolator's band; of order 0 a static gain."""
    rng = np.random.default_rng(seed)
    poles = -np.geomspace(*START_POLES, order)
    B = rng.standard_normal((order, 6))
    C = gain * rng.standard_normal((6, order))
    D = np.zeros((6, 6)) if order else gain / np.sqrt(np.prod(START_POLES)) * rng.standard_normal((6, 6))
    return System(np.diag(poles), B, C, D, *design_ports("k-pma"), f"start {seed}")


def random_start(plant: System, seed: int, order: int = ACTUATOR_ORDER) -> System:
    """:func:`random_law` with the ports of a design plant."""
    law = random_law(seed, order=order)
    ports = tuple(plant.output_port(port.name) for port in K_PMA_INPUTS), (plant.input_port("pma_force"),)
    return System(*law.matrices, *ports, law.name)
