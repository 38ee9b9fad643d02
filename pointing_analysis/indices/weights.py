r"""Spectral weights of the RPE: the share of a tone's rms that the index contains.

A tone of amplitude A and frequency :math:`\omega` on one axis has :math:`\mathrm{RPE_{rms}} = |W(\omega)|\, A/\sqrt
2`. The weights here follow from the window mean (Lucke et al. 1992; Ott et al. 2011). The second-order rational fit of
the synthesis (:func:`titop_plant.telescope.weights.rpe_weight`) **is no upper bound**: the exact weight is up to 4.5 %
larger in amplitude (near :math:`\omega\Delta t = 5.3`, 42 Hz for 20 ms), so a design with norm 1 allows a measured RPE
of 1.045 times its limit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pointing_analysis.arrays import ComplexArray, FloatArray

AVERAGED = 100
"""Windows over which the weight of one that is no whole number of samples is averaged."""


def rpe_exact(omega: ArrayLike, window: float) -> FloatArray:
    r"""Continuous-time RPE weight :math:`\sqrt{1-2(1-\cos y)/y^2}`.

    Examples
    --------
    Over whole periods the mean is zero and all of the tone is jitter:

    >>> float(rpe_exact(2 * np.pi * 50, 0.02).round(6))
    1.0
    >>> float(rpe_exact(2 * np.pi * 10, 0.02).round(6))
    0.353355
    """
    y = np.asarray(omega, dtype=float) * window
    # 1 - sinc^2 loses its digits for small y; the series y^2/12 (1 - y^2/30) is exact there to 1e-13.
    small = np.abs(y) < 2e-3
    series = y**2 / 12 * (1 - y**2 / 30)
    return np.asarray(np.sqrt(np.where(small, series, np.maximum(1 - np.sinc(y / (2 * np.pi)) ** 2, 0))))


def rpe_discrete(omega: ArrayLike, samples: float, dt: float) -> FloatArray:
    r"""RPE weight of the window estimator on samples: :math:`\sqrt{1-[\sin(N\omega T/2)/(N\sin(\omega T/2))]^2}`.

    Parameters
    ----------
    omega : [rad/s], below the Nyquist frequency for a meaningful answer
    samples : N, samples per window; of windows that are no whole number of samples the mean square over the places
        that the edges of disjoint windows have in their samples
    dt : sampling period T [s]
    """
    angle = np.asarray(omega, dtype=float) * dt
    if samples != round(samples):
        return _rpe_fractional(angle, samples)
    half = angle / 2
    bottom = samples * np.sin(half)
    flat = np.abs(bottom) < 1e-9
    kernel = np.where(flat, 1.0, np.sin(samples * half) / np.where(flat, 1.0, bottom))
    return np.asarray(np.sqrt(np.maximum(1 - kernel**2, 0)))


def _rpe_fractional(angle: FloatArray, n: float) -> FloatArray:
    """RPE weight of windows of n samples, no whole number; `angle` is the phase of the tone from sample to sample."""
    turn = np.exp(1j * angle)
    flat = np.abs(turn - 1) < 1e-9

    def integral(at: float) -> ComplexArray:
        whole = int(at)
        return np.asarray((turn**whole - 1) / np.where(flat, 1.0, turn - 1) + (at - whole) * turn**whole)

    power = np.zeros(angle.shape)
    for begin in (n * np.arange(AVERAGED)) % 1.0:
        power += np.abs(integral(begin + n) - integral(begin)) ** 2
    return np.asarray(np.where(flat, 0.0, np.sqrt(np.maximum(1 - power / (AVERAGED * n**2), 0))))
