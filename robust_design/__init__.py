"""Fixed-structure robust tuning: H-infinity and H2 requirements, soft and hard, on many models at once.

A library of its own: it knows state-space models with named ports and nothing of any spacecraft. Start at
:func:`tune` (given
models) or :func:`tune_robust` (a plant with parameters in a box); ``docs/robust_design.md`` compares it with systune.
"""

from robust_design.certificate import Certificate, certify
from robust_design.model import Model, close_loop, pade_delay, series, static_gain, transfer
from robust_design.norms import HInfNorm, h2_norm, hinf_norm, hinf_norms, spectral_abscissa
from robust_design.requirements import ClosedLoopPoles, ControllerPoles, H2Gain, HinfGain, Requirement
from robust_design.robust import RobustResult, tune_robust
from robust_design.special_structures import Decentralised, StableStateSpace
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
    "HInfNorm",
    "HinfGain",
    "Model",
    "Requirement",
    "RobustResult",
    "StableStateSpace",
    "Structure",
    "TuningOptions",
    "TuningResult",
    "WorstCase",
    "WorstCaseOptions",
    "certify",
    "close_loop",
    "controller",
    "gain",
    "h2_norm",
    "hinf_norm",
    "hinf_norms",
    "pade_delay",
    "pid",
    "series",
    "spectral_abscissa",
    "state_space",
    "static_gain",
    "transfer",
    "tune",
    "tune_robust",
    "worst_case",
]
