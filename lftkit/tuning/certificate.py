"""Independent check of a design: norms and eigenvalues of the assembled closed loops.

Nothing here uses the code that tuned: the loop is assembled as one state-space model, weights and (Padé) delay
included, its H-infinity norms are bracketed by a level test, its H2 norms come from Lyapunov equations. With a delay
the gain at the peak is moreover computed with the exact exponential.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from lftkit.analysis.band_gain import band_gain
from lftkit.analysis.norms import h2_norm, hinf_norm, spectral_abscissa
from lftkit.arrays import FloatArray
from lftkit.systems.connection.feedback import cascade, close_loop
from lftkit.systems.delay import pade_delay
from lftkit.systems.system import System
from lftkit.tuning.problem import delay_radius
from lftkit.tuning.requirements import ClosedLoopPoles, ControllerPoles, H2Gain, HinfGain, Requirement, check_weights
from lftkit.tuning.sector_gain import SectorGain

PADE_ORDER = 8
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
        Largest real part of the closed-loop poles at every model [rad/s].
    """

    values: FloatArray
    upper: FloatArray
    peak_frequencies: FloatArray
    abscissae: FloatArray

    @property
    def stable(self) -> bool:
        """All models stable."""
        return bool(np.all(self.abscissae < 0.0))


def certify(
    models: Sequence[System],
    controller: System,
    requirements: Sequence[Requirement],
    loop_delay: float = 0.0,
    *,
    rtol: float = 1e-5,
) -> Certificate:
    """Recompute everything on the assembled closed loops.

    Parameters
    ----------
    models : sequence of Model
    controller : System
    requirements : sequence
    loop_delay : float
        Delay on the commands [s], Padé of order 8 here (another order than the tuner's).
    rtol : float
        Distance between the two sides of the H-infinity norms.
    """
    shape = (len(requirements), len(models))
    values, upper, peak_frequencies = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    abscissae = np.zeros(len(models))
    delayed = delayed_controller(controller, loop_delay)
    for k, model in enumerate(models):
        bare = close_loop(model, delayed, (), ())
        abscissae[k] = spectral_abscissa(bare.A)
        for i, r in enumerate(requirements):
            if isinstance(r, HinfGain | H2Gain):
                values[i, k], upper[i, k], peak_frequencies[i, k] = _gain(model, delayed, r, rtol)
            else:
                values[i, k] = upper[i, k] = _poles(r, bare.A, controller.A, loop_delay)
    return Certificate(values, upper, peak_frequencies, abscissae)


def weighted_loop(model: System, controller: System, requirement: HinfGain | H2Gain) -> System:
    """Closed loop of a gain requirement with its weights, not yet divided by the bound.

    Raises
    ------
    ValueError
        A weight whose inner side does not fit the ports.
    """
    check_weights(requirement, model)
    loop = close_loop(model, controller, requirement.inputs, requirement.outputs)
    if requirement.weight_in is not None:
        loop = cascade(requirement.weight_in, loop)
    if requirement.weight_out is not None:
        loop = cascade(loop, requirement.weight_out)
    return loop


def _gain(model: System, controller: System, r: HinfGain | H2Gain, rtol: float) -> tuple[float, float, float]:
    loop = weighted_loop(model, controller, r)
    if isinstance(r, H2Gain):
        # feedthrough is zero by construction; what rounding leaves of it must not make the norm infinite
        D = np.where(np.abs(loop.D) <= 1e-12 * max(1.0, float(np.abs(loop.C).max(initial=0.0))), 0.0, loop.D)
        value = h2_norm(loop.A, loop.B, loop.C, D) / r.bound
        return value, value, 0.0
    if isinstance(r, SectorGain):
        return _index(loop, r, rtol)
    norm = band_gain(*loop.matrices, r.band, rtol=rtol) if r.banded else hinf_norm(*loop.matrices, rtol=rtol)
    return norm.value / r.bound, norm.upper / r.bound, norm.omega


def _index(loop: System, r: SectorGain, rtol: float) -> tuple[float, float, float]:
    """Value, upper bound and frequency of the index of a sector.

    An index whose system is unstable exceeds 1; its value is the largest gain on the axis.
    """
    index = r.realised(loop)
    if index is None:
        return np.inf, np.inf, np.inf
    if r.banded or (index.order and spectral_abscissa(index.A) >= 0.0):
        norm = band_gain(*index.matrices, r.band, rtol=rtol, stable=False)
    else:
        norm = hinf_norm(*index.matrices, rtol=rtol)
    return norm.value, norm.upper, norm.omega


def _poles(r: ClosedLoopPoles | ControllerPoles, closed: FloatArray, own: FloatArray, loop_delay: float) -> float:
    matrix = closed if isinstance(r, ClosedLoopPoles) else own
    spectrum = np.asarray(scipy.linalg.eigvals(matrix), dtype=complex)
    if loop_delay and isinstance(r, ClosedLoopPoles):
        spectrum = spectrum[np.abs(spectrum) < delay_radius(loop_delay, PADE_ORDER)]
    return float(r.pieces(spectrum)[0].max(initial=-np.inf))


def delayed_controller(controller: System, loop_delay: float) -> System:
    """Controller followed by the Padé approximation of the delay on its commands [s]."""
    if loop_delay == 0.0:
        return controller
    whole = cascade(controller, pade_delay(loop_delay, PADE_ORDER, controller.D.shape[0]))
    return System(*whole.matrices, controller.inputs, controller.outputs, controller.name)
