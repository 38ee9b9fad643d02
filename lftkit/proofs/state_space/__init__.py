"""Bounds of uncertain systems by cells of parameters and frequency, with a proof.

Start at :func:`lftkit.proofs.worst_case_gain`. Names are loaded when they are first asked for, so that a check loads
nothing of what finds proofs.
"""

from typing import TYPE_CHECKING

from lftkit.support.on_demand import names_on_demand

if TYPE_CHECKING:
    from lftkit.proofs.state_space.bounds import ProvenBounds
    from lftkit.proofs.state_space.cells import Cell
    from lftkit.proofs.state_space.proof import Proof

__all__ = ["Cell", "Proof", "ProvenBounds"]

__getattr__ = names_on_demand(
    __name__,
    {"bounds": ("ProvenBounds",), "cells": ("Cell",), "proof": ("Proof",)},
)
