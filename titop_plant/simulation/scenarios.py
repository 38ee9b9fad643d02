"""Scenarios: where the tones of the disturbance come from, a function for each name of the option ``--scenario``.

==============  ========================================================================================
``worst_case``  the tone that the run was given: the one of unit norm that is worst for its loop
``unit_norm``   tones at the worst frequencies of the telescope on its isolator; their norms add up to 1
``design``      the same tones with norm 1 each, all at once: more than a design for norm 1 allows, a stress case
``imbalance``   imbalance of the wheels and micro-steps of the drives
``ramp``        the same while wheel speeds and array angle follow a profile
``none``        no tones: the sources of the user alone
==============  ========================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from lftkit.arrays import FloatArray
from titop_plant.disturbances import wheel_and_drive_tones as tones
from titop_plant.disturbances.wheel_and_drive_tones import Tones, joined
from titop_plant.interface import NO_SCENARIO
from titop_plant.telescope.telescope import Telescope


@dataclass(frozen=True)
class Circumstances:
    """Data from which a scenario makes its tones.

    Parameters
    ----------
    telescope : Telescope
        Of the parameter file.
    speeds : ndarray, shape (wheels,)
        Of the wheels [rad/s].
    rng : numpy.random.Generator
        For phases; its seed is that of the run.
    given : tuple of tuples
        Tones that the configuration holds, see :func:`titop_plant.disturbances.wheel_and_drive_tones.given_tones`.
    isolator_tones : callable
        Makes :func:`titop_plant.disturbances.wheel_and_drive_tones.design_tones` of the telescope on its isolator.
    """

    telescope: Telescope
    speeds: FloatArray
    rng: np.random.Generator
    given: tuple[tuple[float, ...], ...]
    isolator_tones: Callable[[], Tones]


Scenario = Callable[[Circumstances], Tones]


def worst_case(now: Circumstances) -> Tones:
    """The tone that the run was given."""
    return tones.given_tones(now.given, now.telescope.channels)


def design(now: Circumstances) -> Tones:
    """Tones of unit norm each where the telescope on its isolator is worst."""
    return now.isolator_tones()


def unit_norm(now: Circumstances) -> Tones:
    """The tones of :func:`design` with shares that add up to 1, drawn at random (uniform on the simplex).

    An H-infinity norm bounds the response to one tone of norm 1 and, by the triangle inequality, that to these tones
    together, at every instant and in every window. With squares that add up to 1 it bounds the root mean square over
    all times only, and single windows are larger where the tones beat.
    """
    tones = now.isolator_tones()
    shares = now.rng.spawn(1)[0].exponential(size=tones.frequency.size)
    return replace(tones, amplitude=tones.amplitude * (shares / shares.sum()))


def imbalance(now: Circumstances) -> Tones:
    """Wheels and drives."""
    wheels = tones.imbalance_tones(now.telescope, now.speeds, now.rng)
    return joined([wheels, tones.sadm_tones(now.telescope, now.rng)])


TONES: Mapping[str, Scenario] = MappingProxyType(
    {
        "worst_case": worst_case,
        "unit_norm": unit_norm,
        "design": design,
        "imbalance": imbalance,
        "ramp": imbalance,
        NO_SCENARIO: lambda now: tones.no_tones(now.telescope.channels),
    }
)
"""Tones of each name of :data:`titop_plant.interface.SCENARIOS`, and of none."""

FOLLOWING = ("imbalance", "ramp")
"""Scenarios with tones that follow the wheels while their speeds change."""

__all__ = ["FOLLOWING", "TONES", "Circumstances", "Scenario"]
