"""What to design: problem, effort, and the constants of the implemented loop."""

from __future__ import annotations

from dataclasses import dataclass

from titop_plant.interface import CAMERA_PERIOD, HOLD_DELAY, LOOP_DELAY


@dataclass(frozen=True)
class DesignOptions:
    """What to design and how long to try.

    Parameters
    ----------
    nominal : bool
        On the nominal model alone instead of the whole box of parameters.
    loop_delay : float
        0: the paper's continuous problem; else as implemented, with sensor noise and a held camera [s].
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
    loop_delay: float = LOOP_DELAY
    starts: int = 0
    seed: int = 0
    wall_limit: float = 1800.0
    workers: int = 1
    progress: bool = False

    @property
    def implemented(self) -> bool:
        """With delay, held camera and noise requirements."""
        return self.loop_delay > 0.0

    @property
    def held(self) -> dict[str, float]:
        """What is held, for the plants: camera frames and commands [s]."""
        if not self.implemented:
            return {}
        return {"camera_period": CAMERA_PERIOD, "command_hold": min(HOLD_DELAY, self.loop_delay)}

    @property
    def delay(self) -> float:
        """The loop delay without the mean delay of held commands, which is in the plant [s]."""
        return max(0.0, self.loop_delay - HOLD_DELAY)

    @property
    def variant(self) -> str:
        """Name of the stored design."""
        return ("implemented" if self.implemented else "paper") + ("_nominal" if self.nominal else "")
