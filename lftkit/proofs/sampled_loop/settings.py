"""Numbers of the proofs by scalings at frequencies."""

from __future__ import annotations

from dataclasses import dataclass

from lftkit.support.settings import AlgorithmSettings


@dataclass(frozen=True)
class LoopSettings(AlgorithmSettings):
    """Numbers of the steps over a band, of the scalings at a frequency and of the choice of what to bisect.

    Attributes
    ----------
    first_step, shortest, longest : relative steps of frequency: at the start of a strip, at least, at most
    shorter : factor of a step after one that failed
    centring : Newton steps to a centre, at most
    following : the same from the scalings of the frequency before
    bisections : bisections of a step in the check of a prover, at most
    aims : parts of the level for which scalings are centred, one after the other; where the gain is far below the
        level, the centre for the level itself is so far out that the inequality is lost in rounding; one for less
        proves the level too
    slow : part of the plant's slowest pole below which scalings are D alone and the whole band is bisected at once
    lowest : least frequency of scalings, as a part of the one before; below it the same ones are used
    turn : widest interval of an angle [rad] there; without G an angle is never any angle
    slow_first, slow_longest : relative steps of frequency there: at the start, at most
    slow_deepest : bisections of the box there, at most

    penalty : weight of G: its centre comes from 10^5 times the size of D to a thousand times, and rounding falls as
        much
    single : magnitudes between which scalings are rounded to single precision
    fixed : gain about its own loop that a fixed parameter is given
    precision : distance to the optimal margin at which a test without scalings is given up
    newton_steps : Newton steps to scalings, at most
    growth : factor by which the weight of the objective grows from one centre to the next
    centred : Newton decrement at which a point counts as centred

    held : part of its interval in which a parameter is held to measure what its bisection gains
    points : where it is held, as parts of the interval
    ratio : ratio of two levels that are told apart
    below, above : levels below and above the one to be proven
    near : part of a frequency within which measured gains are used again
    small : gain of a parameter that has none, in levels: it is bisected after the others
    """

    first_step: float = 3e-3
    shortest: float = 5e-5
    longest: float = 0.1
    shorter: float = 0.4
    centring: int = 40
    following: int = 8
    bisections: int = 5
    aims: tuple[float, ...] = (1.0, 0.1, 0.01)
    slow: float = 0.1
    lowest: float = 1e-3
    turn: float = 1.6
    slow_first: float = 1.0
    slow_longest: float = 2.0
    slow_deepest: int = 14

    penalty: float = 1e-3
    single: tuple[float, float] = (1e-37, 1e38)
    fixed: float = 1e-3
    precision: float = 1e-7
    newton_steps: int = 80
    growth: float = 8.0
    centred: float = 0.3

    held: float = 0.02
    points: tuple[float, ...] = (0.0, 0.5, 1.0)
    ratio: float = 1.06
    below: int = 6
    above: int = 12
    near: float = 0.05
    small: float = 1e-3


SETTINGS = LoopSettings()
