"""Bounds of uncertain systems by cells of parameters and frequency, the proofs and their check.

Start at :func:`lftkit.proofs.worst_case_gain`. Names are loaded when they are first asked for, so that a check loads
nothing of what finds proofs.
"""

from typing import TYPE_CHECKING

from lftkit.support.on_demand import names_on_demand

if TYPE_CHECKING:
    from lftkit.proofs.checked_proof import CheckedProof
    from lftkit.proofs.state_space.bounds import ProvenBounds
    from lftkit.proofs.state_space.cells import Cell
    from lftkit.proofs.state_space.checker import check_proof
    from lftkit.proofs.state_space.proof import Proof
    from lftkit.proofs.trusted.proof import ProofError

__all__ = [
    "Cell",
    "CheckedProof",
    "Proof",
    "ProofError",
    "ProvenBounds",
    "check_proof",
]

__getattr__ = names_on_demand(
    __name__,
    {
        "bounds": ("ProvenBounds",),
        "cells": ("Cell",),
        "checker": ("check_proof",),
        "proof": ("Proof",),
        "lftkit.proofs.checked_proof": ("CheckedProof",),
        "lftkit.proofs.trusted.proof": ("ProofError",),
    },
)
