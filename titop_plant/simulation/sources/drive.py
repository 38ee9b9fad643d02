"""From sources to what they add to the state of the telescope and to its measurements, tick by tick.

Within a tick the forces and torques are the polynomial through their values at `NODES` instants; what it adds to the
state at the end of the tick is integrated exactly (matrix exponential). The instants are those of Gauss and Legendre,
so that a tone is right to 1e-9 at 100 Hz and to 1e-6 at 500 Hz, however fast the structure is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import linalg

from lftkit.arrays import FloatArray
from titop_plant.interface import DT
from titop_plant.simulation.build import PlantFamily
from titop_plant.simulation.plant_config import PlantConfig, parameter_values
from titop_plant.simulation.sources.places import source_ports
from titop_plant.simulation.sources.signals import Signal
from titop_plant.telescope.assembly import AssembledTelescope, build_telescope
from titop_plant.telescope.control_plant import with_sensors
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
        Of :func:`titop_plant.simulation.sources.places.place_matrix`, of several places p side by side.
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


def source_matrix(
    family: PlantFamily, config: PlantConfig, sources: Sequence[PlacedSource], dt: float = DT
) -> FloatArray:
    """What the values of the sources within a tick add to next state (n), measurement and truth (24).

    Parameters
    ----------
    family : PlantFamily
    config : PlantConfig
        Member of the family, a telescope of constant parameters.
    sources : sequence of PlacedSource
    dt : float
        Tick [s].

    Returns
    -------
    ndarray, shape (n + 24, 6 s (`NODES` + 1))
        More rows where the family is that with the further sensors.
        Columns: place of a source, s in all, then instant, then axis.
    """
    whole = with_sensors(loaded_telescope(family.telescope, family.isolated).system, family.telescope)
    chosen = whole.select(
        inputs=[p.name for p in source_ports(family.telescope)], outputs=[p.name for p in family.control_loop.outputs]
    )
    data = chosen.at(parameter_values(config, family.telescope))
    B, D = (M @ np.hstack([one.matrix for one in sources]) for M in (data.B, data.D))
    pushes = _integrals(data.A, B, dt)
    n, m = B.shape
    table = np.zeros((n + D.shape[0], m // 6, NODES + 1, 6))
    table[n:, :, 0] = D.reshape(D.shape[0], m // 6, 6)
    table[:n, :, 1:] = pushes.reshape(NODES, n, m // 6, 6).transpose(1, 2, 0, 3)
    return table.reshape(n + D.shape[0], m * (NODES + 1))


def _integrals(A: FloatArray, B: FloatArray, dt: float) -> FloatArray:
    """Next state due to a unit value at each node, shape (nodes, n, m)."""
    n, m = B.shape
    whole = np.zeros((n + NODES * m, n + NODES * m))
    whole[:n, :n], whole[:n, n : n + m] = A * dt, B * dt
    for j in range(NODES - 1):
        here = n + j * m
        whole[here : here + m, here + m : here + 2 * m] = np.eye(m)
    taylor = linalg.expm(whole)[:n, n:].reshape(n, NODES, m)
    powers = np.array([[tau**j / math.factorial(j) for j in range(NODES)] for tau in GAUSS])
    return np.asarray(np.einsum("njm,jq->qnm", taylor, linalg.inv(powers)))


class Sources:
    """Sources as a :class:`titop_plant.simulation.driven_plant.Disturbance` for :func:`source_matrix`.

    Parameters
    ----------
    sources : sequence of PlacedSource
    dt : float
        Tick [s].
    """

    def __init__(self, sources: Sequence[PlacedSource], dt: float = DT) -> None:
        self.sources, self.dt, self._tick = tuple(sources), dt, 0
        found = [one.signal.lines for one in self.sources]
        self.lines = np.unique(np.concatenate(found)) if found else np.zeros(0)

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
