"""Guaranteed bounds of uncertain linear systems, with proofs that separate code checks.

Start at :func:`worst_case_gain` and :func:`robust_stability`; :func:`check_proof` verifies what they prove.
``docs/certificates.md`` has the mathematics, what is guaranteed and what is not.
"""

from robust_design.certified.bounds import Bounds, robust_stability, worst_case_gain
from robust_design.certified.cells import Cell
from robust_design.certified.checker import CheckedProof, ProofError, check_proof
from robust_design.certified.proof import Proof

__all__ = [
    "Bounds",
    "Cell",
    "CheckedProof",
    "Proof",
    "ProofError",
    "check_proof",
    "robust_stability",
    "worst_case_gain",
]
