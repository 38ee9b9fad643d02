"""Numbers of the synthesis of full-order controllers."""

from __future__ import annotations

from dataclasses import dataclass

from lftkit.support.settings import AlgorithmSettings


@dataclass(frozen=True)
class SynthesisSettings(AlgorithmSettings):
    """Numbers of the H-infinity, H2 and loop shaping synthesis.

    Attributes
    ----------
    regularised : weights of commands and noises of measurements that are tried where an assumption of the equations
        fails: alone, and with the same weight and noise of every state, which zeros on the imaginary axis need
    above : levels of controllers over the lowest one, rising: nearer to it their poles are faster
    near : relative distance of a value from its bound at which no other bound is looked for
    least : part of a value below which a bound says nothing: the infimum is zero but for rounding
    reached : relative distance of the norm of a loop above its level that counts as rounding

    decades : decades that are looked through for a level, to both sides of 1
    bisections : bisections of one of them
    shares : parts of the static gain that are tried until its loop with D22 is well posed
    well_posed : least ratio of the singular values of that loop

    rank : smallest singular value of D12 and D21, relative to the largest one or to 1, that counts as rank
    axis : real part of a mode, relative to the norm of A, above which it must be reached and seen
    unreached : smallest singular value of the Popov, Belevitch and Hautus matrix, rows of size 1, of a mode that is not
        reached

    rounds : units of states follow from those of signals, and these from those of states where D12 or D21 is zero: so
        often
    rounding : part of the gain of the plant without a controller that its rounding may make out of reach
    pole : distance of a point from the poles, over the norm of A
    zero : gain at a zero, relative to that on the axis beside it; distance of zeros from the axis, relative to their
        size
    """

    regularised: tuple[float, ...] = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
    above: tuple[float, ...] = (1.00002, 1.00005, 1.0001, 1.0002, 1.0005, 1.001, 1.002, 1.02, 1.1)
    near: float = 1e-3
    least: float = 1e-6
    reached: float = 1e-6

    decades: int = 12
    bisections: int = 20
    shares: tuple[float, ...] = (1.0, 0.0, 0.5, 0.9, 0.99, 0.999)
    well_posed: float = 1e-6

    rank: float = 1e-9
    axis: float = 1e-11
    unreached: float = 1e-10

    rounds: int = 4
    rounding: float = 1e-11
    pole: float = 1e-5
    zero: float = 1e-6


SETTINGS = SynthesisSettings()
