"""Corners of a box that are unstable early: ascent along derivatives of poles.

A pole moves by ``Re(y* dA x / y* x)`` with its left and right eigenvectors y and x, so that the corner to which it
moves fastest to the right is read off its derivatives by all parameters at once. The derivatives at that corner name
the next one, and so on. Where no such step helps, parameters are turned over one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from lftkit.analysis.batched_linalg import determinants, eigenvalues, inverses
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.settings import SEARCH, SearchSettings
from lftkit.systems.system import System


@dataclass(frozen=True)
class CornerSearch:
    """Corners of one box about the nominal values.

    Parameters
    ----------
    system : System
        Without inputs and outputs, channels of each parameter adjacent; at least one state and one parameter.
    ends : ndarray, shape (parameters, 2)
        Lower and upper deviation of each parameter from its nominal value.
    settings : SearchSettings
    """

    system: System
    ends: FloatArray
    settings: SearchSettings = SEARCH

    def offset(self, signs: FloatArray) -> FloatArray:
        """Deviations at corners, shape of `signs` (..., parameters) with entries -1 and 1."""
        return np.where(signs < 0.0, self.ends[:, 0], self.ends[:, 1])

    def unstable(self, corner: FloatArray, factor: float) -> bool:
        """Whether the member at a corner, scaled by a factor, has an unstable pole or is not well posed."""
        return bool(np.isinf(self._abscissas(corner[None], factor)[0]))

    def starts(self, samples: int, rng: np.random.Generator) -> Iterator[FloatArray]:
        """Corners to which the poles of the nominal member move fastest, and random ones."""
        poles, slopes = self._slopes(np.zeros(len(self.ends)))
        for number in np.argsort(-poles.real):
            if poles[number].imag >= 0.0:
                yield self._fastest(slopes[number], np.ones(len(self.ends)))
        for _ in range(samples):
            yield rng.choice([-1.0, 1.0], len(self.ends))

    def climb(self, start: FloatArray, factor: float) -> FloatArray:
        """Corner with the rightmost pole that was found from `start`, of the box scaled by a factor."""
        best, largest = start, float(self._abscissas(start[None], factor)[0])
        for _ in range(self.settings.flips):
            if np.isinf(largest):
                break
            turned = best * (1.0 - 2.0 * np.eye(len(best)))  # one parameter after the other
            candidates = np.vstack([*self._along_poles(best, factor), *turned])
            abscissae = self._abscissas(candidates, factor)
            number = int(np.argmax(abscissae))
            if not abscissae[number] > largest + 1e-12 * abs(largest):
                break
            best, largest = candidates[number], float(abscissae[number])
        return best

    def _along_poles(self, corner: FloatArray, factor: float) -> Iterator[FloatArray]:
        """Corners to which the derivatives of each pole lead, one after the other."""
        poles, slopes = self._slopes(factor * self.offset(corner))
        for number in np.flatnonzero(poles.imag >= 0.0):
            pole, slope, at = poles[number], slopes[number], corner
            for _ in range(self.settings.pole_steps):
                following = self._fastest(slope, at)
                if np.array_equal(following, at):
                    break
                yield following
                try:
                    moved, others = self._slopes(factor * self.offset(following))
                except linalg.LinAlgError:  # the LFT is singular there
                    break
                nearest = int(np.argmin(np.abs(moved - pole)))
                pole, slope, at = moved[nearest], others[nearest], following

    def _fastest(self, slope: FloatArray, otherwise: FloatArray) -> FloatArray:
        """Corner in which a pole with these derivatives moves fastest to the right."""
        gain = slope[:, None] * self.ends
        return np.where(gain[:, 1] > gain[:, 0], 1.0, np.where(gain[:, 1] < gain[:, 0], -1.0, otherwise))

    def _per_channel(self, deviations: FloatArray) -> FloatArray:
        return np.repeat(deviations, list(self.system.occurrences().values()), axis=-1)

    def _slopes(self, deviations: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Poles at a point and their derivatives by the parameters, shapes (n,) and (n, parameters)."""
        system = self.system
        delta = self._per_channel(deviations)
        loop = inverses((np.eye(len(delta)) - system.D * delta).astype(complex)[None])[0].real
        seen, driven = loop @ system.C, system.B @ (np.eye(len(delta)) + delta[:, None] * loop @ system.D)
        poles, left, right = linalg.eig(system.A + system.B @ (delta[:, None] * seen), left=True)
        products = np.einsum("ij,ij->j", left.conj(), right)
        size = np.where(np.abs(products) > 1e-300, products, 1e-300)
        moves = ((left.conj().T @ driven) * (seen @ right).T / size[:, None]).real
        first = np.cumsum([0, *list(system.occurrences().values())[:-1]])
        return np.asarray(poles, complex), np.asarray(np.add.reduceat(moves, first, axis=1))

    def _abscissas(self, corners: FloatArray, factor: float) -> FloatArray:
        """Largest real part of the poles at corners of the scaled box, infinite where that is not negative.

        A singular LFT, or one that became singular on the way there, counts as unstable.
        """
        abscissae = abscissas(self.system, self._per_channel(factor * self.offset(corners)))
        return np.where(abscissae < 0.0, abscissae, np.inf)


def abscissas(system: System, deltas: FloatArray) -> FloatArray:
    """Largest real parts of the poles (k,) of the members with deviations `deltas` (k, channels).

    Infinite where the LFT is singular, or became so on the way from the nominal member: the determinant of its loop is
    one there.
    """
    q, n = deltas.shape[1], system.order
    loops = (np.eye(q) - system.D[:q, :q] * deltas[:, None, :]).astype(complex)
    posed = determinants(loops).real > 0.0
    result = np.full(len(deltas), np.inf)
    if not n:
        return np.where(posed, -np.inf, result)
    seen = inverses(loops[posed]).real @ system.C[:q]
    moved = system.A + system.B[:, :q] @ (deltas[posed][:, :, None] * seen)
    result[posed] = eigenvalues(np.asarray(moved)).real.max(axis=1)
    return result


def earliest_unstable_corner(
    search: CornerSearch, largest: float, ray_factor: Callable[[FloatArray], float], *, samples: int, seed: int
) -> tuple[float, FloatArray | None]:
    """Smallest factor found at which a corner of the scaled box is unstable, and the signs of that corner.

    Parameters
    ----------
    search : CornerSearch
    largest : float
        Factor to begin with; infinity and None are returned if no corner was found there.
    ray_factor : callable
        First unstable factor on the ray to a corner, at most the one at which the corner was found.
    samples, seed : int
        Random corners to begin with, beside those of the nominal poles.
    """
    best, corner = np.inf, None
    factor = largest
    waiting = list(search.starts(samples, np.random.default_rng(seed)))
    while waiting:
        for number, start in enumerate(waiting):
            reached = search.climb(start, factor)
            if search.unstable(reached, factor):
                best, corner = min(factor, ray_factor(reached)), reached
                factor = search.settings.corner_below * best
                waiting = [reached, *waiting[number + 1 :], *waiting[:number]]
                break
        else:
            break
    return best, corner
