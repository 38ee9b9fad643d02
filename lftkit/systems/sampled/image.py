"""Discrete systems and their images in continuous time, with the same gains and Gramians.

The bilinear map ``s = (2 / T) (z - 1) / (z + 1)`` takes the unit circle to the imaginary axis and keeps every gain at
corresponding frequencies, hence stability and H-infinity norms without any error.
"""

from __future__ import annotations

import numpy as np

from lftkit.arrays import ComplexArray
from lftkit.errors import InputError
from lftkit.systems.sampled.bilinear import to_continuous, to_discrete, warped_frequency
from lftkit.systems.system import System


def image_of(model: System) -> System:
    """Continuous system with the response of the discrete `model` at ``s = (2 / T) (z - 1) / (z + 1)``.

    Raises
    ------
    ValueError
        A pole at z = -1, which is at infinity in the image.
    """
    try:
        A, B, C, D = to_continuous(*model.matrices, model.dt)
    except ValueError as error:
        raise InputError(f"{model.name}: {error}") from None
    root = float(np.sqrt(model.dt))  # the Gramians stay
    return System(A, root * B, C / root, D, model.inputs, model.outputs, model.name)


def continuous(system: System) -> System:
    """The system, or of a sampled one that which the bilinear map takes to it; its elements stay."""
    return system.with_lft(to_continuous(*system.lft, system.dt), dt=0.0) if system.dt else system


def sampled_from_image(model: System, dt: float) -> System:
    """Discrete system with period `dt` [s] whose image is `model`."""
    A, B, C, D = to_discrete(*model.matrices, dt)
    root = float(np.sqrt(dt))
    return System(A, B / root, root * C, D, model.inputs, model.outputs, model.name, dt=dt)


def band_of_image(band: tuple[float, float], dt: float) -> tuple[float, float]:
    """Band [rad/s] of the image of a system with period `dt` [s]."""
    return warped_frequency(band[0], dt), warped_frequency(band[1], dt)


def rates(z: ComplexArray, dt: float, deadbeat: float = 1e-12) -> ComplexArray:
    """``log(z) / dt`` [rad/s] of poles; one of a smaller magnitude than `deadbeat` counts as this fast."""
    return np.asarray(np.log(np.where(np.abs(z) < deadbeat, deadbeat, z.astype(complex))) / dt)
