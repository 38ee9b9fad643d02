"""Tuning on frequency responses: a loop that is known at pairs of a frequency and a parameter point.

Where :func:`lftkit.tuning.tune` closes state-space models, this subpackage needs responses only: of a sampled loop with
its delays and holds, or measured ones. A pair costs a solution of the order of the commands, so that hundreds of
parameter points are tuned at once. What a sample does not show is not seen: stability is checked by the caller's
function at every step, and the result belongs to a search for worse parameters.
"""

from lftkit.tuning.frequency_domain.blocks import ControllerBlock, ControllerResponse, gain_matrices, parameters_of
from lftkit.tuning.frequency_domain.descent import DescentState, ResponseDescent, ResponseDescentOptions, descend
from lftkit.tuning.frequency_domain.gains import ResponseGain, ResponseNoise
from lftkit.tuning.frequency_domain.problem import ResponseProblem
from lftkit.tuning.frequency_domain.samples import GrowingSamples, PlantSamples

__all__ = [
    "ControllerBlock",
    "ControllerResponse",
    "DescentState",
    "GrowingSamples",
    "PlantSamples",
    "ResponseDescent",
    "ResponseDescentOptions",
    "ResponseGain",
    "ResponseNoise",
    "ResponseProblem",
    "descend",
    "gain_matrices",
    "parameters_of",
]
