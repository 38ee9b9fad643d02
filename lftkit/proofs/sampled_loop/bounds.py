"""Proof that the gain of a sampled loop is below a level, over a box of parameters and a band of frequencies.

From one end of a band to the other: scalings are centred at one frequency and at the next one, and the inequality
between the two nodes is checked with the checker's own code; steps adapt. Analytic centres change smoothly with the
frequency, so that far apart nodes can be interpolated. Where no scalings exist, or steps get too short, the box is
bisected for a short part of the band.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lftkit.analysis.batched_linalg import largest_gains, solve
from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.proofs.sampled_loop.model import SearchedResponses
from lftkit.proofs.sampled_loop.scalings import Branching, NodeScalings, ScalingTest
from lftkit.proofs.sampled_loop.settings import SETTINGS, LoopSettings
from lftkit.proofs.trusted.proof import REAL, Interval, Strip
from lftkit.proofs.trusted.sampled_loop import require_box
from lftkit.proofs.trusted.strips import windows_of
from lftkit.support.scalars import as_positive
from lftkit.support.threads import one_thread

Box = tuple[Interval, ...]


@dataclass(frozen=True)
class BisectionOptions:
    """Bisection of a box where scalings do not prove a level.

    Parameters
    ----------
    part : float
        Part of the band, relative to its frequency, for which the box is bisected.
    deepest : int
        Most bisections of the box, but for frequencies near zero; what is left then is not covered.
    samples : int
        Members that are looked at where the box is bisected.
    seed : int
        Of these members.
    renewed : int
        Bisections after which the parameters' gains are measured anew, in the box that is left.
    settings : LoopSettings
        Numbers of the steps over the band, of the scalings and of the choice of what to bisect.
    """

    part: float = 0.01
    deepest: int = 14
    samples: int = 64
    seed: int = 0
    renewed: int = 8
    settings: LoopSettings = SETTINGS

    def __post_init__(self) -> None:
        as_positive(self.part, "part")
        if self.deepest < 0 or self.samples < 1:
            raise InputError(f"deepest must be at least 0 and samples 1, got {self.deepest} and {self.samples}")


@dataclass
class LoopBounds:
    """Outcome of a proof.

    Parameters
    ----------
    strips : list of Strip
        What is proven.
    uncovered : list of (box, band)
        What is not.
    lower : float
        Largest gain met on the way, over the limit; a gain above the level is a counterexample.
    point : ndarray or None
        Deviations from the nominal values there (angles in rad).
    omega : float
        Frequency there [rad/s].
    nodes, windows : int
        Work done: scalings looked for, and windows checked.
    seconds : float
        Processor time.
    """

    strips: list[Strip] = field(default_factory=list)
    uncovered: list[tuple[Box, Interval]] = field(default_factory=list)
    lower: float = 0.0
    point: FloatArray | None = None
    omega: float = 0.0
    nodes: int = 0
    windows: int = 0
    seconds: float = 0.0


def prove_level(
    model: SearchedResponses,
    box: Sequence[Interval],
    band: Interval,
    level: float,
    *,
    until: float = math.inf,
    known: Sequence[Strip] = (),
    options: BisectionOptions | None = None,
    part: bool = False,
) -> LoopBounds:
    """Prove that the gain over the limit is below `level` for all members of a box and all frequencies of a band.

    Parameters
    ----------
    model : SearchedResponses
    box : sequence of (low, high)
        Deviations from the nominal values; of an angle theta [rad].
    band : (low, high)
        Frequencies [rad/s], ``0 <= low < high <= pi / dt``.
    level : float
    until : float
        ``time.monotonic()`` after which it stops; what is left is in `uncovered`.
    known : sequence of Strip
        Of a proof for another level that covers this box and band: what also holds for this level is kept.
    options : BisectionOptions, optional
    part : bool
        The box is a part of one that contains zero, the nominal member, and need not itself.

    Raises
    ------
    ValueError
        The box does not contain zero: a proof of it would be refused.
    """
    if not part:
        require_box(box)
    start, options = time.process_time(), options or BisectionOptions()
    branching = Branching(model, level, until, settings=options.settings)
    state = _State(model, level, until, options, np.random.default_rng(options.seed), LoopBounds(), branching)
    with one_thread():
        if known:
            for strip in known:
                state.prove_again(strip)
        else:
            state.prove(tuple(box), *band, 0)
    state.found.seconds = time.process_time() - start
    return state.found


@dataclass
class _State:
    model: SearchedResponses
    level: float
    until: float
    options: BisectionOptions
    rng: np.random.Generator
    found: LoopBounds
    branching: Branching

    @property
    def slow(self) -> float:
        """Frequency [rad/s] below which scalings are D alone."""
        return self.options.settings.slow * self.model.slowest

    @property
    def lowest(self) -> float:
        """Least frequency of scalings [rad/s]."""
        return self.options.settings.lowest * self.slow

    def _over(self, box: Box, low: float, high: float) -> bool:
        """Whether it ends here: time is up, or a member exceeds the level."""
        over = time.monotonic() > self.until or self.found.lower >= self.level
        if over:
            self.found.uncovered.append((box, (low, high)))
        return over

    def _prove_slow(self, box: Box, low: float, high: float, depth: int) -> None:
        """Prove a box from `low` to `high`, both slow."""
        if self._over(box, low, high):
            return
        wide = [k for k, (a, b) in enumerate(box) if self.model.angle[k] and b - a > self.options.settings.turn]
        reached, axis = low, wide[0] if wide else 0
        if not wide:
            reached, losses, _ = self._strip(box, low, high, self.level, static=True)
            axis = int(np.argmax(losses))
        if reached >= high:
            return
        if depth == self.options.settings.slow_deepest or self.model.kinds[axis] != REAL:
            self.found.uncovered.append((box, (reached, high)))
            return
        if not wide:
            self._look(box, reached, high)
        for half in _halves(box, axis):
            self._prove_slow(half, reached, high, depth + 1)

    def prove_again(self, strip: Strip) -> None:
        """Prove the box and band of a strip of another proof; the parts of it that hold are kept."""
        held = []
        for number in range(len(strip.nodes) - 1):
            if time.monotonic() > self.until:
                self.found.uncovered.append((strip.box, (float(strip.nodes[number]), float(strip.nodes[-1]))))
                break
            windows = windows_of(self.model, strip, number, self.level, self.options.settings.bisections)
            self.found.windows += windows
            held.append(windows > 0)
        number = 0
        for holds, run in itertools.groupby(held):
            end = number + len(list(run))
            if holds:
                part = slice(number, end + 1)
                D, G = (tuple(values[part] for values in each) for each in (strip.D, strip.G))
                self.found.strips.append(Strip(strip.box, strip.nodes[part], D, G, strip.factor[part]))
            else:
                self.prove(strip.box, float(strip.nodes[number]), float(strip.nodes[end]), 0)
            number = end

    def prove(self, box: Box, low: float, high: float, depth: int, root: Box | None = None) -> None:
        """Prove a box, a part of `root`, from `low` to `high`; what can't be proven goes to `uncovered`."""
        root = box if root is None or depth == self.options.renewed else root
        at = low
        if at < self.slow:
            at = min(high, self.slow)
            self._prove_slow(box, low, at, depth)
        while at < high:
            if self._over(box, at, high):
                return
            for aim in self.options.settings.aims:
                reached, losses, closed = self._strip(box, at, high, aim * self.level)
                if reached > at or not closed:
                    break
            if reached >= high:
                return
            end = min(high, reached * (1.0 + self.options.part))
            axis = self.branching.axis(box, root, reached, losses) if depth < self.options.deepest else None
            if axis is None:
                self.found.uncovered.append((box, (reached, end)))
            else:
                self._look(box, reached, end)
                for half in _halves(box, axis):
                    self.prove(half, reached, end, depth + 1, root)
            at = end

    def _strip(
        self, box: Box, low: float, high: float, aim: float, static: bool = False
    ) -> tuple[float, FloatArray, bool]:
        """A strip from `low` as far as steps go, its scalings centred for the level `aim`.

        Returns the frequency reached, the losses of the parameters there and whether there are scalings at `low`.
        """
        settings = self.options.settings
        first = ScalingTest(self.model, box, max(low, self.lowest), aim, static, settings)
        node, y = self._centre(first, [])
        losses = first.losses(y)
        if node is None:
            return low, losses, False
        nodes = [replace(node, omega=low)]
        step = settings.slow_first if static else settings.first_step
        longest = settings.slow_longest if static else settings.longest
        while nodes[-1].omega < high and time.monotonic() <= self.until:
            omega = max(nodes[-1].omega, self.lowest) * (1.0 + step)
            omega = high if omega > high / (1.0 + 0.5 * step) else omega
            test = ScalingTest(self.model, box, omega, aim, static, settings)
            following, y = self._centre(test, nodes[-2:])
            windows = 0
            if following is not None:
                pair = strip_of(box, [nodes[-1], following])
                windows = windows_of(self.model, pair, 0, self.level, settings.bisections)
            if following is None or not windows:
                losses = test.losses(y)
                step *= settings.shorter
                if step < settings.shortest:
                    break
                continue
            self.found.windows += windows
            nodes.append(following)
            step = min(step * (1.7 if windows <= 2 else 1.2 if windows < 9 else 0.8), longest)
        if len(nodes) > 1:
            self.found.strips.append(strip_of(box, nodes))
        return nodes[-1].omega, losses, True

    def _centre(self, test: ScalingTest, before: Sequence[NodeScalings]) -> tuple[NodeScalings | None, FloatArray]:
        """Centred scalings at a frequency, None if there are none; the variables reached.

        At most two nodes before it say where to begin.
        """
        self.found.nodes += 1
        guesses = list(before[-1:])
        if len(before) > 1:
            guesses.insert(0, extrapolated(before[-2], before[-1], test.omega))
        for guess in guesses:
            y = test.variables(guess)
            if test.allowed(y):
                y = test.centred(y, self.options.settings.following)
                return test.scalings(y), y
        scalings, reached = test.feasible(test.variables(before[-1]) if before else None)
        if scalings is None:
            return None, reached
        y = test.centred(scalings, self.options.settings.centring)
        return test.scalings(y), y

    def _look(self, box: Box, low: float, high: float) -> None:
        """Gains of some members where scalings were not found."""
        if not self.model.sizes[3]:
            return
        omega = float(self.rng.uniform(max(low, self.lowest), high))
        ends = np.array(box)
        samples = self.options.samples
        points = self.rng.uniform(size=(samples, len(box)))
        points[: samples // 2] = np.round(points[: samples // 2])
        members = ends[:, 0] + points * (ends[:, 1] - ends[:, 0])
        gains = member_gains(self.model, omega, members)
        best = int(np.argmax(gains))
        if gains[best] > self.found.lower:
            self.found.lower, self.found.point, self.found.omega = float(gains[best]), members[best], omega


def member_gains(model: SearchedResponses, omega: float, members: FloatArray) -> FloatArray:
    """Gain over the limit of members (N, parameters) at a frequency."""
    q = model.sizes[0]
    z, e = model.at(omega)
    weight, amplitude = model.amplitudes(omega)
    # Delta = S C^-1, so that half a turn of an angle, whose tangent is infinite, is a member as others are
    S, C = np.zeros((len(members), q)), np.ones((len(members), q))
    for k, (group, angle) in enumerate(zip(model.groups, model.angle)):
        columns, values = list(group), members[:, k, None]
        S[:, columns] = np.sin(0.5 * values) if angle else values
        C[:, columns] = np.cos(0.5 * values) if angle else 1.0
    inner = C[:, None, :] * np.eye(q) - z[:, :q] * S[:, None, :]
    entered = solve(inner, np.broadcast_to(z[:, q:], (len(S), *z[:, q:].shape)))
    closed = e[:, q:] + (e[:, :q] * S[:, None, :]) @ entered
    return weight * largest_gains(closed * amplitude)


def extrapolated(first: NodeScalings, second: NodeScalings, omega: float) -> NodeScalings:
    """Scalings at a frequency from those at two lower ones."""
    share = (omega - second.omega) / (second.omega - first.omega)

    def beyond(a: tuple[ComplexArray, ...], b: tuple[ComplexArray, ...]) -> tuple[ComplexArray, ...]:
        return tuple(y + share * (y - x) for x, y in zip(a, b))

    factor = second.factor + share * (second.factor - first.factor)
    return NodeScalings(omega, beyond(first.D, second.D), beyond(first.G, second.G), factor)


def strip_of(box: Box, nodes: Sequence[NodeScalings]) -> Strip:
    """A strip of its nodes."""
    count = len(box)
    return Strip(
        box,
        np.array([node.omega for node in nodes]),
        tuple(np.stack([node.D[k] for node in nodes]) for k in range(count)),
        tuple(np.stack([node.G[k] for node in nodes]) for k in range(count)),
        np.array([node.factor for node in nodes]),
    )


def _halves(box: Box, axis: int) -> list[Box]:
    low, high = box[axis]
    at = 0.5 * (low + high)
    return [(*box[:axis], part, *box[axis + 1 :]) for part in ((low, at), (at, high))]
