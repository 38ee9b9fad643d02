"""Options of a control design: problem, effort, and the constants of the implemented loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lftkit.errors import InputError
from los_estimator.problem import ORDER
from titop_plant.interface import HOLD_DELAY, LOOP_DELAY


@dataclass(frozen=True)
class DesignOptions:
    """Problem and effort of a control design.

    Parameters
    ----------
    nominal : bool
        Design on the nominal model alone instead of the whole box of parameters.
    loop_delay : float
        0: the paper's continuous problem; otherwise the implemented one, with sensor noise and a zero-order-hold
        camera [s].
    starts : int
        Random starts of K_PMA in the paper's problem.
    seed : int
        Seed of the starts and of the worst-case search.
    wall_limit : float
        Limit of the computing time [s].
    workers : int
        Processes for random starts and for searches; the result does not depend on them.
    progress : bool
        Show a progress bar.
    short : bool
        Less effort for the robust design of the implemented loop.
    order : int
        Order of the controller; other than 4 in the paper's problem only.
    """

    nominal: bool = False
    loop_delay: float = LOOP_DELAY
    starts: int = 8
    seed: int = 0
    wall_limit: float = 1800.0
    workers: int = 1
    progress: bool = False
    short: bool = False
    order: int = ORDER

    def __post_init__(self) -> None:
        if self.order < 0 or (self.implemented and self.order != ORDER):
            raise InputError(f"order must be {ORDER} with a loop delay, at least 0 without, got {self.order}")

    @property
    def implemented(self) -> bool:
        """Whether the problem has the loop delay, the zero-order-hold camera and the noise requirements."""
        return self.loop_delay > 0.0

    @property
    def hold_delays(self) -> dict[str, Any]:
        """Keyword arguments of the design plants: sampled sensors, and mean delay of the held commands [s]."""
        if not self.implemented:
            return {}
        return {"sampled": True, "command_hold": min(HOLD_DELAY, self.loop_delay)}

    @property
    def delay(self) -> float:
        """The loop delay without the mean delay of the zero-order-hold commands, which is in the plant [s]."""
        return max(0.0, self.loop_delay - HOLD_DELAY)

    @property
    def variant(self) -> str:
        """Name of the stored design."""
        return ("implemented" if self.implemented else "paper") + ("_nominal" if self.nominal else "")
