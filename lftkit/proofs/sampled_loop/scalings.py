"""Scalings of one box of the parameters at one frequency, by Newton steps, and what to bisect where there are none."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.proofs.blocks.structure import balanced
from lftkit.proofs.sampled_loop.model import SearchedResponses, from_middle
from lftkit.proofs.sampled_loop.settings import SETTINGS, LoopSettings
from lftkit.proofs.state_space.barrier import ANY_REAL, COMPLEX, FULL, REAL, BarrierBlock, newton_step
from lftkit.proofs.state_space.scaling_search import barrier_problem, newton_path
from lftkit.proofs.trusted.proof import Interval
from lftkit.proofs.trusted.strips import is_circle

Box = tuple[Interval, ...]


@dataclass(frozen=True)
class NodeScalings:
    """Scalings at a frequency as a strip has them: D and G of each parameter, factor of the gain's inequality."""

    omega: float
    D: tuple[ComplexArray, ...]
    G: tuple[ComplexArray, ...]
    factor: float


class ScalingTest:
    """Test whether the gain at a frequency is below a level in a whole box.

    Parameters
    ----------
    model : SearchedResponses
    box : sequence of (low, high)
    omega : float
        Frequency [rad/s], positive.
    level : float
    static : bool
        D alone. Near frequency zero, where all responses are real, G is of no use and its centre is far out.
    settings : LoopSettings
    """

    def __init__(
        self,
        model: SearchedResponses,
        box: Sequence[Interval],
        omega: float,
        level: float,
        static: bool = False,
        settings: LoopSettings = SETTINGS,
    ) -> None:
        self.model, self.omega, self.settings = model, omega, settings
        self.groups = list(map(list, model.groups))
        q, d = model.sizes[0], model.sizes[3]
        z, e = model.at(omega)
        box = [_opened(ends, z[np.ix_(group, group)], settings.fixed) for ends, group in zip(box, self.groups)]
        inner, w = from_middle(model, box, z)
        out = e[:, :q] @ w
        out[:, q:] += e[:, q:]
        weight, amplitude = model.amplitudes(omega)
        maps = np.vstack([inner, out * (weight / level)])
        maps[:, q:] *= amplitude
        self.scale = self._scale(maps)
        maps = maps / np.concatenate([self.scale[:q], np.full(d, self.scale[q])])
        maps[:q] *= self.scale[:q, None]
        maps[q:] *= self.scale[q]
        inputs = np.eye(q + d, dtype=complex)
        self.factors = [_factors(angle, *ends) for angle, ends in zip(model.angle, box)]
        real = [
            ANY_REAL if angle and is_circle(*ends) else COMPLEX if static else REAL
            for angle, ends in zip(model.angle, box)
        ]
        self.kinds = [of_real if kind == REAL else kind for kind, of_real in zip(model.kinds, real)]
        blocks = [BarrierBlock(kind, maps[group], inputs[group]) for kind, group in zip(self.kinds, self.groups)]
        self.gain = d > 0
        if self.gain:
            blocks.append(BarrierBlock(FULL, maps[q:], inputs[q:]))
        self.problem = barrier_problem(blocks, settings.penalty)

    def _scale(self, maps: ComplexArray) -> FloatArray:
        """Scales of the channels, and that of the gain last, that balance the maps; those of a matrix are equal."""
        if FULL not in self.model.kinds:
            return balanced(maps, self.model.sizes[0])
        units = [[i] for g, kind in zip(self.groups, self.model.kinds) if kind != FULL for i in g]
        units += [g for g, kind in zip(self.groups, self.model.kinds) if kind == FULL]
        q = self.model.sizes[0]
        member = np.zeros((q, len(units)))
        for number, unit in enumerate(units):
            member[unit, number] = 1.0
        power = np.abs(maps) ** 2
        inner = np.hstack([member.T @ power[:q, :q] @ member, member.T @ power[:q, q:]])
        outer = np.hstack([power[q:, :q] @ member, power[q:, q:]])
        scale = balanced(np.sqrt(np.vstack([inner, outer])), len(units))
        return np.concatenate([member @ scale[:-1], scale[-1:]])

    def scalings(self, y: FloatArray) -> NodeScalings:
        """Scalings of the problem's variables."""
        D, G = [], []
        for k, group in enumerate(self.groups):
            d, g = self.problem.matrices(y, k)
            if self.kinds[k] == FULL:
                d, g = (part[0, 0] * np.eye(len(group)) for part in (d, g))
            size = np.outer(self.scale[group], self.scale[group])
            square, single = self.factors[k]
            D.append(self._rounded(size * d / square))
            G.append(self._rounded(size * g / single))
        factor = 1.0
        if self.gain:
            factor = float(self.problem.matrices(y, len(self.groups))[0][0, 0].real) * float(self.scale[-1]) ** 2
        return NodeScalings(self.omega, tuple(D), tuple(G), factor)

    def _rounded(self, matrix: ComplexArray) -> ComplexArray:
        """Hermitian part in single precision: files are half as large, and what is stored is what is checked.

        In double precision where single precision has no such numbers.
        """
        low, high = self.settings.single
        half = 0.5 * (matrix + matrix.conj().T)
        size = float(np.abs(half).max(initial=0.0))
        return np.asarray(half.astype(np.complex64) if low < size < high else half, dtype=complex)

    def variables(self, scalings: NodeScalings) -> FloatArray:
        """The problem's variables of scalings of a neighbouring frequency."""
        D, G = [], []
        for k, group in enumerate(self.groups):
            size = np.outer(self.scale[group], self.scale[group])
            square, single = self.factors[k]
            part = slice(0, 1 if self.kinds[k] == FULL else None)
            D.append((scalings.D[k] * square / size)[part, part])
            G.append((scalings.G[k] * single / size)[part, part])
        if self.gain:
            D.append(np.array([[scalings.factor / self.scale[-1] ** 2]], dtype=complex))
            G.append(np.zeros((1, 1), complex))
        return self.problem.variables(D, G)

    def allowed(self, y: FloatArray) -> bool:
        """Whether variables prove the level at this frequency, but for rounding."""
        return bool(np.isfinite(self.problem.value(y, 0.0)))

    def feasible(self, before: FloatArray | None = None) -> tuple[FloatArray | None, FloatArray]:
        """Variables that prove the level, None if there are none; the variables reached. Begins at those `before`."""
        problem, settings = self.problem, self.settings
        y = start = problem.start() if before is None else problem.raised(before, 1e-9)
        steps = newton_path(problem, start, settings.newton_steps, growth=settings.growth, centred=settings.centred)
        for y, gap, centre in steps:
            if y[0] < 0.0:
                proving = y.copy()
                proving[0] = 0.0
                return proving, proving
            if centre and (y[0] - 2.0 * gap > 0.0 or gap < settings.precision):
                break
        return None, y

    def centred(self, y: FloatArray, steps: int) -> FloatArray:
        """Towards the analytic centre of all variables that prove the level; it holds for a wider band."""
        for _ in range(steps):
            slope, curvature = self.problem.derivatives(y, 0.0)
            step = np.zeros_like(y)
            step[1:] = newton_step(curvature[1:, 1:], -slope[1:], self.problem.trace[1:])
            decrement = math.sqrt(max(float(-slope @ step), 0.0))
            y = self.problem.line_search(y, step, 0.0, decrement)
            if decrement < self.settings.centred:
                break
        return y

    def losses(self, y: FloatArray) -> FloatArray:
        """Loss of margin by the interval of each parameter: the largest is the one to bisect. None of a disk is."""
        losses = self.problem.result(y).losses[: len(self.groups)]
        return np.where([kind == REAL for kind in self.model.kinds], losses, -np.inf)


def _opened(ends: Interval, scaling: ComplexArray, fixed: float) -> Interval:
    """The interval of a parameter, and a narrow one about a parameter that is fixed, whose D would be infinite.

    `scaling`: from its channels to themselves. Scalings for a wider interval hold for the fixed value.
    """
    if ends[1] > ends[0]:
        return ends
    half = fixed / max(float(np.abs(scaling).sum(axis=1).max(initial=0.0)), 10.0 * fixed)
    return ends[0] - half, ends[1] + half


def _factors(angle: bool, low: float, high: float) -> tuple[float, float]:
    """Divisors of D and G from ``z'* D z' - w'* D w' + Re z'* j G w'`` to the forms of a strip."""
    half = 0.5 * (high - low)
    if not angle:
        return 2.0 * half**2, 2.0 * half
    if is_circle(low, high):
        return 1.0, 2.0
    return 2.0 * math.sin(0.5 * half) ** 2, 2.0 * math.tan(0.5 * half)


@dataclass
class Branching:
    """Choice of parameters to bisect in the boxes of one proof.

    The loss of a parameter, ``trace(D z S z*)``, says where the scalings spend their margin, not what a smaller
    interval would gain. The parameters with the largest losses may be some whose bisection, even six times over, does
    not lower the bound, while small intervals of another one do. So the gain is measured: the level that can be proven
    with a parameter held near its lower end, its middle and its upper end, against that of the whole box.

    Parameters
    ----------
    model : SearchedResponses
    level : float
        To be proven.
    until : float
        ``time.monotonic()`` after which nothing is measured.
    settings : LoopSettings
    """

    model: SearchedResponses
    level: float
    until: float = math.inf
    known: list[tuple[Box, float, FloatArray | None]] = field(default_factory=list)
    settings: LoopSettings = SETTINGS

    def axis(self, box: Box, root: Box, omega: float, losses: FloatArray) -> int | None:
        """Parameter to bisect; None where all elements are disks, which are whole.

        Parameters
        ----------
        box : Box
            Of which nothing was proven at the frequency.
        root : Box
            A box that has it as a part, in which the gains are measured.
        omega : float
            Frequency [rad/s].
        losses : ndarray
            Of the parameters, which decide where holding one of them gains nothing in `root`.
        """
        real = np.array([kind == REAL for kind in self.model.kinds])
        if not np.any(real):
            return None
        gains = self._gains(root, omega)
        if gains is None or not np.any(gains):
            # Losses, for a whole circle of an angle (which has no D, so no loss) half of the largest
            losses = np.array(losses)
            for k, ends in enumerate(box):
                if losses[k] == 0.0 and is_circle(*ends):
                    losses[k] = 0.5 * float(np.max(losses))
            return int(np.argmax(losses))
        left = [(b - a) / (high - low) if high > low else 0.0 for (a, b), (low, high) in zip(box, root)]
        return int(np.argmax(np.where(real, (gains + self.settings.small) * left, -np.inf)))

    def _gains(self, root: Box, omega: float) -> FloatArray | None:
        """Levels gained by holding each parameter; None where none can be proven of the box."""
        for box, at, gains in self.known:
            if box == root and abs(omega - at) <= self.settings.near * at:
                return gains
        gains = self._measured(root, omega)
        self.known.append((root, omega, gains))
        return gains

    def _measured(self, root: Box, omega: float) -> FloatArray | None:
        settings = self.settings
        whole = self._least(root, omega, settings.above)
        if whole is None:
            return None
        gains = np.zeros(len(root))
        for axis, (low, high) in enumerate(root):
            if self.model.kinds[axis] != REAL:
                continue
            worst = -settings.below
            for point in settings.points if high > low else ():
                at, width = low + point * (high - low), settings.held * (high - low)
                held = *root[:axis], (max(low, at - width), min(high, at + width)), *root[axis + 1 :]
                least = self._least(held, omega, whole - 1)
                worst = whole if least is None else max(worst, least)
                if worst == whole:
                    break
            gains[axis] = whole - worst if high > low else 0.0
        return gains

    def _least(self, box: Box, omega: float, most: int) -> int | None:
        """Number of the least level that is proven, at most `most`; None where that isn't."""
        if not self._holds(box, omega, most):
            return None
        least, no = most, -self.settings.below - 1
        while least - no > 1:
            middle = (least + no) // 2
            if self._holds(box, omega, middle):
                least = middle
            else:
                no = middle
        return least

    def _holds(self, box: Box, omega: float, number: int) -> bool:
        if time.monotonic() > self.until:
            return False
        level = self.level * math.pow(self.settings.ratio, number)
        return ScalingTest(self.model, box, omega, level, settings=self.settings).feasible()[0] is not None
