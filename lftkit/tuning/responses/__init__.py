"""Responses as the source of values: a loop that is known at pairs of a frequency and a parameter point.

Where :func:`lftkit.tuning.tune` closes state-space models, this source needs responses only: of a sampled loop with
its delays and holds, or measured ones. A pair costs a solution of the order of the commands, so that hundreds of
parameter points are tuned at once. What a sample does not show is not seen: stability is checked by the caller's
function at every step, and the result belongs to a search for worse parameters. The descent is that of every source,
:func:`lftkit.tuning.descent.minimax.minimax.descend`.
"""

from lftkit.tuning.responses.blocks import ControllerBlock, ControllerResponse, gain_matrices, parameters_of
from lftkit.tuning.responses.gains import ResponseGain, ResponseNoise
from lftkit.tuning.responses.problem import ResponseProblem
from lftkit.tuning.responses.samples import GrowingSamples, PlantSamples
from lftkit.tuning.responses.source import ResponseLook, ResponseSource

__all__ = [
    "ControllerBlock",
    "ControllerResponse",
    "GrowingSamples",
    "PlantSamples",
    "ResponseGain",
    "ResponseLook",
    "ResponseNoise",
    "ResponseProblem",
    "ResponseSource",
    "gain_matrices",
    "parameters_of",
]
