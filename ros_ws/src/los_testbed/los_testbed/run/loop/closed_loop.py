"""The closed loop in one process, tick by tick, without ROS: the step functions of the nodes.

Tick k: the plant applies the command that was computed from tick k - 1, then measures; estimator and
controller compute the next command from that measurement. :mod:`los_testbed.run.loop.compiled_loop` has the same ticks
as compiled code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lftkit.arrays import FloatArray
from los_testbed.config.plugins import RAISED, in_one_line
from los_testbed.parts.image_camera import image_camera_of, window_of
from los_testbed.parts.run_parts import RunParts
from los_testbed.parts.stepped_plant import SteppedPlant
from los_testbed.parts.user_blocks import BlockFailedError
from los_testbed.run.loop.contract import RunFailedError, first_not_finite
from titop_plant.interface import ESTIMATES, TICK_NS, TRUTH
from titop_plant.telescope.loop_ports import LoopPorts

if TYPE_CHECKING:
    from pointing_analysis.replay.replay import ControllerCore, EstimatorCore

BLOCK = 1000
"""Ticks that are simulated before they are written: one chunk of the bag."""

SIGNALS = ("measurement", "truth", "los_estimate", "command")
"""Vectors of a `SampleBlock`."""

SIMULATED_START_NS = 1_000_000_000
"""Simulated time begins at 1 s: ROS takes a stamp of zero for a clock that is not set."""


class LoopDivergedError(RuntimeError):
    """A signal is not finite: the controllers do not stabilise this plant."""


def aligned_start(not_before_ns: int, period: int) -> int:
    """First tick of a run [ns]: a whole number of periods of the sensors, so that stamps tell the frames.

    Parameters
    ----------
    not_before_ns : int
    period : int
        Ticks from one tick at which every sensor has a sample to the next.

    Examples
    --------
    >>> aligned_start(1_000_000_001, 20)
    1020000000
    """
    period_ns = period * TICK_NS
    return -(-not_before_ns // period_ns) * period_ns


class SampleBlock:
    """Signals of some consecutive ticks; row i belongs to stamp i.

    Parameters
    ----------
    size : int
    ports : LoopPorts
        Sensors and actuators of the loop.
    window : int
        Pixels along each axis of the camera's images; 0 without images.
    """

    def __init__(self, size: int, ports: LoopPorts, window: int = 0) -> None:
        self.size, self.ports, self.window = size, ports, window
        self.stamps = np.zeros(size, np.int64)
        self.measurement = np.zeros((size, ports.measurements))
        self.truth = np.zeros((size, TRUTH))
        self.los_estimate = np.zeros((size, ESTIMATES))
        self.command = np.zeros((size, ports.commands))
        self.image = np.zeros((size, window**2))


@dataclass(frozen=True)
class SimulatedLoop:
    """Plant, observer and controller that step each other in one process.

    Parameters
    ----------
    plant, estimator, controller
        In the state in which the run starts.
    ports : LoopPorts
        Sensors and actuators of the plant.
    used : (LoopPorts, LoopPorts)
        Rows that observer and controller use.
    first_command : ndarray, optional
        Command that the first tick applies [rad, N]; default: zero.
    """

    plant: SteppedPlant
    estimator: EstimatorCore
    controller: ControllerCore
    ports: LoopPorts
    used: tuple[LoopPorts, LoopPorts]
    first_command: FloatArray | None = None

    @classmethod
    def of(cls, parts: RunParts, user_plant: SteppedPlant | None = None, *, recorded: bool = True) -> SimulatedLoop:
        """The loop of a run in the state in which it starts; `user_plant` replaces the plant of `parts`.

        Of a loop that is not `recorded` sensors that no controller uses are left out.
        """
        estimator, controller = parts.estimator(), parts.controller()
        if user_plant is None:
            plant, first = parts.plant(recorded=recorded), parts.start.command
            ports = parts.ports if recorded else parts.loop_ports
        else:
            plant, first, ports = user_plant, None, parts.ports.used_by()
        estimator.reset()
        controller.reset()
        return cls(plant, estimator, controller, ports, (parts.used["k_fsm"], parts.used["k_pma"]), first)

    def run(self, ticks: int, sink: Callable[[SampleBlock, int], None]) -> None:
        """Run the loop and hand each block of ticks, with the number of its valid rows, to `sink`.

        Raises
        ------
        LoopDivergedError
            A signal is no longer finite; the ticks before it are in the sink.
        RunFailedError
            Plant, observer or controller raised an exception; what was computed until then is in the sink.
        """
        from los_testbed.run.loop.compiled_loop import CompiledLoop

        command, plant = np.zeros(self.ports.commands), self.plant
        block = SampleBlock(BLOCK, self.ports, window_of(plant))
        if self.first_command is not None:
            command[: len(self.first_command)] = self.first_command
        start = aligned_start(SIMULATED_START_NS, self.ports.with_frames(plant.frame_ticks).period)
        compiled = CompiledLoop.of(plant, self.estimator, self.controller, self.ports, self.used, ticks)
        for first in range(0, ticks, BLOCK):
            rows = min(BLOCK, ticks - first)
            block.stamps[:] = start + TICK_NS * np.arange(first, first + BLOCK)
            if compiled is None or not compiled.run(command, block, rows):
                error, done = self._step_by_step(command, block, rows, first)
                if error is not None:
                    sink(block, done)
                    raise RunFailedError(str(error)) from error.__cause__
            odd = first_not_finite({name: getattr(block, name) for name in SIGNALS}, rows, self.ports)
            sink(block, rows if odd is None else odd[0])
            if odd is not None:
                raise LoopDivergedError(f"the loop diverged: at tick {first + odd[0]} the {odd[1]}")

    def _step_by_step(
        self, command: FloatArray, block: SampleBlock, rows: int, first: int
    ) -> tuple[RunFailedError | None, int]:
        """Ticks of a block, one call of each part a tick; the failure, and the ticks before it."""
        plant, estimate, control = self.plant, self.estimator.step, self.controller.step
        plant_step, done, who = plant.step, 0, "plant"
        camera = image_camera_of(plant)
        image = None if camera is None else camera.image.ravel()
        seen, felt = (self.ports.measured_columns(used.measured) for used in self.used)
        observed, taken = (np.zeros(used.measurements) for used in self.used)
        try:
            # what overflows is found by the caller, with tick and port
            with np.errstate(over="ignore", invalid="ignore"):
                for y, truth, los, u in zip(
                    block.measurement[:rows], block.truth[:rows], block.los_estimate[:rows], block.command[:rows]
                ):
                    who = "plant"
                    plant_step(command, y, truth)
                    if image is not None and (first + done) % plant.frame_ticks == 0:
                        block.image[done] = image
                    who = "observer"
                    observed[:] = y[seen]
                    estimate(observed, los)
                    who = "controller"
                    taken[:] = y[felt]
                    control(los, taken, u)
                    command[:] = u
                    done += 1
        except RAISED as error:
            # a user's block reports its failure and tick itself
            named = isinstance(error, BlockFailedError)
            text = str(error) if named else f"{who} failed at tick {first + done}: {in_one_line(error)}"
            failed = RunFailedError(text)
            failed.__cause__ = error
            return failed, done
        return None, done
