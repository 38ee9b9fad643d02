"""Full-order controllers: H-infinity, H2, mixed sensitivity, loop shaping."""

from lftkit.synthesis.full_order import FullOrderDesign, augw, h2syn, hinfsyn, mixsyn
from lftkit.synthesis.loop_shaping import ncfsyn

__all__ = ["FullOrderDesign", "augw", "h2syn", "hinfsyn", "mixsyn", "ncfsyn"]
