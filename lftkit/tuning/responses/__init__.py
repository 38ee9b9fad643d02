"""Responses as the source of values: a loop that is known at pairs of a frequency and a parameter point.

Where :func:`lftkit.tuning.tune` closes state-space models, this source needs responses only: of a sampled loop with
its delays and holds, or measured ones. A pair costs a solution of the order of the commands, so that hundreds of
parameter points are tuned at once. What a sample does not show is not seen: stability is checked by the caller's
function at every step, and the result belongs to a search for worse parameters. The descent is that of every source,
:func:`lftkit.tuning.descent.minimax.minimax.descend`.

Examples
--------
A law of one state for a resonance, with 0.02 s of delay; hard is a sensitivity of at most 1.8. Rows of the response
are measurement and error, columns disturbance and command:

>>> import numpy as np
>>> from lftkit.tuning import DescentOptions, descend
>>> omega = np.geomspace(0.01, 100.0, 60)
>>> plant = 1.0 / ((1j * omega) ** 2 + 0.1j * omega + 1.0)
>>> samples = PlantSamples(omega, np.tile(plant[:, None, None], (1, 2, 2)), measurements=1, commands=1)
>>> law = ControllerBlock(
...     "law", 1, slice(0, 1), slice(0, 1), variable=lambda w: 1j * w, before=lambda w: np.ones((len(w), 1), complex),
...     after=lambda w: np.exp(-0.02j * w), free=np.ones((2, 2), dtype=bool),
... )
>>> gains = (
...     ResponseGain("error", (0,), None, None, np.ones_like),
...     ResponseGain("sensitivity", (0,), slice(0, 1), slice(0, 1), lambda w: np.full(len(w), 1.0 / 1.8), hard=True),
... )
>>> problem = ResponseProblem((law,), samples, gains)
>>> start = parameters_of((law,), [np.array([[-5.0, 1.0], [-1.0, 0.0]])])
>>> source = ResponseSource(problem, stable=lambda x: x[0] < 0.0)
>>> found = descend(source, start, DescentOptions(iterations=8, tolerance=2e-3)).point
>>> bool(found.values[0] < problem.values(start)[0].max()), bool(found.values[1] <= 1.0 + 1e-6)
(True, True)
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
