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
from titop_plant.interface import DT, ESTIMATES, K_FSM_OUTPUTS, TRUTH
from titop_plant.simulation.compilation import kernel, kernel_for
from titop_plant.simulation.constant_step import ConstantStep
from titop_plant.simulation.kernel_arrays import ControllerArrays, ObserverArrays, TickRecord
from titop_plant.simulation.plant import Plant
from titop_plant.simulation.plant_step import whole_step
from titop_plant.simulation.ramped_step import MovingTones, RampedStep
from titop_plant.simulation.sensor_samples import SensorModel
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.motion_profiles import linear_profile


class Signals(Protocol):
    """Ticks of one loop, as :class:`los_testbed.run.loop.closed_loop.SampleBlock` holds them: a row for each."""

    @property
    def measurement(self) -> FloatArray:
        """Shape (n, m)."""

    @property
    def truth(self) -> FloatArray:
        """Shape (n, 2)."""

    @property
    def los_estimate(self) -> FloatArray:
        """Shape (n, 2)."""

    @property
    def command(self) -> FloatArray:
        """Shape (n, c)."""


class CompiledLoop:
    """A loop of the testbed's own parts, whose states it advances.

    Parameters
    ----------
    plant : Plant
        Without further parts (`Plant.is_plain`).
    estimator : LosEstimator
    controller : FsmPmaController
        With a `SampledSystem` as K_PMA.
    measured : int
        First column of the inputs of K_PMA in the measurement.
    """

    def __init__(self, plant: Plant, estimator: LosEstimator, controller: FsmPmaController, measured: int) -> None:
        self._plant, self._estimator, self._controller, self._measured = plant, estimator, controller, measured

    @classmethod
    def of(
        cls,
        plant: object,
        estimator: object,
        controller: object,
        ports: LoopPorts,
        used: tuple[LoopPorts, LoopPorts],
        ticks: int,
    ) -> CompiledLoop | None:
        """The loop of these parts; None where one of them is of another kind, or compiled code does not pay.

        K_FSM must read the whole measurement, K_PMA neighbouring columns of it without held values. A plant that is
        stepped separately is switched to compiled code, too.
        """
        if kernel_for(ticks) is None:
            return None
        plain = type(plant) is Plant and plant.is_plain and type(estimator) is LosEstimator
        seen, felt = (ports.measured_columns(law.measured) for law in used)
        whole = isinstance(seen, slice) and seen == slice(0, ports.measurements) and not used[1].held.size
        if not (plain and whole and isinstance(felt, slice)) or type(controller) is not FsmPmaController:
            compile_telescope(plant, ticks)
            return None
        if type(estimator.k_fsm) is not SampledSystem or type(controller.k_pma) is not SampledSystem:  # type: ignore[attr-defined]
            return None
        return cls(plant, estimator, controller, felt.start)  # type: ignore[arg-type]

    def run(self, command: FloatArray, block: Signals, rows: int) -> bool:
        """Write the next `rows` ticks into `block`; `command` (c,) is that of the tick before, and then of the last.

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
        product, held = self._estimator.k_fsm.product, self._estimator.held
        return ObserverArrays(product.columns, product.values, held.parts, held.columns, held.values)

    def _control(self, command: FloatArray) -> ControllerArrays:
        controller, law = self._controller, self._controller.k_pma
        assert isinstance(law, SampledSystem)
        return ControllerArrays(
            law.product.columns,
            law.product.values,
            self._measured,
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
    reference, one = load_telescope(), 1.0
    ports, still = reference.loop_ports.used_by(), np.zeros(len(reference.wheels))
    k_fsm, k_pma = ports.of_law("k_fsm"), ports.of_law("k_pma")
    matrix, start = np.zeros((ports.measurements + TRUTH, ports.commands)), np.zeros(0)
    moving = MovingTones(linear_profile(0.0, 0.0, still, still, 1.0), no_tones(reference.channels))
    constant = ConstantStep(whole_step(matrix, np.zeros(0, complex), 0), start, np.zeros(0))
    sensors = SensorModel(np.zeros(ports.measurements), np.zeros(ports.measurements), 1, 0.0, 0)
    none = np.zeros((0, 0))
    gain = np.zeros((k_pma.commands, k_pma.measurements))
    law = SampledSystem(none, none, none, gain, k_pma.measured, k_pma.commanded, DT)
    gain = np.zeros((ESTIMATES, k_fsm.measurements))
    observer = SampledSystem(none, none, none, gain, k_fsm.measured, K_FSM_OUTPUTS, DT)
    controller = FsmPmaController(law, k_pma, los_sensitivity=one, fsm_authority=one, pma_authority=one)
    block = _Ticks(*(np.zeros((1, width)) for width in (ports.measurements, TRUTH, ESTIMATES, ports.commands)))
    for dynamics in (constant, RampedStep([matrix], 1, moving, start)):
        telescope = Plant(dynamics, sensors, np.ones(ports.commands))
        telescope.compile()
        loop = CompiledLoop(telescope, LosEstimator(observer, k_fsm), controller, 0)
        loop.run(np.zeros(ports.commands), block, 1)
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
