"""Guaranteed bounds of uncertain systems, and the check of their proofs.

Start at :func:`worst_case_gain`, :func:`robust_stability` and :func:`robust_performance`; :func:`check_proof` verifies
what they prove, and the proofs of sampled loops. ``docs/certificates.md`` says what is guaranteed and what is not.
"""

from typing import TYPE_CHECKING

from lftkit.support.on_demand import names_on_demand

if TYPE_CHECKING:
    from lftkit.proofs.checking import check_proof
    from lftkit.proofs.robustness import robust_performance, robust_stability, worst_case_gain
    from lftkit.proofs.state_space.bounds import Bounds
    from lftkit.proofs.verdict import CheckedProof, ProofError

__all__ = [
    "Bounds",
    "CheckedProof",
    "ProofError",
    "check_proof",
    "robust_performance",
    "robust_stability",
    "worst_case_gain",
]

__getattr__ = names_on_demand(
    __name__,
    {
        "checking": ("check_proof",),
        "robustness": ("robust_performance", "robust_stability", "worst_case_gain"),
        "state_space.bounds": ("Bounds",),
        "verdict": ("CheckedProof", "ProofError"),
    },
)
