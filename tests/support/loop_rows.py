"""Rows of the loop of the reference telescope, at the frame rate of its camera or another one."""

from __future__ import annotations

from typing import Any

from fsm_pma_controller.runtime import ForceLaw, FsmPmaController
from lftkit.systems.sampled.sampled_system import SampledSystem
from los_estimator.runtime import LosEstimator
from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.loop_ports import LoopPorts

ROWS = load_telescope().loop_ports
FRAME_TICKS = load_telescope().frame_ticks


def loop_rows(frame_ticks: int = FRAME_TICKS) -> LoopPorts:
    """Rows with a frame of the camera every so many ticks."""
    return ROWS.with_frames(frame_ticks)


MEASUREMENTS, COMMANDS = ROWS.measurements, ROWS.commands
"""Sizes of the vectors of the reference's loop."""


def estimator_of(k_fsm: SampledSystem) -> LosEstimator:
    """The observer at run time, with the sensors of the reference."""
    return LosEstimator(k_fsm, ROWS.of_law("k_fsm"))


def controller_of(k_pma: ForceLaw, loop: str = "fsm+pma", **limits: Any) -> FsmPmaController:
    """Mirror and proof-mass laws at run time, with the sensors and actuators of the reference."""
    return FsmPmaController(k_pma, ROWS.of_law("k_pma"), loop, **limits)
