"""Numbers of the search for bounds and proofs of uncertain systems."""

from __future__ import annotations

from dataclasses import dataclass

from lftkit.support.settings import AlgorithmSettings


@dataclass(frozen=True)
class SearchSettings(AlgorithmSettings):
    """Numbers of the search for members with a large gain, and for unstable ones.

    Attributes
    ----------
    samples : random members among which the worst one is looked for, and half of the directions to unstable ones
    all_corners : parameters, at most, of which all corners are looked at; of more, corners are searched by derivatives
        of the poles
    more_corners : random corners that are looked at where there are more parameters
    climbs : members from which the gain is climbed there
    corner_steps : corners that the slopes lead to there, at most
    slopes : gains of the search by slopes there, at most
    random_corners : random corners to begin with there, beside those that the derivatives at the nominal member give
    pole_steps : corners that the derivatives of one pole lead to, at most
    flips : parameters that are turned over one after the other, at most
    corner_below : part of the smallest factor so far at which an unstable corner is looked for next
    ray_points : points of a ray from the nominal member at which poles are looked at
    precision : relative precision of the first factor on a ray with an unstable member

    grid : frequencies between a tenth of the slowest pole and ten times the fastest, beside those of the poles
    refined : best frequencies of the grid about which the axis is searched
    close : frequencies of the grid at which no element of less than one over this times the size asked for makes the
        loop singular are left out of the search; about others there may be one between the frequencies of the grid
    evaluations : steps of the search about a frequency
    near : least frequency above zero over that of the slowest pole, and that of the fastest over the largest finite one
    real_at_ends : phase [rad] that counts as zero at the ends of the axis, where dynamics are real
    gain_starts : members with which the search for a gain at a frequency begins: on the grid, at the best frequency
    singular_starts : vectors with which the search for a singular loop begins: over the axis, at the best frequency
    singular_steps : steps of a local search for it, likewise
    ascents : steps of an ascent, at most
    climbed : least relative increase that is worth another step
    short : shortest step of an ascent, as a part of the way to the point that the slopes name
    """

    samples: int = 20
    all_corners: int = 6
    more_corners: int = 64
    climbs: int = 4
    corner_steps: int = 10
    slopes: int = 80
    random_corners: int = 16
    pole_steps: int = 6
    flips: int = 12
    corner_below: float = 1.0 - 1e-4
    ray_points: int = 48
    precision: float = 1e-9

    grid: int = 30
    refined: int = 2
    close: float = 0.5
    evaluations: int = 12
    near: float = 1e-3
    real_at_ends: float = 1e-9
    gain_starts: tuple[int, int] = (2, 8)
    singular_starts: tuple[int, int] = (1, 4)
    singular_steps: tuple[int, int] = (40, 200)
    ascents: int = 40
    climbed: float = 1e-7
    short: float = 1e-3


@dataclass(frozen=True)
class CellSettings(AlgorithmSettings):
    """Numbers of the proofs by cells, and of the scalings of a cell.

    Attributes
    ----------
    narrow : smallest relative half width of an interval in the optimisation (a point is treated as this interval)
    no_scale : range, in the optimisation, of a parameter that has one value; in any unit it is without influence
    free : entries of G above which it has run away in a direction that costs nothing: where a parameter sees no state,
        or the states nothing, responses are real and their part of G has no effect
    penalty : penalty that then holds it
    wide : ratio of frequencies above which a band is bisected before the parameters
    deep : a parameter whose interval, as a part of its range, is this much narrower than the widest one counts less
    raised : factors of the level at which cells that are left over are tried
    growth : factor by which the weight of the objective grows from one centre to the next
    centred : Newton decrement at which a point counts as centred
    dense : entries of all forms, at most, with which they are kept as matrices
    small : largest product of the sizes of two blocks whose second derivatives are formed in one piece
    """

    narrow: float = 1e-7
    no_scale: float = 1e-20
    free: float = 1e6
    penalty: float = 1e-6
    wide: float = 4.0
    deep: float = 16.0
    raised: tuple[float, ...] = (1.25, 2.0, 5.0, 20.0, 1000.0)
    growth: float = 8.0
    centred: float = 0.3
    dense: int = 20_000
    small: int = 64


@dataclass(frozen=True)
class BoundSettings(AlgorithmSettings):
    """Numbers of the bounds: which levels and factors are tried, for how long, and by which method.

    Attributes
    ----------
    few_states : states up to which a cell has scalings of the states; for more, scalings depend on frequency
    few_cells : cells after which stability is proven over the frequency axis, where no method was asked for and it can
        be used
    share : part of the gap at which a proof aims
    smallest : level for a gain of zero: its inverse square is finite
    negligible : level of a gain that is rounding, over the gain of paths that cancel
    attempts : factors of the box that are tried for stability, by cells
    lowered : factor between two of them, unless an unstable member was found

    first : part of the time for the first attempt over the frequency axis
    axis_part : part of the band there, relative to its frequency, for which a box is bisected
    axis_raised : factors of the level at which parts that are left over are tried, each for half of the time that is
        left
    axis_lowered : factors of the aim at which stability is tried one after the other, likewise
    basis : smallest singular value of a basis of eigenvectors, with columns of norm 1, that counts as one

    factors : factors of performance that are tried, by search and by proof, at most
    below : part of the smallest factor that reaches the level at which the next is looked for
    less : part of a factor not proven in time at which the next is tried
    search : part of the time after which no further factor is searched
    attempt : part of the time that is left for the proof of a factor
    ray : points of a ray at which the gain is looked at
    ray_precision : precision of the first one that reaches the level
    """

    few_states: int = 7
    few_cells: int = 60
    share: float = 0.9
    smallest: float = 1e-100
    negligible: float = 1e-9
    attempts: int = 12
    lowered: float = 0.7

    first: float = 0.7
    axis_part: float = 0.1
    axis_raised: tuple[float, ...] = (1.1, 1.25, 1.5, 2.0, 5.0, 20.0, 1000.0)
    axis_lowered: tuple[float, ...] = (1.0, 0.9, 0.75, 0.5, 0.25)
    basis: float = 1e-11

    factors: int = 12
    below: float = 0.999
    less: float = 0.75
    search: float = 0.4
    attempt: float = 0.6
    ray: int = 64
    ray_precision: float = 1e-7


SEARCH, CELLS, BOUNDS = SearchSettings(), CellSettings(), BoundSettings()
