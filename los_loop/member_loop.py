"""The implemented loop of many members of a family at chosen frequencies; no telescope is assembled.

:class:`los_loop.implemented_loop.ImplementedLoop` closes the loop of the sampled controllers around the telescope's
LFT; the response of a member is ``T11 + T12 Delta (I - M Delta)^-1 T21``. The direct part D of M is the same at all
frequencies, so that with ``W = Delta (I - D Delta)^-1``, real and of order 48, once for each member,

    T = T11 + T12 W (I - (M - D) W)^-1 T21

and M - D, T12 and T21 go through fewer signals than there are Delta channels (23 to 27 for the reference telescope):
``M - D = U N V'``, ``T12 = R V'``, ``T21 = U Q``. The LFT (N, R, Q, T11) is computed once, on a grid that is fine
wherever a lightly damped mode of some member can be; a member closes it with its W at the frequencies that it is looked
at (:meth:`lftkit.analysis.lft_response.LftResponse.closed_with_matrix`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
from scipy import linalg

from lftkit import SampledSystem, System
from lftkit.analysis.lft_response import LftResponse
from lftkit.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from lftkit.errors import InputError
from lftkit.support.settings import AlgorithmSettings
from los_loop.implemented_loop import HIGHEST, LOWEST, ImplementedLoop
from los_loop.open_loop import OpenLoop
from titop_plant.interface import STAGES
from titop_plant.telescope.control_plant import loop_plant
from titop_plant.telescope.telescope import Telescope


@dataclass(frozen=True)
class MemberLoopSettings(AlgorithmSettings):
    """Numbers of the common grid of all members, and of the points at which a member is looked at.

    Attributes
    ----------
    coarse : ratio of neighbouring frequencies away from the modes
    spacing : distance of grid points at a mode, in decay rates of the mode
    width : half-width of the stretch around a mode that is resolved, in decay rates
    cells : parts of the band, in each of which the grid has one spacing
    light, modes_end : damping ratio below which, and frequency [rad/s] below which, modes are looked at one by one
    draws : random members, beside the corners of the box, that tell where modes can be
    still : shift of a pole, in decay rates, that does not count
    beside : points of the grid on each side of a mode at which it is looked at too: fine control may move it by a few
        decay rates
    rank : singular value, over the largest, above which a direction of the Delta channels counts
    batch : frequencies at which the loop is closed at a time: many small matrices together take half the time
    together : frequencies of a member whose matrices are in the cache at once
    """

    coarse: float = 1.1
    spacing: float = 0.4
    width: float = 8.0
    cells: int = 20_000
    light: float = 0.1
    modes_end: float = 1600.0
    draws: int = 300
    still: float = 0.2
    beside: tuple[int, ...] = (3, 8)
    rank: float = 1e-13
    batch: int = 64
    together: int = 32


SETTINGS = MemberLoopSettings()


def channel_factors(system: System, rank: float = SETTINGS.rank) -> tuple[FloatArray, FloatArray]:
    """Orthonormal bases U (q, c) and V (q, b) of what Delta sees and of what it drives, to a relative `rank`."""
    q = len(system.channels)
    seen = np.hstack([system.C[:q], system.D[:q, q:]])
    driven = np.vstack([system.B[:, :q], system.D[q:, :q]])
    seen = seen / np.maximum(linalg.norm(seen, axis=0), 1e-300)
    driven = driven / np.maximum(linalg.norm(driven, axis=1), 1e-300)[:, None]
    return _range(seen, rank), _range(driven.T, rank)


def _range(matrix: FloatArray, rank: float) -> FloatArray:
    U, s, _ = linalg.svd(matrix, full_matrices=False)
    return np.asarray(U[:, s > rank * s[0]])


@dataclass(frozen=True)
class MovingModes:
    """Modes of the telescope below a frequency, for their frequencies: those that parameters move, and others.

    Parameters
    ----------
    A, B, C, D : ndarray
        Invariant subspace of the modes that move, with the inputs and outputs of W; the rest by its static gain.
    fixed : ndarray, complex
        Poles that no parameter moves by more than a part of their decay rates [rad/s].
    settings : MemberLoopSettings
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    fixed: ComplexArray
    settings: MemberLoopSettings = SETTINGS

    @classmethod
    def of(
        cls,
        A: FloatArray,
        B: FloatArray,
        C: FloatArray,
        members: Sequence[FloatArray],
        settings: MemberLoopSettings = SETTINGS,
    ) -> MovingModes:
        """Split the nominal telescope by an ordered Schur form; `members` are values of W."""
        poles, vectors = cast("tuple[ComplexArray, ComplexArray]", linalg.eig(A))
        left = linalg.inv(vectors)
        shift = np.max([np.abs(np.einsum("kb,bc,ck->k", left @ B, W, C @ vectors)) for W in members], axis=0)
        below = np.abs(poles) < settings.modes_end
        fixed = poles[below & _light(poles, settings) & (shift < settings.still * -poles.real)]

        def moves(real: float, imaginary: float) -> bool:
            size = np.hypot(real, imaginary)
            return bool(size < settings.modes_end) and not bool(
                np.any(np.hypot(fixed.real - real, np.abs(fixed.imag) - abs(imaginary)) < 1e-9 * size)
            )

        S, Z, n = linalg.schur(A, output="real", sort=moves)
        if n == len(S):
            return cls(A, B, C, np.zeros((C.shape[0], B.shape[1])), fixed, settings)
        X = linalg.solve_sylvester(S[:n, :n], -S[n:, n:], -S[:n, n:])
        b, c = Z.T @ B, C @ Z
        rest = c[:, :n] @ X + c[:, n:]
        through = -rest @ linalg.solve(S[n:, n:], b[n:])
        return cls(S[:n, :n], b[:n] - X @ b[n:], c[:, :n], through, fixed, settings)

    def light(self, W: FloatArray) -> ComplexArray:
        """Lightly damped poles of a member with positive imaginary part [rad/s]."""
        closed = W @ linalg.inv(np.eye(len(self.D)) - self.D @ W, check_finite=False)
        moved = linalg.eigvals(self.A + self.B @ closed @ self.C, overwrite_a=True, check_finite=False)
        poles = np.concatenate([moved, self.fixed])
        return np.asarray(poles[_light(poles, self.settings) & (poles.imag > LOWEST)])


def _light(poles: ComplexArray, settings: MemberLoopSettings) -> BoolArray:
    return np.asarray(-poles.real < settings.light * np.abs(poles))


@dataclass(frozen=True)
class MemberLoop:
    """Responses of the members of one stage on a common grid.

    Parameters
    ----------
    loop : ImplementedLoop
    U, V : ndarray
        As :func:`channel_factors`.
    modes : MovingModes
    omega : ndarray, shape (F,)
        Grid [rad/s], rising.
    coarse : ndarray of int
        Indices of the grid that every member is looked at.
    reduced : LftResponse
        N, R, Q and T11 at each frequency of the grid, see the module.
    control : ndarray, complex, shape (F, 8, 22)
        Commands by measurements.
    settings : MemberLoopSettings
    """

    loop: ImplementedLoop
    U: FloatArray
    V: FloatArray
    modes: MovingModes
    omega: FloatArray
    coarse: IntArray
    reduced: LftResponse
    control: ComplexArray
    settings: MemberLoopSettings = SETTINGS

    @classmethod
    def of(
        cls,
        telescope: Telescope,
        k_fsm: SampledSystem,
        k_pma: SampledSystem,
        stage: str,
        settings: MemberLoopSettings = SETTINGS,
    ) -> MemberLoop:
        """Evaluate the LFT of an `ImplementedLoop` on the grid."""
        ports = telescope.loop_ports.used_by(k_fsm, k_pma)
        system = loop_plant(telescope, ports, isolated=stage != STAGES[0])
        loop = ImplementedLoop(OpenLoop(system, telescope, ports, real=True), k_fsm, k_pma, stage)
        U, V = channel_factors(system, settings.rank)
        rng = np.random.default_rng(0)
        members = [*telescope.corners(), *system.sample_values(rng, settings.draws)]
        chosen = [_reduced(loop, U, V, values) for values in members]
        q = len(system.channels)
        modes = MovingModes.of(system.A, system.B[:, :q] @ V, U.T @ system.C[:q], chosen, settings)
        omega, coarse = _grid(np.concatenate([modes.light(W) for W in chosen]), settings)
        D = system.D[: len(U), : len(U)]
        parts: list[LftResponse] = []
        control = []
        for first in range(0, omega.size, settings.batch):
            closed = loop.at_each(omega[first : first + settings.batch])
            lft = closed.lft
            parts.append(LftResponse(U.T @ (lft.M - D) @ V, lft.T12 @ V, U.T @ lft.T21, lft.T11))
            control.append(closed.control)
        names = ("M", "T12", "T21", "T11")
        reduced = LftResponse(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
        return cls(loop, U, V, modes, omega, coarse, reduced, np.concatenate(control), settings)

    def W(self, values: Mapping[str, float]) -> FloatArray:
        """The real matrix of a member, see the module.

        Raises
        ------
        ValueError
            A loop of the LFT that is singular at these values.
        """
        return _reduced(self.loop, self.U, self.V, values)

    def at(self, W: FloatArray, index: IntArray) -> ComplexArray:
        """Responses of a member at points of the grid, shape (k, 10, 30): as `ClosedAt.lft.T11` for this member."""
        found: ComplexArray = np.empty((len(index), *self.reduced.T11.shape[1:]), complex)
        for first in range(0, len(index), self.settings.together):
            part = slice(first, first + self.settings.together)
            found[part] = self.reduced[index[part]].closed_with_matrix(W)
        return found

    def looked_at(self, W: FloatArray) -> IntArray:
        """Points of the grid at and beside the lightly damped modes of a member, and the coarse ones."""
        near = np.searchsorted(self._middle, self.modes.light(W).imag)
        offsets = np.array([0, *self.settings.beside, *(-k for k in self.settings.beside)])
        beside = (near[:, None] + offsets).ravel()
        return np.asarray(np.unique(np.concatenate([self.coarse, np.clip(beside, 0, self.omega.size - 1)])))

    @cached_property
    def _middle(self) -> FloatArray:
        return np.asarray(np.sqrt(self.omega[1:] * self.omega[:-1]))


def _reduced(loop: ImplementedLoop, U: FloatArray, V: FloatArray, values: Mapping[str, Any]) -> FloatArray:
    delta = loop.delta(loop.point(dict(values))).real
    D = loop.system.D[: len(U), : len(U)]
    M = np.eye(len(U)) - D * delta
    right = V.T * delta  # V' Delta (I - D Delta)^-1 U
    W = linalg.solve(M.T, right.T, check_finite=False).T @ U
    if not np.isfinite(W).all():
        raise InputError(f"the LFT must be well posed at {dict(values)}")
    return np.asarray(W)


def _grid(poles: ComplexArray, settings: MemberLoopSettings) -> tuple[FloatArray, IntArray]:
    """Grid that resolves `poles` of all members, and the indices of its coarse points."""
    decay = -poles.real
    coarse = np.geomspace(LOWEST, HIGHEST, round(np.log(HIGHEST / LOWEST) / np.log(settings.coarse)) + 1)
    step = np.full(settings.cells, np.inf)
    edges = np.geomspace(LOWEST, HIGHEST, settings.cells + 1)
    for w, d in zip(poles.imag, decay):
        a, b = np.searchsorted(edges, [w - settings.width * d, w + settings.width * d])
        part = slice(max(a - 1, 0), b)
        step[part] = np.minimum(step[part], settings.spacing * d)
    fine = []
    last = 0.0
    for k in np.flatnonzero(np.isfinite(step)):
        at = max(last + step[k], edges[k])
        while at < edges[k + 1]:
            fine.append(at)
            last, at = at, at + step[k]
    omega = np.unique(np.concatenate([coarse, fine]))
    return omega, np.searchsorted(omega, coarse)


__all__ = ["MemberLoop", "MovingModes", "channel_factors"]
