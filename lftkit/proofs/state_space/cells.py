"""The inequality of one cell: scalings that bound the gain for all its parameters and all its frequencies.

Frequency is a real scalar repeated as often as there are states, so that one test holds for a whole interval, to
infinity where it has no end. With D and G of full size on that block the test loses nothing in frequency
(generalised Kalman-Yakubovich-Popov lemma, Iwasaki and Hara 2005); what may be lost is in the parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from lftkit.analysis.eigenvectors import EPS
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.blocks.structure import balanced
from lftkit.proofs.settings import CELLS, CellSettings
from lftkit.proofs.state_space.barrier import COMPLEX, FULL, REAL, BarrierBlock, Scalings
from lftkit.proofs.state_space.disks import disks_of
from lftkit.proofs.state_space.scaling_search import find_scalings
from lftkit.systems.system import System


class SingularCellError(ArithmeticError):
    """The middle of a cell has a pole on the imaginary axis, or a singular LFT."""


@dataclass(frozen=True)
class Cell:
    """Intervals of all parameters and of frequency.

    Parameters
    ----------
    intervals : tuple of (lower, upper)
        In the order of ``system.parameters``, physical values.
    band : (lower, upper)
        Frequencies [rad/s], ``0 <= lower < upper``; upper may be infinite.
    """

    intervals: tuple[tuple[float, float], ...]
    band: tuple[float, float]

    def split(self, axis: int, reference: float) -> tuple[Cell, Cell]:
        """Two halves; `axis` is the number of a parameter, or that of parameters for frequency.

        Parameters
        ----------
        axis : int
        reference : float
            Typical frequency [rad/s]: where a band from zero to infinity is cut.
        """
        if axis == len(self.intervals):
            at = frequency_cut(self.band, reference)
            return Cell(self.intervals, (self.band[0], at)), Cell(self.intervals, (at, self.band[1]))
        low, high = self.intervals[axis]
        at = 0.5 * (low + high)
        before, after = self.intervals[:axis], self.intervals[axis + 1 :]
        return Cell((*before, (low, at), *after), self.band), Cell((*before, (at, high), *after), self.band)

    def middle(self) -> FloatArray:
        """Centre of the parameter intervals."""
        return np.array([0.5 * (low + high) for low, high in self.intervals])


def frequency_cut(band: tuple[float, float], reference: float) -> float:
    """Where a band is cut: the geometric mean when it is wide, else the middle."""
    low, high = band
    if np.isinf(high):
        return max(reference, 4.0 * low)
    if low <= 0.0:
        return 0.25 * high
    return float(np.sqrt(low * high)) if high > 4.0 * low else 0.5 * (low + high)


@dataclass(frozen=True)
class CellScalings:
    """Scalings of a cell as a proof stores them.

    Parameters
    ----------
    P, Q : ndarray
        Hermitian, (n, n): of the frequency, P > 0.
    D, G : dict
        Parameter name to Hermitian (k, k), D > 0; complex and dynamic elements have D alone.
    centre : float
        Frequency [rad/s] about which the test was set up.
    performance : float
        Factor of the gain's inequality, positive; 1 for stability, where there is no gain.
    """

    P: ComplexArray
    Q: ComplexArray
    D: dict[str, ComplexArray]
    G: dict[str, ComplexArray]
    centre: float
    performance: float


class CellTest:
    """Tests of cells of one system at given levels.

    Parameters
    ----------
    system : System
        Channels of each element adjacent, real ones first (:func:`~lftkit.proofs.state_space.disks.real_first`).
    gain : bool
        Whether the gain from all inputs to all outputs is bounded; otherwise stability alone.
    radii : mapping of str to float, optional
        Of complex and dynamic elements in the place of their own.
    settings : CellSettings
    """

    def __init__(
        self,
        system: System,
        gain: bool,
        radii: Mapping[str, float] | None = None,
        settings: CellSettings = CELLS,
    ) -> None:
        self.system, self.gain, self.settings = system, gain, settings
        self.disks = disks_of(system, radii)
        q = len(system.channels)
        columns = system.B.shape[1] if gain else q
        rows = system.C.shape[0] if gain else q
        self.q, self.n = q, system.order
        self.A, self.B = system.A, system.B[:, :columns]
        self.C, self.D = system.C[:rows], system.D[:rows, :columns]
        self.sizes = [system.occurrences()[p.name] for p in system.parameters]
        self.sizes += [len(disk.channels) for disk in self.disks]
        self.nominal = [p.nominal for p in system.parameters]
        poles = np.abs(linalg.eigvals(self.A)) if self.n else np.ones(1)
        poles = poles[poles > 1e-12 * poles.max(initial=0.0)] if np.any(poles > 0.0) else np.ones(1)
        self.slowest, self.fastest = float(poles.min()), float(poles.max())
        self.reference = float(np.sqrt(self.slowest * self.fastest))

    def solve(self, cell: Cell, level: float, until: float = np.inf) -> tuple[CellScalings | None, int]:
        """Scalings that prove gain < `level` (stability where there is no gain) over the cell, if they are found.

        Raises
        ------
        SingularCellError
            A pole on the imaginary axis, or a singular LFT, in the middle of the cell.
        """
        maps, factors = self._maps(cell)
        maps[self.n + self.q :] /= level  # the gain in units of the level
        scale = balanced(maps, self.n + self.q)
        for disk in self.disks:  # one scale for all channels of a matrix of dynamics
            if disk.full:
                channels = [self.n + channel for channel in disk.channels]
                both = channels[: min(disk.outputs, disk.inputs)]  # the others have no column, or no row
                scale[channels] = float(np.exp(np.mean(np.log(scale[both]))))
        # Scale of every column: that of the last block for all the inputs
        total = self.n + self.q
        maps /= np.concatenate([scale[:total], np.full(maps.shape[1] - total, scale[total])])
        maps[:total] *= scale[:total, None]
        inputs = np.eye(maps.shape[1], dtype=complex)
        blocks, at = [], 0
        for size in ([self.n] if self.n else []) + self.sizes[: len(self.nominal)]:
            blocks.append(BarrierBlock(REAL, maps[at : at + size], inputs[at : at + size]))
            at += size
        for disk in self.disks:
            into = [self.n + channel for channel in disk.channels[: disk.inputs if disk.full else None]]
            out = [self.n + channel for channel in disk.channels]
            blocks.append(BarrierBlock(FULL if disk.full else COMPLEX, maps[into], inputs[out]))
        if self.gain:
            blocks.append(BarrierBlock(FULL, maps[total:] * scale[total], inputs[total:]))
        optimum, settings = find_scalings(blocks, until=until, settings=self.settings), self.settings
        if optimum.margin <= 0.0 and max(np.abs(g).max(initial=0.0) for g in optimum.G) > settings.free:
            optimum = find_scalings(blocks, until=until, penalty=settings.penalty, settings=settings)
        axis = self._axis(optimum, cell)
        if optimum.margin <= 0.0:
            return None, axis
        return self._unscaled(optimum, scale, factors, level, cell), axis

    def _maps(self, cell: Cell) -> tuple[ComplexArray, list[float]]:
        """Normalised matrix M from (w, d) to (z, e), every w = delta z with delta in [-1, 1]; widths of the blocks.

        The states come first: ``x' = j centre x + j width w`` with z = x, or for a band without end with
        z = 2 width x + w.
        """
        n, q = self.n, self.q
        centre, width, endless = self._frequency_interval(cell.band)
        # Centres of (value - nominal) and half widths; of a disk zero and its radius
        ends = np.array(cell.intervals, dtype=float).reshape(-1, 2)
        ranges = np.array([p.upper - p.lower or self.settings.no_scale for p in self.system.parameters])
        widths = np.maximum(0.5 * (ends[:, 1] - ends[:, 0]), self.settings.narrow * ranges)
        centres = 0.5 * (ends[:, 0] + ends[:, 1]) - np.array(self.nominal)
        radii = [disk.radius for disk in self.disks]
        centres, widths = np.concatenate([centres, np.zeros(len(radii))]), np.concatenate([widths, radii])
        per_channel_c, per_channel_r = np.repeat(centres, self.sizes), np.repeat(widths, self.sizes)
        inner = slice(0, q)
        matrix = np.zeros((n + q, n + q), complex)
        matrix[:n, :n] = 1j * centre * np.eye(n) - self.A
        matrix[:n, n:] = -self.B[:, inner]
        matrix[n:, :n] = -per_channel_c[:, None] * self.C[inner]
        matrix[n:, n:] = np.eye(q) - per_channel_c[:, None] * self.D[inner, inner]
        m = self.B.shape[1] - q
        right = np.zeros((n + q, n + q + m), complex)
        right[:n, :n] = -1j * (1.0 if endless else width) * np.eye(n)
        right[:n, n + q :] = self.B[:, q:]
        right[n:, n : n + q] = np.diag(per_channel_r)
        right[n:, n + q :] = per_channel_c[:, None] * self.D[inner, q:]
        solution = _solved(matrix, right)
        states, w = solution[:n], solution[n:]
        outputs = self.C @ states + self.D[:, inner] @ w
        outputs[:, n + q :] += self.D[:, q:]
        M = np.vstack([2.0 * width * states if endless else states, outputs])
        if endless:
            M[:n, :n] += np.eye(n)
        return M, [width, *widths]

    def _frequency_interval(self, band: tuple[float, float]) -> tuple[float, float, bool]:
        """Centre, half width, whether there is no end (then centre and width are those of a Moebius map)."""
        low, high = band
        if np.isinf(high):
            width = max(self.reference, low)
            return low + width, width, True
        return 0.5 * (low + high), max(0.5 * (high - low), self.settings.narrow * max(high, 1e-300)), False

    def _axis(self, scalings: Scalings, cell: Cell) -> int:
        """Number of the interval with the largest loss; intervals that are points are not bisected.

        In a cell that several parameters keep open, the loss of one may stay the largest however narrow its interval
        is. The losses of narrow intervals are therefore taken in proportion to their width.
        """
        low, high = cell.band
        if self.n and min(high, 2.0 * self.fastest) > self.settings.wide * max(
            low, 0.5 * self.slowest
        ):  # poles over a wide band
            return len(self.nominal)
        first = 1 if self.n else 0
        losses = list(scalings.losses[first : first + len(self.nominal)])
        losses.append(scalings.losses[0] if self.n and high - low > 1e-12 * high else 0.0)
        parts = [
            (upper - lower) / (p.upper - p.lower) if upper - lower > 4.0 * EPS * max(abs(lower), abs(upper)) else 0.0
            for (lower, upper), p in zip(cell.intervals, self.system.parameters)
        ]
        for i, part in enumerate(parts):
            losses[i] *= min(1.0, self.settings.deep * part / max(parts)) if part else 0.0
        return int(np.argmax(losses))

    def _unscaled(
        self, scalings: Scalings, scale: FloatArray, widths: list[float], level: float, cell: Cell
    ) -> CellScalings:
        n = self.n
        D, G, at = [], [], 0
        first = [] if n else [np.zeros((0, 0), complex)]
        matrices_D, matrices_G = [*first, *scalings.D], [*first, *scalings.G]
        for d, g, size, width in zip(matrices_D, matrices_G, [n, *self.sizes], widths):
            part = scale[at : at + len(d)]
            s = np.outer(part, part)
            at += size
            D.append(s * d / width**2)
            G.append(s * g / width)
        centre, width, endless = self._frequency_interval(cell.band)
        if endless:
            D[0], G[0] = 4.0 * width**3 * D[0], 2.0 * width**2 * G[0]
        names = [p.name for p in self.system.parameters]
        every = [*names, *(disk.name for disk in self.disks)]
        performance = 2.0 * float(scalings.D[-1][0, 0].real) * (scale[-1] / level) ** 2 if self.gain else 1.0
        return CellScalings(D[0], G[0], dict(zip(every, D[1:])), dict(zip(names, G[1:])), centre, performance)


def _solved(matrix: ComplexArray, right: ComplexArray) -> ComplexArray:
    if not len(matrix):
        return right
    size = np.abs(matrix).max(axis=1, initial=0.0)
    if not np.all(size > 0.0):
        raise SingularCellError("the middle of a cell must not have a pole on the imaginary axis, got one")
    scaled = matrix / size[:, None]
    factors, pivots, _ = linalg.lapack.zgetrf(scaled)
    diagonal = np.abs(np.diag(factors))
    if not diagonal.min() > 1e-15 * diagonal.max():
        raise SingularCellError("the middle of a cell must not have a pole on the imaginary axis, got one")
    solution: Any = linalg.lapack.zgetrs(factors, pivots, right / size[:, None])[0]
    return np.asarray(solution)
