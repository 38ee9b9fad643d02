"""Guaranteed bounds of uncertain linear systems, with proofs that separate code checks.

Start at :func:`worst_case_gain` and :func:`robust_stability`; :func:`check_proof` verifies what they prove.
``docs/certificates.md`` has the mathematics, what is guaranteed and what is not. Names are loaded when they are first
asked for, so that a check loads nothing of what finds proofs.
"""

from typing import TYPE_CHECKING

from lftkit.support.on_demand import names_on_demand

if TYPE_CHECKING:
    from lftkit.proofs.state_space.bounds import Bounds, robust_stability, worst_case_gain
    from lftkit.proofs.state_space.cells import Cell
    from lftkit.proofs.state_space.checker import check_proof
    from lftkit.proofs.state_space.proof import Proof
    from lftkit.proofs.verdict import CheckedProof, ProofError

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

__getattr__ = names_on_demand(
    __name__,
    {
        "bounds": ("Bounds", "robust_stability", "worst_case_gain"),
        "cells": ("Cell",),
        "checker": ("check_proof",),
        "proof": ("Proof",),
        "lftkit.proofs.verdict": ("CheckedProof", "ProofError"),
    },
)
