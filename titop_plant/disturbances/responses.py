"""Frequency responses from micro-vibrations to the line of sight without fine control, as data for figures.

Every response is computed on a grid that is refined at the poles of the model at the same parameter values. Where
a curve is reduced to the columns of a figure, a column has the highest value inside it, so no resonance is lost.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit import Port, System
from lftkit.analysis.batched_linalg import largest_gains
from lftkit.analysis.frequency_grid import frequency_grid
from lftkit.analysis.frequency_response import SETTINGS, frequency_response
from lftkit.arrays import FloatArray
from lftkit.systems.ports import port_slices
from titop_plant.telescope.assembly import assembled_telescope, build_telescope
from titop_plant.telescope.control_plant import disturbances_of
from titop_plant.telescope.layout import SADM_TORQUE, WHEEL_IMBALANCE, present
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import weight_amplitudes

ARCSEC = math.pi / 648000.0
WHEELS, DRIVES = (WHEEL_IMBALANCE,), (SADM_TORQUE,)
ALL = (*WHEELS, *DRIVES)


@dataclass(frozen=True)
class Curve:
    """A response over frequency.

    Parameters
    ----------
    omega : ndarray, shape (k,)
        rad/s.
    size : ndarray, shape (k,)
    """

    omega: FloatArray
    size: FloatArray

    def columns(self, edges: FloatArray) -> FloatArray:
        """Highest value within each of the columns between `edges`, shape (len(edges) - 1,).

        A column without a point of its own has the value of the curve at its middle.
        """
        column = np.searchsorted(edges, self.omega, side="right") - 1
        inside = (column >= 0) & (column < edges.size - 1)
        middle = np.sqrt(edges[1:] * edges[:-1])
        highest = np.exp(np.interp(np.log(middle), np.log(self.omega), np.log(self.size)))
        np.maximum.at(highest, column[inside], self.size[inside])
        return np.asarray(highest)


@dataclass(frozen=True)
class DisturbanceResponses:
    """The telescope with isolator and with a hard-mounted payload, from the disturbances to the line of sight."""

    telescope: Telescope
    isolated: System
    hard: System

    def weighted(
        self,
        system: System,
        values: Mapping[str, float],
        inputs: Sequence[str],
        low: float,
        high: float,
        tolerance: float = SETTINGS.agreement,
    ) -> Curve:
        """Largest singular value from normalised disturbances to the line of sight [arcsec].

        Of `inputs` those that the telescope has count. Normalised: 1 corresponds to the amplitudes of the weights,
        0.4 N, 0.35 N and 0.3 Nm of each wheel above 5 rad/s and 0.1 Nm of each array drive. `tolerance` is that of
        :func:`lftkit.analysis.frequency_response.frequency_response`.
        """
        data = system["los_controlled", present(inputs, system.inputs)].at(values)
        omega = frequency_grid(linalg.eigvals(data.A), low, high, points=500)
        amplitude = weight_amplitudes(self.telescope, omega)
        columns = port_slices(self.telescope.disturbance_ports)
        scale = np.hstack([amplitude[:, columns[port.name]] for port in data.inputs])
        response = frequency_response(data, omega, tolerance=tolerance) * scale[:, None, :]
        return Curve(omega, np.asarray(largest_gains(response) / ARCSEC))

    def first_channel(self, values: Mapping[str, float], low: float, high: float) -> Curve:
        """Line of sight about x due to the first imbalance channel of wheel 1, its radial force x [arcsec/N]."""
        whole = self.isolated["los_controlled", "wheel_imbalance"].at(values)
        data = System(
            whole.A, whole.B[:, :1], whole.C[:1], whole.D[:1, :1], (Port("force", 1, "N"),), (Port("los", 1, "rad"),)
        )
        omega = frequency_grid(linalg.eigvals(data.A), low, high, points=500, offsets=(0.0, 0.6, 1.2, 1.8, 2.4, 3.0))
        return Curve(omega, np.abs(frequency_response(data, omega)[:, 0, 0]) / ARCSEC)

    def with_rigid_wheels(self) -> System:
        """The same telescope on its isolator with wheels without bearings, inputs and outputs as `isolated`."""
        whole = build_telescope(self.telescope.without_bearings()).system
        return whole["los_controlled", disturbances_of(whole)]

    def band(
        self, system: System, inputs: Sequence[str], edges: FloatArray, members: int
    ) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest value of :meth:`weighted` over random parameter values, column by column."""
        draws = system.sample_values(np.random.default_rng(0), members)
        curves = [self.weighted(system, values, inputs, edges[0], edges[-1]).columns(edges) for values in draws]
        return np.min(curves, axis=0), np.max(curves, axis=0)


def disturbance_responses(telescope: Telescope) -> DisturbanceResponses:
    """Responses of a telescope with and without its isolator."""

    def part(isolated: bool) -> System:
        whole = assembled_telescope(telescope, isolated).system
        return whole["los_controlled", disturbances_of(whole)]

    return DisturbanceResponses(telescope, part(True), part(False))
