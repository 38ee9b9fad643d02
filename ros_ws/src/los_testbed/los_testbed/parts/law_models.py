"""Model of a controller in user code: the result of its method ``system()``, and its check."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lftkit.arrays import BoolArray, FloatArray
from lftkit.systems.ports import Port, port_slices, total_size
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from titop_plant.interface import DT, K_FSM_OUTPUTS
from titop_plant.sensors import CAMERA_PORT
from titop_plant.telescope.loop_ports import LoopPorts

TICKS, FRAME = 45, 20
"""Ticks for which a class is compared with its model, and those of a frame of the camera within them."""
SIZE, TOLERANCE = 1e-6, 1e-6
"""Size of the states and inputs, and relative tolerance."""


def element(ports: Iterable[Port], where: BoolArray) -> str:
    """Name of the first marked element of a vector.

    Examples
    --------
    >>> from titop_plant.interface import K_FSM_INPUTS
    >>> element(K_FSM_INPUTS, np.arange(22) == 8)
    'accel_M1[2]'
    """
    index = int(np.flatnonzero(where)[0])
    columns = port_slices(ports)
    name = next(name for name, part in columns.items() if part.start <= index < part.stop)
    return f"{name}[{index - columns[name].start}]"


def told_model(block: Any, inputs: Sequence[Port], outputs: Sequence[Port]) -> SampledSystem | None:
    """Result of the method ``system`` of a block, with these ports; None for a block without one.

    Raises
    ------
    ValueError
        Not a sampled system, or one with other ports or another period.
    """
    if not inputs or not callable(getattr(type(block), "system", None)):
        return None
    from lftkit.systems.exchange import as_sampled, as_system

    system = block.system()
    model = system if isinstance(system, SampledSystem) else as_sampled(as_system(system))
    model = model.with_inputs(inputs)
    model.require(inputs, outputs, DT)
    return model


def difference(
    reset: Callable[..., None], step: Callable[..., None], model: SampledSystem, ports: LoopPorts | None
) -> str:
    """First difference of a block and its model from a random state under small random inputs; empty without one.

    Parameters
    ----------
    reset : callable
        Takes the state, of an observer the values that are held as well.
    step : callable
        Of the block: input and output.
    model : SampledSystem
        With the ports of the block.
    ports : LoopPorts, optional
        Rows of an observer.
    """
    rng = np.random.default_rng(1)
    camera = [port.size for port in model.inputs if port.name == CAMERA_PORT]
    state, held = (SIZE * rng.standard_normal(n) for n in (model.order, sum(camera)))
    values = SIZE * rng.standard_normal((TICKS, total_size(model.inputs)))
    if ports is not None and model.outputs == K_FSM_OUTPUTS:
        observer = LosEstimator(model, ports)
        observer.start_at(state, held)
        observer.reset()
        reset(state, held)
        model_step: Callable[[FloatArray, FloatArray], None] = observer.step
        values[np.ix_(np.arange(TICKS) % FRAME != FRAME // 2, np.r_[port_slices(model.inputs)[CAMERA_PORT]])] = np.nan
    else:
        law = replace(model)
        law.reset(state)
        reset(state)
        model_step = law.step
    outputs: FloatArray = np.zeros((TICKS, total_size(model.outputs)))
    expected = np.zeros_like(outputs)
    for tick in range(TICKS):
        step(values[tick].copy(), outputs[tick])
        model_step(values[tick], expected[tick])
    odd = ~(np.abs(outputs - expected) <= TOLERANCE * np.abs(expected).max())
    if not odd.any():
        return ""
    tick = int(np.argwhere(odd)[0][0])
    pair = f"{outputs[tick][odd[tick]][0]:.6g} for {expected[tick][odd[tick]][0]:.6g}"
    return f"{pair} in {element(model.outputs, odd[tick])} at tick {tick}"
