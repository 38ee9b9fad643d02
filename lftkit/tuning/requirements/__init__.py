"""What a design must do: gains between ports and locations of poles, each soft (minimised) or hard (at most 1).

A requirement says on which models it can be asked (`check`), what it is on the image of a discrete model (`on_image`),
what it is once it is held (`held`), and what an assembled loop reaches (`certified`). The descents evaluate all gains
of a problem together, with gradients: :mod:`lftkit.tuning.problem`.
"""

from lftkit.tuning.requirements.gains import Gain, H2Gain, HinfGain
from lftkit.tuning.requirements.poles import ClosedLoopPoles, ControllerPoles, Poles
from lftkit.tuning.requirements.requirement import TuningRequirement
from lftkit.tuning.requirements.sector import SectorGain

__all__ = [
    "ClosedLoopPoles",
    "ControllerPoles",
    "Gain",
    "H2Gain",
    "HinfGain",
    "Poles",
    "SectorGain",
    "TuningRequirement",
]
