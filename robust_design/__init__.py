"""Fixed-structure robust tuning: H-infinity and H2 requirements, soft and hard, on many models at once.

It works on :class:`lti.StateSpace` models with named ports and knows nothing of any spacecraft. Start at :func:`tune`
(given models) or :func:`tune_robust` (a plant with parameters in a box); ``docs/robust_design.md`` compares it with
systune.
"""

from robust_design.certificate import Certificate, certify
from robust_design.decentralised import Decentralised
from robust_design.requirements import ClosedLoopPoles, ControllerPoles, H2Gain, HinfGain, Requirement
from robust_design.robust import RobustResult, tune_robust
from robust_design.stable_state_space import StableStateSpace
from robust_design.status import TuningStatus
from robust_design.structures import AffineStructure, Structure, controller, gain, pid, state_space
from robust_design.tuner import TuningOptions, TuningResult, tune
from robust_design.worst_case import WorstCase, WorstCaseOptions, worst_case

__all__ = [
    "AffineStructure",
    "Certificate",
    "ClosedLoopPoles",
    "ControllerPoles",
    "Decentralised",
    "H2Gain",
    "HinfGain",
    "Requirement",
    "RobustResult",
    "StableStateSpace",
    "Structure",
    "TuningOptions",
    "TuningResult",
    "TuningStatus",
    "WorstCase",
    "WorstCaseOptions",
    "certify",
    "controller",
    "gain",
    "pid",
    "state_space",
    "tune",
    "tune_robust",
    "worst_case",
]
