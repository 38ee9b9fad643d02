"""Sources at places of the telescope, and their values at the instants of each tick.

Within a tick forces and torques are the polynomial through their values at `NODES` instants, those of Gauss and
Legendre; :func:`titop_plant.simulation.source_matrix.source_matrix` has what it adds to the plant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lftkit.arrays import FloatArray
from titop_plant.disturbances.signals import Signal
from titop_plant.interface import DT
from titop_plant.telescope.assembly import AssembledTelescope, build_telescope
from titop_plant.telescope.telescope import Telescope

NODES = 6
GAUSS: FloatArray = 0.5 * (np.polynomial.legendre.leggauss(NODES)[0] + 1.0)
INSTANTS: FloatArray = np.concatenate([[0.0], GAUSS])
"""Parts of a tick at which a source is asked for its values: the tick itself, for the measurement, and the nodes."""
FADE = 1.0
"""Seconds at the start of a run in which the sources grow to their size, so that they do not shake the structure."""


@dataclass(frozen=True)
class PlacedSource:
    """A source with its name, its place and its signal.

    Parameters
    ----------
    name, kind, place : str
        For rows of reports.
    matrix : ndarray, shape (size, 6 p)
        Of :func:`titop_plant.disturbances.places.place_matrix`, of several places p side by side.
    signal : Signal
    remarks : tuple of str
        What was done to its values, one sentence each.
    limit : float
        Largest force or torque of what makes it, an actuator: values are clipped to it.
    """

    name: str
    kind: str
    place: str
    matrix: FloatArray
    signal: Signal
    remarks: tuple[str, ...] = ()
    limit: float = math.inf


@lru_cache(maxsize=2)
def loaded_telescope(telescope: Telescope, isolated: bool) -> AssembledTelescope:
    """The telescope with a wrench at each place and the forces of its further actuators as inputs."""
    return build_telescope(telescope, isolated=isolated, loads=telescope.loaded_nodes, motors=True)


class Sources:
    """Sources as one :class:`titop_plant.simulation.driven_plant.Disturbance`: values of the instants of a tick.

    Parameters
    ----------
    sources : sequence of PlacedSource
    dt : float
        Tick [s].
    """

    def __init__(self, sources: Sequence[PlacedSource], dt: float = DT) -> None:
        self.sources, self.dt, self._tick = tuple(sources), dt, 0
        lines = [one.signal.lines for one in self.sources]
        self.lines = np.unique(np.concatenate(lines)) if lines else np.zeros(0)

    def reset(self) -> None:
        """Back to the first tick."""
        self._tick = 0

    def step(self, out: FloatArray) -> None:
        """Write the values of this tick, shape (6 s (`NODES` + 1),) [N, Nm]."""
        values, first = out.reshape(-1, NODES + 1, 6), 0
        for one in self.sources:
            last = first + one.matrix.shape[1] // 6
            tick = one.signal.tick(self._tick, INSTANTS)
            if one.limit < math.inf:
                tick = np.clip(tick, -one.limit, one.limit)
            values[first:last] = tick.reshape(NODES + 1, last - first, 6).transpose(1, 0, 2)
            first = last
        since = (self._tick + INSTANTS) * self.dt
        if since[0] < FADE:
            values *= np.square(np.sin(0.5 * np.pi * np.minimum(since / FADE, 1.0)))[:, None]
        self._tick += 1
