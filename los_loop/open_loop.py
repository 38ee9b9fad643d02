"""The telescope's LFT with its commands held: what a sampled controller sees at one frequency.

A command in force is held for a tick. Its fundamental, with the factor ``h = (1 - exp(-i w dt)) / (i w dt)``, drives
the LFT exactly; the images at ``w + k 2 pi / dt`` reach the samples through the **nominal** telescope: they are above
4700 rad/s for tones below 1500 rad/s, and what the parameters change there is below 1e-4 of the loop.

Of the channels of Delta those of the arrays' angle are half as many as the telescope has
(:mod:`los_loop.angle_channels`): 32 in place of 48.

In the paper's problem commands are not held: the LFT is that of the continuous telescope.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg

from lftkit import System
from lftkit.analysis.eigenvectors import modal
from lftkit.analysis.frequency_response import FrequencyResponse
from lftkit.analysis.lft_response import LftResponse
from lftkit.arrays import ComplexArray, FloatArray
from los_loop.angle_channels import half_turn, half_turn_slope, kept_channels
from titop_plant.interface import DT, TRUTH
from titop_plant.physical_settings import ANGLE
from titop_plant.telescope.loop_ports import LoopPorts
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import weight_amplitudes


class OpenLoop:
    """Responses of the uncertain telescope to normalised disturbances and held commands.

    Parameters
    ----------
    system : System
        As :func:`titop_plant.telescope.control_plant.control_loop_plant` makes it, or that at values of its parameters.
    telescope : Telescope
        Telescope parameters.
    ports : LoopPorts
        Rows of the telescope that the system has (:func:`titop_plant.telescope.control_plant.loop_plant`).
    real : bool
        Keep Delta real, with all channels of the arrays' angle.
    held : bool
        Whether commands are held for a tick; otherwise they act as they are, in continuous time.
    """

    def __init__(
        self,
        system: System,
        telescope: Telescope,
        ports: LoopPorts,
        *,
        real: bool = False,
        held: bool = True,
    ) -> None:
        self.ports, self.held = ports, held
        self.system, self.telescope = system, telescope
        self.names = tuple(p.name for p in system.parameters)
        kept = np.arange(len(system.channels)) if real else kept_channels(system)
        self.channels = len(kept)
        self.channel = np.array([self.names.index(system.channels[k]) for k in kept], dtype=int)
        at_angle = np.array([system.channels[k] == ANGLE for k in kept], dtype=bool)
        self.angle = at_angle & (len(kept) < len(system.channels))
        self.nominal = np.array([p.nominal for p in system.parameters])
        self.low = np.array([p.lower for p in system.parameters])
        self.width = np.array([p.upper for p in system.parameters]) - self.low
        columns = np.r_[kept, len(system.channels) : system.D.shape[1]]
        rows = np.r_[kept, len(system.channels) + np.arange(self.ports.measurements + TRUTH)]
        B, C, D = system.B[:, columns], system.C[rows], system.D[np.ix_(rows, columns)]
        self._response = FrequencyResponse.of(system.A, B, C, D)
        self._u = slice(self.channels, self.channels + self.ports.commands)
        self._D = D[self.channels :, self._u]
        self.disturbances = B.shape[1] - self._u.stop
        # eigenvectors of metres beside microradians: a plain solution with them has errors of 5e-7
        self._poles, self._right, self._left = modal(system.A, B[:, self._u], C[self.channels :])
        # What modal coordinates p keep over a tick, e^(p dt), and gain by a held input, (e^(p dt) - 1) / p
        x = self._poles * DT
        growth = np.where(
            np.abs(x) < 1e-6, DT * (1.0 + 0.5 * x), np.expm1(x) / np.where(self._poles == 0.0, 1.0, self._poles)
        )
        self._flow, self._growth = np.exp(x), np.asarray(growth)

    def point(self, values: dict[str, float]) -> FloatArray:
        """Parameter values (nominal where none is given) as a point of the unit cube."""
        table = dict(zip(self.names, self.nominal))
        full = np.array([float(values.get(name, table[name])) for name in self.names])
        return np.asarray((full - self.low) / self.width)

    def values(self, point: FloatArray) -> dict[str, float]:
        """Parameter values of a point of the unit cube."""
        return dict(zip(self.names, (self.low + np.clip(point, 0.0, 1.0) * self.width).tolist()))

    def delta(self, point: FloatArray) -> ComplexArray:
        """Entries of Delta, shape (..., channels), from points of the unit cube, shape (..., 7)."""
        values = self.low + point * self.width
        found = np.asarray((values - self.nominal)[..., self.channel], dtype=complex)
        if self.angle.any():
            found[..., self.angle] = half_turn(values[..., self.names.index(ANGLE)])[..., None]
        return found

    def delta_slope(self, point: FloatArray) -> ComplexArray:
        """Derivatives of the entries of :meth:`delta` by their own coordinate of the point, shape (..., channels)."""
        values = self.low + point * self.width
        found = np.array(np.broadcast_to(self.width, values.shape)[..., self.channel], dtype=complex)
        if self.angle.any():
            found[..., self.angle] *= half_turn_slope(values[..., self.names.index(ANGLE)])[..., None]
        return found

    def modes(self, point: FloatArray, low: float, high: float) -> FloatArray:
        """Frequencies [rad/s] of the telescope's own modes between two frequencies, at a point of the unit cube."""
        poles: ComplexArray = np.asarray(linalg.eigvals(self.system.at(self.values(point)).A), dtype=complex)
        found: FloatArray = np.abs(poles[poles.imag > 0.0])
        return np.asarray(np.unique(np.round(found[(found > low) & (found < high)], 9)))

    def at(self, omega: FloatArray) -> ComplexArray:
        """The LFT at N frequencies [rad/s].

        Returns
        -------
        ndarray, complex
            Shape (N, channels + y + 2, channels + m + u): from Delta, m normalised disturbances and u held commands to
            Delta, y measurements and the controlled line of sight.
        """
        q, m = self.channels, self.disturbances
        G = self._response.at(omega)
        out = np.empty((len(omega), q + self.ports.measurements + TRUTH, q + m + self.ports.commands), complex)
        size = weight_amplitudes(self.telescope, np.asarray(omega, dtype=float))
        images, holds = (self._images(omega), _hold(omega)) if self.held else (None, np.ones(len(omega)))
        for k, hold in enumerate(holds):
            held = G[k][:, self._u] * hold
            if images is not None:
                # images of the held command through the nominal telescope; the direct path is sampled as it is
                held[q:] += (self._left * images[k]) @ self._right + (1.0 - hold) * self._D
            out[k, :, :q] = G[k][:, :q]
            out[k, :, q : q + m] = G[k][:, self._u.stop :] * size[k]
            out[k, :, q + m :] = held
        turned = np.flatnonzero(self.angle)
        out[:, turned, turned] -= 1j
        return out

    def between(self, omega: FloatArray, rows: ComplexArray, columns: ComplexArray) -> ComplexArray:
        """``row P(w) column`` for the matrices P of :meth:`at` at N frequencies [rad/s], without them: shape (N,).

        Parameters
        ----------
        omega : ndarray, shape (N,)
        rows, columns : ndarray, complex, shapes (N, channels + y + 2) and (N, channels + m + u)
        """
        q, m = self.channels, self.disturbances
        hold = _hold(omega) if self.held else np.ones(len(omega))
        commands, plain = columns[:, q + m :], rows[:, q:]
        into = np.empty((columns.shape[1], len(omega)), complex)
        into[:q] = columns[:, :q].T
        into[self._u] = commands.T * hold
        into[self._u.stop :] = columns[:, q : q + m].T * weight_amplitudes(self.telescope, omega).T
        turned = 1j * np.sum(rows[:, :q][:, self.angle] * columns[:, :q][:, self.angle], axis=1)
        found = self._response.between(omega, rows, into)
        if self.held:
            images = np.sum(self._images(omega) * (plain @ self._left) * (commands @ self._right.T), axis=1)
            direct = np.sum((plain @ self._D) * commands, axis=1)
            found = found + images + (1.0 - hold) * direct
        return np.asarray(found - turned)

    def _images(self, omega: FloatArray) -> ComplexArray:
        """Factors of the nominal telescope's modes in the images of held commands, shape (N, modes)."""
        s = 1j * omega[:, None]
        return np.asarray(self._growth / (np.exp(s * DT) - self._flow) - _hold(omega)[:, None] / (s - self._poles))

    def closed_over(self, lft: ComplexArray, points: FloatArray) -> ComplexArray:
        """Responses at one frequency for parameter points: Delta is closed.

        Parameters
        ----------
        lft : ndarray, complex
            One matrix of :meth:`at`.
        points : ndarray, shape (N, 7)
            Of the unit cube.

        Returns
        -------
        ndarray, complex, shape (N, y + 2, m + u)
        """
        return LftResponse.of(lft, self.channels).closed(self.delta(points), self.angle)


def _hold(omega: FloatArray) -> ComplexArray:
    """Factor of the fundamental of a held command."""
    s = 1j * omega
    return np.asarray((1.0 - np.exp(-s * DT)) / (s * DT))
