"""Full-order controllers: H-infinity, H2, mixed sensitivity, loop shaping, robust performance."""

from lftkit.synthesis.full_order import FullOrderDesign, augw, h2syn, hinfsyn, mixsyn
from lftkit.synthesis.loop_shaping import ncfsyn
from lftkit.synthesis.lower_bound import ProvenLowerBound, lower_bound_proof
from lftkit.synthesis.mu_synthesis import MuDesign, musyn

__all__ = [
    "FullOrderDesign",
    "MuDesign",
    "ProvenLowerBound",
    "augw",
    "h2syn",
    "hinfsyn",
    "lower_bound_proof",
    "mixsyn",
    "musyn",
    "ncfsyn",
]
