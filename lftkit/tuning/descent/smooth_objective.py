"""Smooth approximation of a tuning problem on a fixed grid: the p-norm of all gains, and its Gauss-Newton metric."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lftkit.arrays import BoolArray, FloatArray, IntArray
from lftkit.tuning.descent.decay_limit import LimitWatch
from lftkit.tuning.descent.grid_model import GridModel
from lftkit.tuning.descent.metric import EIGENVALUE_FLOOR, Metric, metric_of
from lftkit.tuning.gains.gains import unresolved
from lftkit.tuning.gains.grid_gains import GridGains
from lftkit.tuning.pieces import HARD_TARGET
from lftkit.tuning.problem import Evaluation, Problem, worst_values
from lftkit.tuning.structures.structures import gain_sizes, jacobian

NEGLIGIBLE = 14.0  # entries below exp(-14) of the largest weight are left out
LEAST_LOG = float(np.log(1e-300))
PENALTY = 20.0  # of the squared logarithm of a violated hard requirement, unless a round asks for more
HARD_MARGIN = 0.1  # logarithm of a hard value above which a point is outside, if the round began below
APPROACH = 0.01  # fraction of the distance of the poles to the stability boundary that a round must leave
METRIC_POWER = 4.0  # weights of the Gauss-Newton matrix: this power of value over largest value
EXACT_STABILITY_ORDER = 60  # up to this order the poles are computed at every evaluation
LEAST_RETURN = 1e-3  # of the return difference's determinant over that of the first point: loops above that order
LARGEST_TURN = 2.0  # [rad] between neighbouring frequencies that the encirclement count trusts
LARGEST_TOTAL = 1.5  # [rad] of all turns; half a turn is a real pole that crosses, of which the grid may see half
MAX_SLOPES = 20  # slopes of one requirement and model in the metric
LEAST_NEAR = -0.7  # logarithm of values over the largest one above which they are linearised
MAX_NEAR = 600  # of one requirement and model
RIDGE, PROPORTION = 1e-4, 1e-2  # of the Gauss-Newton matrix: its own diagonal, and the sizes of the entries
PLANES = 120  # of the first quadratic program of a step
STEPS = 12  # between two looks at the exact values
SLOW = 1e-4  # decrease of the logarithm by the last steps below which no other follows
SAME_H2 = 1e-6  # H2 norms that agree this well over the models are computed for one model only


@dataclass(frozen=True)
class _Entry:
    """Values (m,) of one requirement at one model, at m frequencies or one."""

    requirement: int
    model: int
    values: FloatArray
    gradients: tuple[FloatArray, ...] = ()


class SmoothObjective:
    """Logarithm of the p-norm of the soft values, the hard ones as constraints, with gradient, on a grid fixed at `x`.

    With s and h the logarithms of the p-norms of the soft and hard values it is the augmented Lagrangian
    ``s + c max(h + m / 2c, 0)^2`` with the penalty c and the multiplier m. It is infinite where a loop is
    unstable, where a round would use up nearly all of the stability margin that it began with, and where a hard value
    exceeds both 1 and that of the first point by more than :data:`HARD_MARGIN`: however low the soft values are there,
    such a point is never taken.

    Parameters
    ----------
    problem : Problem
    x : ndarray, shape (size,)
        Stable point at which the grid is refined.
    evaluation : Evaluation
        Exact values there.
    extra : tuple of ndarray
        Frequencies [rad/s] to add to the grid of every model.
    thin : bool
        Leave out most of the frequencies at which all gains are small.
    near_limit : bool
        A point was outside for its stability: the steps are to know the limit from the first one on.
    """

    planes, steps, slow = PLANES, STEPS, SLOW

    def __init__(
        self,
        problem: Problem,
        x: FloatArray,
        evaluation: Evaluation,
        extra: tuple[FloatArray, ...] | None = None,
        *,
        thin: bool = False,
        near_limit: bool = False,
    ) -> None:
        self._problem = problem
        self.limit_watch = LimitWatch(problem, evaluation, near_limit)
        self.power = 40.0
        self.evaluations = 0
        self._last: tuple[FloatArray, tuple[float, float]] | None = None
        self._multiplier, self._penalty, self._restoring, self._offset = 0.0, PENALTY, False, 0.0
        self._ceiling = float(np.log(max(worst_values(problem, evaluation)[1], 1.0))) + HARD_MARGIN
        K = problem.structure.gain_matrix(x)
        self._has_poles = any(i not in problem.gain_numbers for i in range(len(problem.requirements)))
        self._hinf = tuple(range(len(problem.hinf)))
        self._h2 = tuple(range(len(problem.hinf), len(problem.gain_numbers)))
        self.extra: list[FloatArray] = []
        self._grids = [
            self._grid(k, evaluation, extra[k] if extra else np.zeros(0)) for k in range(len(problem.models))
        ]
        self._h2_models = [0] if same_h2(problem, evaluation) else list(range(len(self._grids)))
        if thin:
            self._grids = [self._thinned(k, K) for k in range(len(self._grids))]
        for k in self._h2_models:
            _, norms = self._grids[k].gains(K)
            for i, norm in norms.items():
                exact = evaluation.values[problem.gain_numbers[i], k]
                self._grids[k].calibration[i] = float(exact / norm) if norm > 0.0 else 1.0
        limits = [float(p.real.max(initial=-np.inf)) + problem.min_decay for p in evaluation.poles]
        self._limits = [APPROACH * limit - problem.min_decay for limit in limits]
        self._reference = [None if self._small(k) else grid.return_determinant(K) for k, grid in enumerate(self._grids)]

    def _grid(self, k: int, evaluation: Evaluation, more: FloatArray) -> GridGains:
        loop = self._problem.gains[k]
        peaks = (
            np.unique(evaluation.peak_frequencies[list(self._problem.hinf), k]) if self._problem.hinf else np.zeros(0)
        )
        extra = np.concatenate([unresolved(loop.grid.omega, evaluation.poles[k]), peaks[np.isfinite(peaks)], more])
        extra = np.setdiff1d(extra, loop.grid.omega)
        self.extra.append(extra)
        arrays = loop.grid.merged(loop.plant.arrays(extra)) if len(extra) else loop.grid
        return GridGains(loop.plant, arrays, self._problem.structure.order, self._hinf, self._h2)

    def _thinned(self, k: int, K: FloatArray) -> GridGains:
        grid = self._grids[k]
        kept = grid.essential(K, h2=k in self._h2_models) | np.isin(grid.arrays.omega, self.extra[k])
        arrays = grid.arrays.at(np.flatnonzero(kept))
        return GridGains(grid.plant, arrays, grid.order, grid.hinf, grid.h2)

    def _small(self, k: int) -> bool:
        return self._problem.order(k) <= EXACT_STABILITY_ORDER

    def stable(self, x: FloatArray) -> bool:
        """All models stable with a part of the first point's margin left.

        By the poles of small loops; for large ones by the return difference on the grid, which shows no encirclement.
        Where it cannot tell, because it turns fast or nearly vanishes at a frequency, the poles decide.
        """
        if not self._problem.inside(x):
            return False
        K = self._problem.structure.gain_matrix(x)
        for k, grid in enumerate(self._grids):
            reference = self._reference[k]
            if reference is None:
                if self._problem.abscissa_of(k, K) >= self._limits[k]:
                    return False
                continue
            ratio = grid.return_determinant(K) / reference
            turns = np.diff(np.angle(ratio))
            turns -= 2.0 * np.pi * np.round(turns / (2.0 * np.pi))
            total = abs(float(turns.sum()))
            near = float(np.abs(ratio).min()) < LEAST_RETURN or np.abs(turns).max(initial=0.0) > LARGEST_TURN
            if near or LARGEST_TOTAL < total <= np.pi:
                if self._problem.abscissa_of(k, K) >= -self._problem.min_decay:
                    return False
            elif total > np.pi:
                return False
        return True

    def begin(
        self,
        x: FloatArray,
        *,
        power: float,
        multiplier: float = 0.0,
        penalty: float = PENALTY,
        restoring: bool = False,
    ) -> None:
        """Begin a round at `x` (size,): with `restoring` the value is h alone, otherwise the augmented Lagrangian.

        The p-norm of the hard values is scaled to their largest value at `x`.
        """
        self.power, self._multiplier, self._penalty, self._restoring = power, multiplier, penalty, restoring
        K = self._problem.structure.gain_matrix(x)
        _, hard = self._split(self._entries(x, K, power))
        if hard and power < np.inf:
            largest = self._split(self._entries(x, K, np.inf))[1]
            self._offset = self._log_norm(x, K, hard)[0] - _log_of_largest(largest)

    def _split(self, entries: Sequence[_Entry]) -> tuple[list[_Entry], list[_Entry]]:
        """Soft and hard ones."""
        hard = [self._problem.requirements[e.requirement].hard for e in entries]
        return [e for e, h in zip(entries, hard) if not h], [e for e, h in zip(entries, hard) if h]

    def __call__(self, x: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient (size,); infinite and zero outside the domain."""
        self.evaluations += 1
        value, gradient = 0.0, np.asarray(np.zeros(len(x)), dtype=float)
        if not self.stable(x):
            return np.inf, gradient
        K = self._problem.structure.gain_matrix(x)
        soft, hard = self._split(self._entries(x, K, self.power))
        if hard and _log_of_largest(hard) > self._ceiling:
            return np.inf, gradient
        if soft and not self._restoring:
            value, gradient = self._log_norm(x, K, soft)
        if hard:
            excess, slope = self._log_norm(x, K, hard)
            excess -= self._offset
            if self._restoring:
                return excess, slope
            shifted = excess + 0.5 * self._multiplier / self._penalty
            if shifted > 0.0:
                value = value + self._penalty * shifted**2
                gradient = gradient + 2.0 * self._penalty * shifted * slope
        return value, gradient

    def largest(self, x: FloatArray) -> tuple[float, float]:
        """Logarithms of the largest soft and of the largest hard value on the grid; infinite where unstable."""
        if self._last is None or self._last[0] is not x:
            self.evaluations += 1
            self._last = x, self._largest(x)
        return self._last[1]

    def _largest(self, x: FloatArray) -> tuple[float, float]:
        if not self.stable(x):
            return np.inf, np.inf
        soft, hard = self._split(self._entries(x, self._problem.structure.gain_matrix(x), np.inf))
        return _log_of_largest(soft), _log_of_largest(hard)

    def at(self, x: FloatArray) -> GridModel:
        """Linearised at the stable point `x` (size,)."""
        return GridModel(self, x)

    def _entries(self, x: FloatArray, K: FloatArray, power: float) -> list[_Entry]:
        entries = []
        for k, grid in enumerate(self._grids):
            gains, norms = grid.gains(K, power=power, h2=k in self._h2_models)
            entries += [_Entry(self._problem.gain_numbers[i], k, v) for i, v in gains.items()]
            entries += [_Entry(self._problem.gain_numbers[i], k, np.array([v])) for i, v in norms.items()]
        if self._has_poles:
            for piece in self._problem.pole_pieces(x, K):
                entries.append(_Entry(piece.requirement, piece.model, np.array([piece.value]), (piece.gradient,)))
        return entries

    def _log_norm(self, x: FloatArray, K: FloatArray, entries: Sequence[_Entry]) -> tuple[float, FloatArray]:
        p, structure = self.power, self._problem.structure
        logs = [np.log(np.maximum(e.values, 1e-300)) for e in entries]
        top = max(float(v.max(initial=-np.inf)) for v in logs)
        if top <= LEAST_LOG:  # all values are zero, as that of the command without any gain is
            return LEAST_LOG, np.zeros(len(x))
        total = sum(float(np.sum(np.exp(p * (v - top)))) for v in logs)
        gradient = np.zeros(len(x))
        for entry, v in zip(entries, logs):
            index = np.flatnonzero(p * (v - top) > -NEGLIGIBLE)
            if len(index) == 0:
                continue
            weights = np.exp(p * (v[index] - top)) / total / entry.values[index]
            if entry.gradients:
                gradient += weights[0] * entry.gradients[0]
                continue
            grid, i = self._grids[entry.model], self._problem.gain_numbers.index(entry.requirement)
            if i in self._h2:
                slope = weights[0] * grid.h2_gradient(K, i)
            else:
                slope = grid.weighted_gradient(K, i, weights, index, p)
            gradient += structure.pullback(x, slope)
        return top + np.log(total) / p, gradient

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Logarithms (m,) near the largest soft one or near the limit, gradients (m, size), which of them are hard."""
        self.evaluations += 1
        structure = self._problem.structure
        K = structure.gain_matrix(x)
        entries = self._entries(x, K, np.inf)
        J = jacobian(structure, x)
        soft = _log_of_largest(self._split(entries)[0])
        values: list[FloatArray] = []
        gradients: list[FloatArray] = []
        hard: list[BoolArray] = []
        for e in entries:
            is_limit = self._problem.requirements[e.requirement].hard
            level = float(np.log(HARD_TARGET)) if is_limit else 0.0
            least = (level if is_limit else soft) + LEAST_NEAR
            logs = np.log(np.maximum(e.values, 1e-300))
            index = np.flatnonzero(logs > least)
            index = index[np.argsort(-logs[index], kind="stable")[:MAX_NEAR]]
            if len(index) == 0:
                continue
            if e.gradients:
                s, G = e.values[index], np.array(e.gradients)
            else:
                grid, i = self._grids[e.model], self._problem.gain_numbers.index(e.requirement)
                if i in self._h2:
                    s, G = e.values[index], (grid.h2_gradient(K, i).ravel() @ J)[None]
                else:
                    s, slopes = grid.slopes(K, i, index)
                    kept = s > np.exp(least)
                    s, G = s[kept], slopes[kept].reshape(-1, K.size) @ J
            values.append(np.log(np.maximum(s, 1e-300)) - level)
            gradients.append(G / s[:, None])
            hard.append(np.full(len(s), is_limit))
        return np.concatenate(values), np.concatenate(gradients), np.concatenate(hard)

    def gauss_newton(self, x: FloatArray) -> FloatArray:
        """Gauss-Newton matrix at `x`, with a share of the size of the controller's own entries (size, size)."""
        structure = self._problem.structure
        K = structure.gain_matrix(x)
        J = jacobian(structure, x)
        total = self._gauss_newton(x, K, self._entries(x, K, np.inf), J)
        diagonal = RIDGE * np.diag(total) + max(RIDGE**3 * float(np.diag(total).max()), 1e-200)
        return np.asarray(
            total + np.diag(diagonal) + PROPORTION * (J.T / gain_sizes(K, structure.order).ravel() ** 2) @ J
        )

    def metric(self, x: FloatArray, floor: float = EIGENVALUE_FLOOR) -> Metric:
        """Gauss-Newton metric at `x`: relative size of the change of all responses, weighted by their gains.

        Directions that change next to nothing get at most the length ``1 / sqrt(floor)``. The identity where a response
        is infinite, which is so for a pole of the loop at a frequency of the grid.
        """
        structure = self._problem.structure
        K = structure.gain_matrix(x)
        entries = self._entries(x, K, self.power)
        if not all(np.all(np.isfinite(entry.values)) for entry in entries):
            return Metric(np.eye(len(x)), np.eye(len(x)))
        J = jacobian(structure, x)
        total = self._gauss_newton(x, K, entries, J) + self._spread_of_slopes(x, K, entries)
        hard = self._split(entries)[1]
        if hard and not self._restoring:
            excess, slope = self._log_norm(x, K, hard)
            if excess - self._offset + 0.5 * self._multiplier / self._penalty > 0.0:
                total = total + 2.0 * self._penalty * np.outer(slope, slope)
        return metric_of(total, floor)

    def _gauss_newton(self, x: FloatArray, K: FloatArray, entries: Sequence[_Entry], J: FloatArray) -> FloatArray:
        """Squared relative size of the change of all responses, weighted by their gains.

        Soft values are weighed against the largest soft one, hard ones against the largest hard one, or against 1.
        """
        soft, hard = self._split(entries)
        largest = {
            False: max((float(e.values.max()) for e in soft), default=0.0),
            True: max([1.0, *(float(e.values.max()) for e in hard)]),
        }
        matrix = np.zeros((K.size, K.size))
        poles = np.zeros((len(x), len(x)))
        for entry in entries:
            size = float(entry.values.max())
            top = largest[self._problem.requirements[entry.requirement].hard]
            if not size > 1e-3 * top:
                continue
            if entry.gradients:
                poles += np.outer(entry.gradients[0], entry.gradients[0]) / max(size, 1e-3 * top) ** 2
                continue
            grid, i = self._grids[entry.model], self._problem.gain_numbers.index(entry.requirement)
            if i in self._h2:
                weights = grid.widths / np.pi * grid.calibration.get(i, 1.0) ** 2 / size**2
                weights = weights * (size / top) ** METRIC_POWER
            else:
                relative = entry.values / top
                weights = np.where(relative > 1e-3, relative**METRIC_POWER, 0.0)
                weights = weights / weights.sum() / size**2 * (size / top) ** METRIC_POWER
            matrix += grid.gauss_newton(K, i, weights).reshape(K.size, K.size)
        return np.asarray(J.T @ matrix @ J + poles)

    def _spread_of_slopes(self, x: FloatArray, K: FloatArray, entries: Sequence[_Entry]) -> FloatArray:
        """Curvature of the p-norm from the relative slopes that it averages: ``p sum_e w_e g_e g_e'``."""
        p = self.power
        total: FloatArray = np.zeros((len(x), len(x)))
        for hard in (False, True):
            of_kind = [e for e in entries if self._problem.requirements[e.requirement].hard is hard]
            if not of_kind:
                continue
            top = _log_of_largest(of_kind)
            if top <= LEAST_LOG:
                continue
            weights = [np.exp(p * (np.log(np.maximum(e.values, 1e-300)) - top)) for e in of_kind]
            sum_of_weights = sum(float(w.sum()) for w in weights)
            mean, share = np.zeros(len(x)), 0.0
            for e, w in zip(of_kind, weights):
                index = np.argsort(-w)[:MAX_SLOPES]
                index = index[w[index] > 1e-4 * sum_of_weights]
                if len(index) == 0:
                    continue
                parts = w[index] / sum_of_weights
                G = self._relative_slopes(x, K, e, index)
                mean, share = mean + G.T @ parts, share + float(parts.sum())
                total = total + p * np.asarray((G.T * parts) @ G, dtype=float)
            total = total - p * np.outer(mean, mean) / share
        return total

    def _relative_slopes(self, x: FloatArray, K: FloatArray, e: _Entry, index: IntArray) -> FloatArray:
        if e.gradients:
            return np.asarray(e.gradients[0][None] / e.values[0])
        grid, i = self._grids[e.model], self._problem.gain_numbers.index(e.requirement)
        if i in self._h2:
            slopes = [grid.h2_gradient(K, i)]
        else:
            slopes = [g for _, g in grid.peak_gradients(K, i, index)]
        pulled = [self._problem.structure.pullback(x, g) / e.values[j] for j, g in zip(index, slopes)]
        return np.asarray(np.array(pulled), dtype=float)


def _log_of_largest(entries: Sequence[_Entry]) -> float:
    return max([LEAST_LOG, *(float(np.log(max(float(e.values.max()), 1e-300))) for e in entries)])


def same_h2(problem: Problem, evaluation: Evaluation) -> bool:
    """Whether every H2 norm is the same at all models."""
    values = evaluation.values[list(problem.h2)]
    if values.size == 0:
        return True
    return bool(np.all(np.ptp(values, axis=1) <= SAME_H2 * np.abs(values).max(axis=1)))
