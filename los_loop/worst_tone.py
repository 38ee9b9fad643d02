"""The tone of unit norm that is worst for the implemented loop at given parameter values.

A disturbance of unit norm is a tone ``d(t) = Im(a exp(i w t))`` with ``|a_j / weight_j(w)|`` of norm 1 over the 22
weighted channels. The worst one has the frequency at which the largest singular value of the weighted response peaks
and the right singular vector of this response as its amplitudes. **The error that it makes has the amplitude gamma
times the limit**, which is what an H-infinity requirement bounds: the scenario ``worst_case`` runs this tone.

=========  =========================================================================================================
index      what is measured
=========  =========================================================================================================
``APE``    line of sight
``RPE``    relative error through the weight of the window (20 ms), sidebands of the camera's frame rate included
``slow``   the same, below the edge of the bands, where the proof-mass actuators have no effect
``fast``   the same, above it
=========  =========================================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit import System
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from los_loop.figures_of_merit import FigureOfMerit, error_names, figure
from los_loop.sampled_loop import SampledLoop
from los_loop.sampled_loop_norms import ToneModes, ToneResponse, loop_grid, tone_response
from los_loop.spec import LOS_ROWS
from titop_plant.simulation.modal_plant import ModalPlant
from titop_plant.telescope.telescope import Telescope
from titop_plant.telescope.weights import rpe_weight, weight_amplitudes

INDICES = error_names()
"""What a tone can be worst for."""

PEAKS, ZOOMS, ZOOM_POINTS = 6, 3, 25
"""The highest peaks of the grid are refined, then the highest of them so often, with so many points each."""

SAME = 1e-9
"""Relative difference of two frequencies, or of two entries of a vector, that is rounding."""


@dataclass(frozen=True)
class WorstTone:
    """A tone of unit norm and the error that it makes.

    Parameters
    ----------
    index : str
        What the tone is worst for, of :data:`INDICES`.
    omega : float
        rad/s.
    amplitude : ndarray, shape (channels,), complex
        Phasors on the disturbance inputs [N, Nm].
    gain : float
        Amplitude of the error [rad].
    limit : float
        Its limit [rad].
    los : ndarray, shape (2,), complex
        Phasor of the line of sight at the frequency of the tone [rad].
    """

    index: str
    omega: float
    amplitude: ComplexArray
    gain: float
    limit: float
    los: ComplexArray

    @property
    def gamma(self) -> float:
        """Amplitude of the error over its limit."""
        return self.gain / self.limit

    def turned(self, phase: float) -> WorstTone:
        """The same tone with another phase [rad] at the start."""
        turn = np.exp(1j * phase)
        return WorstTone(self.index, self.omega, self.amplitude * turn, self.gain, self.limit, self.los * turn)

    def peaking_at(self, time: float) -> WorstTone:
        """The same tone with the phase that gives the largest line of sight [rad, norm of both axes] at `time` [s].

        Examples
        --------
        >>> los = np.array([1.0 + 2.0j, 0.5 - 1.0j])
        >>> tone = WorstTone("APE", 3.0, np.zeros(22, complex), 1.0, 1.0, los).peaking_at(5.0)
        >>> sizes = [np.linalg.norm((tone.los * np.exp(3j * t)).imag) for t in (4.9, 5.0, 5.1)]
        >>> int(np.argmax(sizes))
        1
        """
        # |Im(l e^(i p))|^2 = (|l|^2 - Re(l.l e^(2 i p))) / 2 is largest where l.l e^(2 i p) is real and negative
        square = complex(np.sum(self.los**2))
        phase = float(0.5 * (np.pi - np.angle(square))) if square else 0.0
        return self.turned(phase - self.omega * time)

    def to_mapping(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "index": self.index,
            "omega": self.omega,
            "gain": self.gain,
            "limit": self.limit,
            **{
                f"{name}_{part}": getattr(getattr(self, name), part).tolist()
                for name in ("amplitude", "los")
                for part in ("real", "imag")
            },
        }

    @classmethod
    def from_mapping(cls, values: Any) -> WorstTone:
        """Read what :meth:`to_mapping` wrote.

        Raises
        ------
        ValueError
            Missing keys or other shapes.
        """
        try:
            amplitude, los = (
                np.array(values[f"{name}_real"], float) + 1j * np.array(values[f"{name}_imag"], float)
                for name in ("amplitude", "los")
            )
            tone = cls(
                str(values["index"]),
                float(values["omega"]),
                amplitude,
                float(values["gain"]),
                float(values["limit"]),
                los,
            )
        except (KeyError, TypeError) as error:
            raise InputError(f"a tone must have index, omega, gain, limit, amplitude and los, got {error}") from None
        if tone.amplitude.ndim != 1 or not tone.amplitude.size or tone.los.shape != (2,):
            raise InputError(f"a tone must have one amplitude for each disturbance, got {tone.amplitude.shape}")
        return tone


def worst_tone(
    loop: SampledLoop,
    plant: System | ModalPlant,
    telescope: Telescope,
    *,
    index: str,
    stage: str,
    closed: bool = True,
) -> WorstTone:
    """Worst tone of unit norm of a stable loop.

    Parameters
    ----------
    loop : SampledLoop
    plant : System or ModalPlant
        The continuous plant of the loop, in any coordinates.
    telescope : Telescope
        Tables ``weights`` and ``sadm``.
    index : str
        Of :data:`INDICES`.
    stage : str
        Of it depends the limit only.
    closed : bool
        Whether the controllers act, and so must leave the loop stable.

    Raises
    ------
    ValueError
        Another index, or a loop that is not stable.
    """
    if index not in INDICES:
        raise InputError(f"index must be one of {', '.join(INDICES)}, got {index!r}")
    radius = loop.growth
    if closed and not radius < 1.0:
        raise InputError(f"the loop must be stable, got a growth factor of {radius:.6f} per tick")
    row = figure(index)
    modes = ToneModes.of(loop, plant)

    def weighted(omega: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        return _weighted(tone_response(loop, plant, omega, modes, commands=False), telescope, omega, row)

    omega = _band(loop_grid(plant, loop.free, modes=modes), row.band_of(telescope))
    gains = _gains(weighted(omega)[0])
    for peaks in (PEAKS, *[1] * ZOOMS):
        # Points between the neighbours of each of the highest peaks, rising
        padded = np.concatenate([[-np.inf], gains, [-np.inf]])
        inner = np.flatnonzero((padded[1:-1] > padded[:-2]) & (padded[1:-1] >= padded[2:]))
        highest = inner[np.argsort(gains[inner])[::-1][:peaks]]
        ends = [(omega[max(k - 1, 0)], omega[min(k + 1, omega.size - 1)]) for k in highest]
        omega = np.asarray(np.unique(np.concatenate([np.geomspace(low, high, ZOOM_POINTS) for low, high in ends])))
        gains = _gains(weighted(omega)[0])
    w = omega[gains.argmax()]
    matrix, response = weighted(np.array([w]))
    gain, right = _leading(matrix[0])
    size = weight_amplitudes(telescope, w)[0]
    amplitude = size * right
    return WorstTone(index, float(w), amplitude, gain, float(row.limit(telescope, stage)), response[0] @ amplitude)


def _leading(matrix: ComplexArray) -> tuple[float, ComplexArray]:
    """Largest singular value and its right singular vector; the phase makes the largest entry real."""
    _, values, right = linalg.svd(matrix)
    vector = right[0].conj()
    size = np.abs(vector)
    largest = vector[np.flatnonzero(size > (1.0 - SAME) * size.max())[0]]  # of equal ones the first, however rounded
    return float(values[0]), np.asarray(vector * (np.abs(largest) / largest))


def _band(omega: FloatArray, band: tuple[float, float]) -> FloatArray:
    """Frequencies in a band, with its edges; of those that differ by rounding alone the lowest."""
    edges = [edge for edge in band if 0.0 < edge < np.inf]
    found = np.unique(np.append(omega[(omega > band[0]) & (omega < band[1])], edges))
    return np.asarray(found[np.diff(found, prepend=-np.inf) > SAME * found])


def _gains(matrix: ComplexArray) -> FloatArray:
    return np.asarray(np.sqrt(np.linalg.eigvalsh(matrix @ matrix.conj().swapaxes(1, 2))[:, -1].clip(0.0)))


def _weighted(
    tone: ToneResponse, telescope: Telescope, omega: FloatArray, row: FigureOfMerit
) -> tuple[ComplexArray, ComplexArray]:
    """Weighted response (k, rows, channels), its largest singular value is the gain; line of sight (k, 2, channels)."""
    size = weight_amplitudes(telescope, omega)[:, None, :]
    los = tone.fundamental[:, LOS_ROWS]
    if not row.relative:
        return los * size, los
    window = telescope.weights.rpe_window
    rows = [rpe_weight(omega, window)[:, None, None] * los * size]
    if tone.camera is not None:
        rows.append(tone.sideband_root(omega, window) @ tone.camera * size)
    return np.concatenate(rows, axis=1), los


__all__ = ["INDICES", "WorstTone", "worst_tone"]
