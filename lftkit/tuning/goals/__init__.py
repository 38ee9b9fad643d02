"""Goals for loops and references, which become gains of a model with further ports."""

from lftkit.tuning.goals.goal import Goal, resolved, resolved_build
from lftkit.tuning.goals.loop_goals import LoopShape, Margins, MaxLoopGain, MinLoopGain, Sensitivity
from lftkit.tuning.goals.reference_goals import Overshoot, StepTracking, Tracking

__all__ = [
    "Goal",
    "LoopShape",
    "Margins",
    "MaxLoopGain",
    "MinLoopGain",
    "Overshoot",
    "Sensitivity",
    "StepTracking",
    "Tracking",
    "resolved",
    "resolved_build",
]
