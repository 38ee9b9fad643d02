"""Starts of a design: stored controllers, zero ones, and random ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from fsm_pma_controller.problem import ORDER as ACTUATOR_ORDER
from lftkit import SampledSystem, System
from lftkit.errors import InputError
from lftkit.systems.ports import spread_columns
from lftkit.tuning.nested_orders import with_decaying_states
from titop_plant.interface import DT, LAW_PORTS

START_POLES = (20.0, 400.0)
START_GAIN = 100.0


def stored_start(kind: str) -> System:
    """The stored continuous controller ("k-fsm", "k-pma") that a design of the implemented loop starts from."""
    path = Path(__file__).with_name(f"start_{kind.replace('-', '_')}.json")
    content = json.loads(path.read_text(encoding="utf-8"))
    A, B, C, D = (np.array(content[key], dtype=float) for key in "ABCD")
    inputs, outputs = LAW_PORTS[kind.replace("-", "_")]
    known = [port for port in inputs if port.name in content["inputs"]]
    B, D = (spread_columns(matrix, known, inputs) for matrix in (B, D))
    return System(A, B, C, D, inputs, outputs, f"start of {kind}")


def zero_controller(kind: str) -> SampledSystem:
    """A controller of a kind whose outputs are zero."""
    inputs, outputs = LAW_PORTS[kind.replace("-", "_")]
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
    return System(np.diag(poles), B, C, D, *LAW_PORTS["k_pma"], f"start {seed}")


def padded(system: System, order: int) -> System:
    """A controller with more states and the same response: they decay, have inputs and act on nothing.

    Raises
    ------
    ValueError
        It has more states than `order`.
    """
    if system.order > order:
        raise InputError(f"start must be of order {order} or lower, got {system.order}")
    speeds = np.geomspace(*START_POLES, order - system.order + 2)[1:-1]
    return with_decaying_states(system, speeds, seed=order)
