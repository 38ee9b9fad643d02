"""Simulated runs of several members at a time: the bits of each run alone, with the overhead of one of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fsm_pma_controller.runtime import FsmPmaController
from lftkit import SampledSystem
from lftkit.arrays import FloatArray
from los_estimator.runtime import hold_values
from los_testbed.loop.contract import first_not_finite
from los_testbed.loop.simulate import BLOCK, SIGNALS, LoopDivergedError
from titop_plant.interface import (
    COMMANDS,
    ESTIMATES,
    FORCE_STAGES,
    FORCES,
    HELD,
    K_FSM_INPUTS,
    MEASUREMENTS,
    PLATFORM,
    TRUTH,
)
from titop_plant.simulation.plant_batch import PlantBatch
from titop_plant.simulation.sampled_plant import SampledPlant


class Signals(Protocol):
    """Ticks of one loop, as :class:`los_testbed.loop.simulate.SampleBlock` holds them."""

    @property
    def measurement(self) -> FloatArray:
        """Shape (n, 22)."""

    @property
    def truth(self) -> FloatArray:
        """Shape (n, 2)."""

    @property
    def los_estimate(self) -> FloatArray:
        """Shape (n, 2)."""

    @property
    def command(self) -> FloatArray:
        """Shape (n, 8)."""


@dataclass(frozen=True)
class Ticks:
    """A block of ticks of one member."""

    measurement: FloatArray
    truth: FloatArray
    los_estimate: FloatArray
    command: FloatArray


@dataclass(frozen=True)
class MemberLoop:
    """A loop at its start.

    Parameters
    ----------
    plant : SampledPlant
    k_fsm, k_pma : ndarray
        States of the controllers.
    camera : ndarray, shape (h,)
        Values that are held, of a camera [rad].
    command : ndarray, shape (8,)
        Command that the first tick applies [rad, N].
    sink : callable
        Takes each block of ticks, with the number of its valid rows.
    """

    plant: SampledPlant
    k_fsm: FloatArray
    k_pma: FloatArray
    camera: FloatArray
    command: FloatArray
    sink: Callable[[Signals, int], None]


class _Systems:
    """One sampled system with the states of several members, stepped as :meth:`lftkit.SampledSystem.step` does."""

    def __init__(self, system: SampledSystem, states: Sequence[FloatArray]) -> None:
        self._system, self._x = system, np.array(states, dtype=float).reshape(len(states), -1)
        self._next, self._feed = np.empty_like(self._x), np.empty_like(self._x)
        self._through = np.empty((len(states), system.C.shape[0]))

    def step(self, u: FloatArray, out: FloatArray) -> None:
        """Write the outputs (m, p) of this tick for the inputs (m, q), and go on to the next."""
        system, x, u = self._system, self._x[:, :, None], u[:, :, None]
        np.matmul(system.C, x, out=out[:, :, None])
        np.matmul(system.D, u, out=self._through[:, :, None])
        np.add(out, self._through, out=out)
        np.matmul(system.A, x, out=self._next[:, :, None])
        np.matmul(system.B, u, out=self._feed[:, :, None])
        np.add(self._next, self._feed, out=self._x)


def simulate_members(
    loops: Sequence[MemberLoop], systems: Mapping[str, SampledSystem], controller: FsmPmaController, ticks: int
) -> list[LoopDivergedError | None]:
    """Run the loops of several members, as :func:`los_testbed.loop.simulate.simulate` runs each of them.

    Parameters
    ----------
    loops : sequence of MemberLoop
        With plants of one kind, see :class:`titop_plant.simulation.plant_batch.PlantBatch`.
    systems : mapping
        ``k_fsm`` and ``k_pma`` of all members; their own states are left alone.
    controller : FsmPmaController
        With stage, limits and mirror sensitivity of all members.
    ticks : int

    Returns
    -------
    list
        For each loop what it ended with: None, or that a signal is no longer finite.

    Raises
    ------
    ValueError
        Plants of several kinds.
    """
    count = len(loops)
    plant = PlantBatch([loop.plant for loop in loops])
    observer = _Systems(systems["k_fsm"].with_inputs(K_FSM_INPUTS), [loop.k_fsm for loop in loops])
    law = _Systems(systems["k_pma"], [loop.k_pma for loop in loops])
    held, command = np.array([loop.camera for loop in loops]), np.array([loop.command for loop in loops])
    seen, force = np.empty((count, MEASUREMENTS)), np.empty((count, FORCES.stop - FORCES.start))
    accelerations, los = np.empty((count, PLATFORM.stop - PLATFORM.start)), np.empty((count, ESTIMATES))
    forces_closed = controller.loop in FORCE_STAGES
    sizes = MEASUREMENTS, TRUTH, ESTIMATES, COMMANDS
    blocks = [np.zeros((count, min(ticks, BLOCK), width)) for width in sizes]
    ends: list[LoopDivergedError | None] = [None] * count
    measurement, truth = np.empty((count, MEASUREMENTS)), np.empty((count, TRUTH))
    for first in range(0, ticks, BLOCK):
        rows = min(BLOCK, ticks - first)
        for row in range(rows):
            plant.step(command, measurement, truth)
            if np.isfinite(measurement[:, HELD]).any():
                for values, kept in zip(measurement, held):
                    hold_values(values, kept)
            seen[:] = measurement
            seen[:, HELD] = held
            observer.step(seen, los)
            if forces_closed:
                accelerations[:] = measurement[:, PLATFORM]
                law.step(accelerations, force)
            controller.command(los, force, command)
            for block, values in zip(blocks, (measurement, truth, los, command)):
                block[:, row] = values
        for k, loop in enumerate(loops):
            if ends[k] is None:
                ends[k] = _ended(Ticks(*(block[k] for block in blocks)), first, rows, loop.sink)
    return ends


def _ended(block: Ticks, first: int, rows: int, sink: Callable[[Signals, int], None]) -> LoopDivergedError | None:
    """Hand a block to its sink; what is wrong with it."""
    odd = first_not_finite({name: getattr(block, name) for name in SIGNALS}, rows)
    sink(block, rows if odd is None else odd[0])
    return None if odd is None else LoopDivergedError(f"the loop diverged: at tick {first + odd[0]} the {odd[1]}")
