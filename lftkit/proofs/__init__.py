"""Guaranteed bounds of uncertain systems, and the check of their proofs.

Start at :func:`worst_case_gain`, :func:`robust_stability` and :func:`robust_performance`, for the norms that
controllers can reach at :func:`lftkit.synthesis.lower_bound_proof`; :func:`check_proof` verifies what they prove, and
the proofs of sampled loops. ``docs/certificates.md`` says what is guaranteed and what is not.
"""

from typing import TYPE_CHECKING

from lftkit.support.on_demand import names_on_demand

if TYPE_CHECKING:
    from lftkit.proofs.blocks.structure import complex_block, full_block, real_block
    from lftkit.proofs.checking import check_mu, check_proof
    from lftkit.proofs.disk_margin import DiskMarginBounds, DiskMargins, disk_margins, worst_case_disk_margin
    from lftkit.proofs.options import BoundOptions
    from lftkit.proofs.profiles import Profile, gain_profile, stability_profile
    from lftkit.proofs.robustness import robust_performance, robust_stability, worst_case_gain
    from lftkit.proofs.state_space.bounds import ProvenBounds
    from lftkit.proofs.structured.bounds import MuBounds, mu
    from lftkit.proofs.trusted.lower_bound import CheckedLowerBound
    from lftkit.proofs.trusted.proof import CheckedProof, ProofError
    from lftkit.proofs.trusted.structured import MuCertificate, UncertaintyBlock

__all__ = [
    "BoundOptions",
    "CheckedLowerBound",
    "CheckedProof",
    "DiskMarginBounds",
    "DiskMargins",
    "MuBounds",
    "MuCertificate",
    "Profile",
    "ProofError",
    "ProvenBounds",
    "UncertaintyBlock",
    "check_mu",
    "check_proof",
    "complex_block",
    "disk_margins",
    "full_block",
    "gain_profile",
    "mu",
    "real_block",
    "robust_performance",
    "robust_stability",
    "stability_profile",
    "worst_case_disk_margin",
    "worst_case_gain",
]

__getattr__ = names_on_demand(
    __name__,
    {
        "checking": ("check_mu", "check_proof"),
        "disk_margin": ("DiskMarginBounds", "DiskMargins", "disk_margins", "worst_case_disk_margin"),
        "structured.bounds": ("MuBounds", "mu"),
        "blocks.structure": ("complex_block", "full_block", "real_block"),
        "options": ("BoundOptions",),
        "profiles": ("Profile", "gain_profile", "stability_profile"),
        "robustness": ("robust_performance", "robust_stability", "worst_case_gain"),
        "state_space.bounds": ("ProvenBounds",),
        "trusted.lower_bound": ("CheckedLowerBound",),
        "trusted.proof": ("CheckedProof", "ProofError"),
        "trusted.structured": ("MuCertificate", "UncertaintyBlock"),
    },
)
