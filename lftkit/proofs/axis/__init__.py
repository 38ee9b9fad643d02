"""Bounds of uncertain systems over the frequency axis by scalings that depend on frequency, with a proof.

For systems of more states and parameters than :mod:`lftkit.proofs.state_space` can take.
"""

from typing import TYPE_CHECKING

from lftkit.support.on_demand import names_on_demand

if TYPE_CHECKING:
    from lftkit.proofs.axis.proof import AxisProof

__all__ = ["AxisProof"]

__getattr__ = names_on_demand(__name__, {"proof": ("AxisProof",)})
