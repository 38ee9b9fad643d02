"""Rows of the loop of the reference telescope, at the frame rate of its camera or another one."""

from __future__ import annotations

from titop_plant.telescope.load import load_telescope
from titop_plant.telescope.loop_ports import LoopPorts

ROWS = load_telescope().loop_ports
FRAME_TICKS = load_telescope().frame_ticks


def loop_rows(frame_ticks: int = FRAME_TICKS) -> LoopPorts:
    """Rows with a frame of the camera every so many ticks."""
    return ROWS.with_frames(frame_ticks)
