"""Tuning in discrete time: loops on samples, controllers that run on samples, norms on the unit circle.

The descent works on the image in continuous time (:mod:`lftkit.systems.sampled.image`); what comes back, and its
certificate, is of the discrete loop itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from lftkit.arrays import FloatArray
from lftkit.errors import InputError
from lftkit.systems.arguments import checked
from lftkit.systems.sampled.image import image_of, sampled_from_image
from lftkit.systems.system import System
from lftkit.tuning.certificate import AGREEMENT, certify
from lftkit.tuning.descent.starts import start_checked
from lftkit.tuning.full_order import sampled_lqg_starts
from lftkit.tuning.goals import Goal
from lftkit.tuning.goals.goal import resolved
from lftkit.tuning.lexicographic import tuned_in_order
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.requirements import TuningRequirement
from lftkit.tuning.result import TuningResult
from lftkit.tuning.status import TuningStatus, inaccurate
from lftkit.tuning.structures.on_image import StructureOnImage, required_period
from lftkit.tuning.structures.stable_state_space import StableStateSpace
from lftkit.tuning.structures.structures import AffineStructure, Structure
from lftkit.tuning.tuner import tune


@checked
def tune_discrete(
    models: Sequence[System],
    requirements: Sequence[TuningRequirement | Goal],
    structure: Structure,
    *,
    initial: Sequence[ArrayLike] = (),
    min_decay: float | None = None,
    options: TuningOptions | None = None,
) -> TuningResult:
    """Tune a discrete controller on discrete models, as :func:`lftkit.tuning.tune` does in continuous time.

    Parameters
    ----------
    models : sequence of System
        All with the same sampling period.
    requirements : sequence
        As in :func:`lftkit.tuning.tune`. Weights have the same period, or are in continuous time, as those of goals,
        and count at ``s = (2 / T) (z - 1) / (z + 1)``. White noise of unit density (:class:`H2Gain`) has samples of
        variance 1 / T; poles z count as ``log(z) / T``, and bands end at pi / T.
    structure : Structure
        Of the discrete controller: entries are those of its matrices, also fixed and bounded ones. A PID has the
        sampling period (``pid(..., dt=0.1)``) and is that of the trapezoidal rule.
    initial, min_decay, options
        As in :func:`lftkit.tuning.tune`; initial parameters are those of discrete controllers, and
        the decay is that of the image, ``-log|z| / T`` for slow poles [rad/s].

    Returns
    -------
    TuningResult
        With a discrete controller; norms of the certificate are of the discrete loops, and decay rates are those of
        ``log|z| / T`` [rad/s].

    Raises
    ------
    ValueError
        A model in continuous time, another period, a requirement or a structure that is not among these.

    Examples
    --------
    x+ = 0.5 x + w + u with u = k x: the gain 1 / (1 - |0.5 + k|) is least at k = -0.5.

    >>> plant = System([[0.5]], [[1, 1]], [[1], [1]], np.zeros((2, 2)), [("w", 1), ("u", 1)], [("z", 1), ("y", 1)],
    ...               dt=0.1)
    >>> from lftkit.tuning import HinfGain, gain
    >>> result = tune_discrete([plant], [HinfGain("w", "z")], gain([("y", 1)], [("u", 1)]),
    ...                        initial=[[-0.1]], options=TuningOptions(starts=0))
    >>> round(result.soft, 3), round(result.controller.D.item(), 2)
    (1.0, -0.5)
    """
    ready, needs = resolved(models, requirements)
    dt = float(ready[0].dt)
    for model in ready:
        model.require_certain()
        if not model.dt:
            raise InputError(f"{model.name}: system must be in discrete time, got one in continuous time")
        if model.dt != dt:
            raise InputError(f"{model.name}: sampling period must be {ready[0].dt} s, got {model.dt} s")
    if options is not None and options.lexicographic:
        run = partial(tune_discrete, ready, min_decay=min_decay)
        starting = [start_checked(x, structure) for x in initial]
        return tuned_in_order(run, needs, structure, starting, options, AGREEMENT)
    law = _law(structure, dt)
    images = [r.on_image(ready[0]) for r in needs]
    starts = [start_checked(x, structure) for x in initial]
    if options is None or options.starts:
        starts += sampled_lqg_starts(ready[0], needs, structure)
    if isinstance(law, AffineStructure):
        starts = [_parameters_of_image(law, x, dt) for x in starts]
    result = tune([image_of(m) for m in ready], images, law, initial=starts, min_decay=min_decay, options=options)
    K = law.sampled(result.x) if isinstance(law, StructureOnImage) else sampled_from_image(result.controller, dt)
    certificate = certify(ready, K, needs)
    status, advice = result.status, result.advice
    if result.certificate is None and status is TuningStatus.NOT_STABILISED:
        return replace(result, controller=K)
    stable = bool(np.all(certificate.abscissae < 0.0))
    if stable and not np.allclose(certificate.values, result.values, rtol=AGREEMENT, atol=1e-9):
        status, advice = TuningStatus.INACCURATE, inaccurate(result.values, certificate.values)
    hard = np.array([r.hard for r in needs])
    return replace(
        result,
        status=status,
        advice=advice,
        controller=K,
        x=law.parameters_of(K) if law.order and isinstance(law, AffineStructure) else result.x,
        values=certificate.values,
        soft=float(certificate.values[~hard].max(initial=-np.inf)),
        hard=float(certificate.values[hard].max(initial=-np.inf)),
        peak_frequencies=certificate.peak_frequencies,
        abscissa=float(certificate.abscissae.max()),
        certificate=certificate if stable else None,
    )


def _law(structure: Structure, dt: float) -> AffineStructure | StructureOnImage:
    """What the descent works on: the structure itself where its image is one of the same kind, else its image."""
    required_period(structure, dt)
    if isinstance(structure, StableStateSpace):
        raise InputError("structure must have entries of discrete matrices, got StableStateSpace of continuous time")
    if isinstance(structure, AffineStructure):
        free = len(structure.parameters) == structure.base.size == structure.size and structure.bounds is None
        if not structure.order or (free and not structure.base.any()):
            return replace(structure, dt=None)
    return StructureOnImage(structure, dt)


def _parameters_of_image(structure: AffineStructure, x: FloatArray, dt: float) -> FloatArray:
    if not structure.order:
        return x
    n, K = structure.order, structure.gain_matrix(x)
    sampled = System(K[:n, :n], K[:n, n:], K[n:, :n], K[n:, n:], structure.inputs, structure.outputs, "K", dt=dt)
    return structure.parameters_of(image_of(sampled))
