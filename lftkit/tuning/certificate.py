"""Independent check of a design: norms and eigenvalues of the assembled closed loops.

Nothing here uses the code that tuned: the loop is assembled as one state-space model, weights and (Padé) delay
included, its H-infinity norms are bracketed by a level test, its H2 norms come from Lyapunov equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import FloatArray
from lftkit.systems.arguments import checked
from lftkit.systems.system import System
from lftkit.tuning.requirements import TuningRequirement
from lftkit.tuning.requirements.assembled_loop import AssembledLoop

AGREEMENT = 1e-3  # relative, of tuned values and certificate


@dataclass(frozen=True)
class Certificate:
    """Recomputed values of a design.

    Parameters
    ----------
    values : ndarray, shape (requirements, models)
        Normalised values.
    upper : ndarray, shape (requirements, models)
        For H-infinity gains the level certified never to be exceeded; equal to the values otherwise.
    peak_frequencies : ndarray, shape (requirements, models)
        Peak frequencies [rad/s]; zero for other requirements.
    abscissae : ndarray, shape (models,)
        Largest real part of the closed-loop poles at every model [rad/s]; in discrete time of ``log(z) / T``.
    """

    values: FloatArray
    upper: FloatArray
    peak_frequencies: FloatArray
    abscissae: FloatArray

    @property
    def stable(self) -> bool:
        """All models stable."""
        return bool(np.all(self.abscissae < 0.0))


@checked
def certify(
    models: Sequence[System],
    controller: System,
    requirements: Sequence[TuningRequirement],
    loop_delay: float = 0.0,
    *,
    rtol: float = 1e-5,
) -> Certificate:
    """Recompute everything on the assembled closed loops, in continuous or discrete time.

    Parameters
    ----------
    models : sequence of System
    controller : System
        Of the models' sampling period.
    requirements : sequence
    loop_delay : float
        Delay on the commands [s], Padé of order 8 here (another order than the tuner's). 0 in discrete time.
    rtol : float
        Distance between the two sides of the H-infinity norms.

    Raises
    ------
    ValueError
        Sampling periods that differ, a delay in discrete time, ports or weights that do not fit.

    Examples
    --------
    x+ = 0.5 x + w has its largest gain at z = 1:

    >>> from lftkit.tuning import HinfGain
    >>> plant = System([[0.5]], [[1, 1]], [[1], [1]], np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)],
    ...               dt=0.1)
    >>> found = certify([plant], System.static([[0.0]], [("y", 1)], [("u", 1)]), [HinfGain("w", "z")])
    >>> round(found.values.item(), 9), round(found.abscissae.item(), 3), found.stable
    (2.0, -6.931, True)
    """
    shape = (len(requirements), len(models))
    values, upper, omega = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    abscissae = np.zeros(len(models))
    for k, model in enumerate(models):
        loop = AssembledLoop(model, controller, loop_delay)
        abscissae[k] = loop.abscissa
        for i, r in enumerate(requirements):
            values[i, k], upper[i, k], omega[i, k] = r.certified(loop, rtol)
    return Certificate(values, upper, omega, abscissae)
