"""Fixed-structure robust tuning: H-infinity and H2 requirements, soft and hard, on many models at once.

It works on :class:`lftkit.System` models with named ports. Start at :func:`tune` (given models) or
:func:`tune_robust` (a plant with parameters in a box); ``docs/lftkit/from_matlab.md`` compares it with systune.
"""

from typing import TYPE_CHECKING

from lftkit.support.on_demand import names_on_demand
from lftkit.tuning.certificate import Certificate, certify
from lftkit.tuning.descent.minimax.minimax import Descent, DescentOptions, DescentState, descend
from lftkit.tuning.discrete import tune_discrete
from lftkit.tuning.goals import (
    ConicSector,
    Goal,
    LoopShape,
    Margins,
    MaxLoopGain,
    MinLoopGain,
    Overshoot,
    Passivity,
    Sensitivity,
    StepTracking,
    Tracking,
)
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.requirements import ClosedLoopPoles, ControllerPoles, H2Gain, HinfGain, TuningRequirement
from lftkit.tuning.result import Level, Round, TuningResult, WorstCase
from lftkit.tuning.robust.robust import RobustOptions, tune_robust
from lftkit.tuning.robust.worst_case import WorstCaseOptions, worst_case
from lftkit.tuning.status import TuningStatus
from lftkit.tuning.structures.bounds import Bounds
from lftkit.tuning.structures.decentralised import Decentralised
from lftkit.tuning.structures.stable_state_space import StableStateSpace
from lftkit.tuning.structures.structures import AffineStructure, Structure, controller, gain, pid, state_space
from lftkit.tuning.tuner import tune

if TYPE_CHECKING:
    from lftkit.tuning.pictures.plots import plot_goals

__all__ = [
    "AffineStructure",
    "Bounds",
    "Certificate",
    "ClosedLoopPoles",
    "ConicSector",
    "ControllerPoles",
    "Decentralised",
    "Descent",
    "DescentOptions",
    "DescentState",
    "Goal",
    "H2Gain",
    "HinfGain",
    "Level",
    "LoopShape",
    "Margins",
    "MaxLoopGain",
    "MinLoopGain",
    "Overshoot",
    "Passivity",
    "RobustOptions",
    "Round",
    "Sensitivity",
    "StableStateSpace",
    "StepTracking",
    "Structure",
    "Tracking",
    "TuningOptions",
    "TuningRequirement",
    "TuningResult",
    "TuningStatus",
    "WorstCase",
    "WorstCaseOptions",
    "certify",
    "controller",
    "descend",
    "gain",
    "pid",
    "plot_goals",
    "state_space",
    "tune",
    "tune_discrete",
    "tune_robust",
    "worst_case",
]

__getattr__ = names_on_demand(__name__, {"pictures.plots": ("plot_goals",)})
