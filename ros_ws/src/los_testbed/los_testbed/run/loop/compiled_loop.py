"""Plant, observer and controller as one piece of compiled code, where all three are the testbed's own.

It is bit-identical to their `step` functions, one after the other (:mod:`titop_plant.simulation.plant_step` has the
order of operations). Code of the user is called tick by tick, as in
:class:`los_testbed.run.loop.closed_loop.SimulatedLoop`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fsm_pma_controller.runtime import FsmPmaController
from lftkit.arrays import FloatArray
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from titop_plant.disturbances.wheel_and_drive_tones import no_tones
from titop_plant.interface import (
    COMMANDS,
    DT,
    ESTIMATES,
    FORCES,
    HELD,
    HELD_PARTS,
    K_FSM_INPUTS,
    K_FSM_OUTPUTS,
    K_PMA_INPUTS,
    K_PMA_OUTPUTS,
    MEASUREMENTS,
    PLATFORM,
    TRUTH,
)
from titop_plant.simulation.compilation import kernel, kernel_for
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.kernel_arrays import ControllerArrays, ObserverArrays, TickRecord
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_step import whole_step
from titop_plant.simulation.ramped_step import MovingTones, RampedStep
from titop_plant.simulation.sensor_samples import SensorModel
from titop_plant.telescope.motion_profiles import linear_profile

_PARTS = np.array([0, *(part.stop for part in HELD_PARTS.values())])


class Signals(Protocol):
    """Ticks of one loop, as :class:`los_testbed.run.loop.closed_loop.SampleBlock` holds them: a row for each."""

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


class CompiledLoop:
    """A loop of the testbed's own parts, whose states it advances.

    Parameters
    ----------
    plant : Plant
        Without further parts (`Plant.is_plain`).
    estimator : LosEstimator
    controller : FsmPmaController
        With a `SampledSystem` as K_PMA.
    """

    def __init__(self, plant: Plant, estimator: LosEstimator, controller: FsmPmaController) -> None:
        self._plant, self._estimator, self._controller = plant, estimator, controller

    @classmethod
    def of(cls, plant: object, estimator: object, controller: object, ticks: int) -> CompiledLoop | None:
        """The loop of these parts; None where one of them is of another kind, or compiled code does not pay.

        A plant that is stepped separately is switched to compiled code, too.
        """
        if kernel_for(ticks) is None:
            return None
        plain = type(plant) is Plant and plant.is_plain and type(estimator) is LosEstimator
        if not plain or type(controller) is not FsmPmaController:
            compile_telescope(plant, ticks)
            return None
        if type(estimator.k_fsm) is not SampledSystem or type(controller.k_pma) is not SampledSystem:  # type: ignore[attr-defined]
            return None
        return cls(plant, estimator, controller)  # type: ignore[arg-type]

    def run(self, command: FloatArray, block: Signals, rows: int) -> bool:
        """Write the next `rows` ticks into `block`; `command` (8,) is that of the tick before, and then of the last.

        Returns
        -------
        bool
            False: settings of the plant were changed, nothing was done.
        """
        plant, compiled = self._plant, kernel_for(rows)
        ahead = None if compiled is None else plant.ahead(rows)
        if compiled is None or ahead is None:
            return False
        course, sensors = ahead
        record = TickRecord(
            block.measurement[:rows], block.truth[:rows], block.los_estimate[:rows], block.command[:rows]
        )
        observer, controller = self._observer(), self._control(command)
        compiled.loop(
            plant.dynamics.arrays, plant.values, plant.authority, course, sensors, observer, controller, record
        )
        return True

    def _observer(self) -> ObserverArrays:
        product = self._estimator.k_fsm.product
        return ObserverArrays(product.columns, product.values, _PARTS, HELD, self._estimator.held)

    def _control(self, command: FloatArray) -> ControllerArrays:
        controller, law = self._controller, self._controller.k_pma
        assert isinstance(law, SampledSystem)
        return ControllerArrays(
            law.product.columns,
            law.product.values,
            PLATFORM.start,
            np.array(controller.closed, dtype=np.int64),
            controller.mirror_gain,
            controller.limits,
            command,
        )


def compile_telescope(plant: object, ticks: int) -> None:
    """Have the simulated telescope, with all its parts, use compiled code if it pays; another plant stays as it is."""
    if isinstance(plant, Plant) and kernel_for(ticks) is not None:
        plant.compile()


def prepare() -> bool:
    """Compile everything, or read it from the cache: what `make` does once, so that no run has to.

    Returns
    -------
    bool
        Whether there is compiled code.
    """
    if kernel() is None:
        return False
    matrix, start = np.zeros((MEASUREMENTS + TRUTH, COMMANDS)), np.zeros(0)
    moving = MovingTones(linear_profile(0.0, 0.0, np.zeros(4), np.zeros(4), 1.0), no_tones())
    constant = ConstantStep(whole_step(matrix, np.zeros(0, complex)), start, np.zeros(0))
    sensors = SensorModel(np.zeros(MEASUREMENTS), np.zeros(MEASUREMENTS), 1, 0.0, 0)
    gain = np.zeros((FORCES.stop - FORCES.start, PLATFORM.stop - PLATFORM.start))
    none = np.zeros((0, 0))
    law = SampledSystem(none, none, none, gain, K_PMA_INPUTS, K_PMA_OUTPUTS, DT)
    observer = SampledSystem(none, none, none, np.zeros((ESTIMATES, MEASUREMENTS)), K_FSM_INPUTS, K_FSM_OUTPUTS, DT)
    one = 1.0
    controller = FsmPmaController(law, los_sensitivity=one, fsm_authority=one, pma_authority=one)
    block = _Ticks(*(np.zeros((1, width)) for width in (MEASUREMENTS, TRUTH, ESTIMATES, COMMANDS)))
    for dynamics in (constant, RampedStep([matrix], 1, moving, start)):
        telescope = Plant(dynamics, sensors, np.ones(COMMANDS))
        telescope.compile()
        CompiledLoop(telescope, LosEstimator(observer), controller).run(np.zeros(COMMANDS), block, 1)
    return True


@dataclass(frozen=True)
class _Ticks:
    """Signals of some ticks."""

    measurement: FloatArray
    truth: FloatArray
    los_estimate: FloatArray
    command: FloatArray


if __name__ == "__main__":
    prepare()

__all__ = ["CompiledLoop", "Signals", "compile_telescope", "prepare"]
