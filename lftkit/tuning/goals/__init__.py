"""Goals for loops, references and energy, which become gains of a model with further ports."""

from lftkit.tuning.goals.goal import Goal, resolved, resolved_build
from lftkit.tuning.goals.loop_goals import LoopShape, Margins, MaxLoopGain, MinLoopGain, Sensitivity
from lftkit.tuning.goals.reference_goals import Overshoot, StepTracking, Tracking
from lftkit.tuning.goals.sector_goals import ConicSector, Passivity

__all__ = [
    "ConicSector",
    "Goal",
    "LoopShape",
    "Margins",
    "MaxLoopGain",
    "MinLoopGain",
    "Overshoot",
    "Passivity",
    "Sensitivity",
    "StepTracking",
    "Tracking",
    "resolved",
    "resolved_build",
]
