"""Bounds over a grid of frequencies, to look at: between its points nothing is claimed.

Proofs over all frequencies are those of :func:`lftkit.proofs.robust_stability` and
:func:`lftkit.proofs.worst_case_gain`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg, optimize

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.errors import InputError
from lftkit.proofs.state_space.barrier import FULL, BarrierBlock
from lftkit.proofs.state_space.bounds import intervals_of
from lftkit.proofs.state_space.disk_search import DiskSearch, at_end
from lftkit.proofs.state_space.disks import real_first, structure_of
from lftkit.proofs.state_space.scaling_search import find_scalings
from lftkit.proofs.state_space.search import response_slopes
from lftkit.proofs.structured.bounds import mu
from lftkit.proofs.trusted.structured import parts
from lftkit.support.threads import one_thread
from lftkit.systems.arguments import checked
from lftkit.systems.system import System
from lftkit.uncertainty.elements import RealParameter

sl_optimize: Any = optimize


@dataclass(frozen=True)
class Profile:
    """Bounds at frequencies.

    Parameters
    ----------
    omega : ndarray, shape (N,)
        Frequencies [rad/s].
    lower, upper : ndarray, shape (N,)
        Reached at `points` (with values of complex and dynamic elements that are not kept); never exceeded.
    points : tuple of mapping of str to float
        Real elements of the worst member found at each frequency.
    """

    omega: FloatArray
    lower: FloatArray
    upper: FloatArray
    points: tuple[Mapping[str, float], ...]


@checked
def stability_profile(
    system: System,
    omega: ArrayLike,
    box: Mapping[str, tuple[float, float]] | None = None,
    *,
    rtol: float = 1e-3,
    starts: int = 6,
    seed: int = 0,
) -> Profile:
    """Structured singular value of the elements' channels over frequency (robstab's bounds by frequency).

    Where `upper` is below 1 no member of the box has a pole at this point of the axis; where `lower` is above 1 one
    has. Its inverse is the factor by which the box may be scaled there, for intervals that are symmetric about the
    nominal values; others are mapped to [-1, 1] by a bilinear function, which keeps the value 1.

    Parameters
    ----------
    system : System
        In continuous or discrete time, with real, complex and dynamic elements.
    omega : array_like, shape (N,)
        Frequencies [rad/s].
    box : mapping of str to (lowest, highest), optional
        Intervals of real elements with the nominal values inside.
    rtol, starts, seed
        As for :func:`lftkit.proofs.mu`.

    Raises
    ------
    ValueError
        The nominal member has a pole at a frequency; names and intervals as for :func:`lftkit.proofs.robust_stability`.

    Examples
    --------
    ``x' = (-1 + p) x`` with p in [-0.5, 0.5] has its pole at zero for p = 1, and at no other frequency:

    >>> from lftkit import RealParameter
    >>> p = RealParameter("p", 0.0, -0.5, 0.5)
    >>> lag = System([[-1.0]], [[1.0]], [[1.0]], [[0.0]], (), (), channels=("p",), elements=(p,))
    >>> profile = stability_profile(lag, [0.0, 1.0])
    >>> profile.lower.round(3).tolist(), profile.upper.round(3).tolist()
    ([0.5, 0.0], [0.5, 0.0])
    """
    bare = _boxed(system.select(inputs=(), outputs=()), box)
    unit = bare.normalised()
    rows, columns, structure = structure_of(unit)
    blocks = list(parts(structure))[: len(bare.parameters)]
    frequencies = np.atleast_1d(np.asarray(omega, dtype=float))
    lower, upper, points = [], [], []
    for w in frequencies:
        M = _response(unit, float(w))[np.ix_(rows, columns)]
        bounds = mu(M, structure, rtol=rtol, starts=starts, seed=seed)
        lower.append(bounds.lower)
        upper.append(bounds.upper)
        delta = np.zeros(M.T.shape) if bounds.perturbation is None else bounds.perturbation
        at = [float(delta[w_part.start, z_part.start].real) for _, z_part, w_part in blocks]
        points.append({p.name: float(p.from_normalised(value)) for p, value in zip(bare.parameters, at)})
    return Profile(frequencies, np.array(lower), np.array(upper), tuple(points))


@checked
def gain_profile(
    system: System,
    omega: ArrayLike,
    box: Mapping[str, tuple[float, float]] | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    *,
    rtol: float = 1e-3,
    samples: int = 20,
    seed: int = 0,
) -> Profile:
    """Worst-case gain over frequency.

    Parameters
    ----------
    system : System
        In continuous or discrete time, with real, complex and dynamic elements.
    omega : array_like, shape (N,)
        Frequencies [rad/s].
    box : mapping of str to (lowest, highest), optional
        Intervals of real elements with the nominal values inside.
    inputs, outputs : sequence of str, optional
        Ports; all by default.
    rtol : float
        Relative precision of the upper bound.
    samples, seed : int
        Random members from which the gain is climbed.

    Returns
    -------
    Profile
        `upper` is infinite where scalings prove no level.

    Raises
    ------
    ValueError
        As for :func:`stability_profile`; unknown ports.

    Examples
    --------
    The gain of ``k / (s + 1)`` with k in [1, 3]:

    >>> from lftkit import Port, RealParameter
    >>> k, u, y = RealParameter("k", 2.0, 1.0, 3.0), (Port("u", 1),), (Port("y", 1),)
    >>> D = [[0.0, 1.0], [0.0, 0.0]]
    >>> lag = System([[-1.0]], [[1.0, 2.0]], [[0.0], [1.0]], D, u, y, channels=("k",), elements=(k,))
    >>> profile = gain_profile(lag, [0.0, 1.0])
    >>> profile.lower.round(3).tolist(), (profile.upper < 1.002 * profile.lower).tolist()
    ([3.0, 2.121], [True, True])
    """
    chosen = _boxed(system.select(inputs=inputs, outputs=outputs), box)
    unit = chosen.normalised()
    sizes = [unit.occurrences()[p.name] for p in unit.parameters]
    ends = [(p.lower, p.upper) for p in chosen.parameters]
    search = DiskSearch(chosen, ends, (0.0, np.inf), seed)
    frequencies = np.atleast_1d(np.asarray(omega, dtype=float))
    lower, upper, points = [], [], []
    rng = np.random.default_rng(seed)
    with one_thread():
        for w in frequencies:
            M = _response(unit, float(w))
            if search.disks:
                real = at_end(float(w), chosen.dt)
                gain, (values, _) = search.gain_of(_response(chosen, float(w)), samples, real)
            else:
                gain, point = _worst_at(M, sizes, rng, samples)
                values = [p.from_normalised(v) for p, v in zip(chosen.parameters, point)]
            lower.append(gain)
            upper.append(_upper_at(M, unit, gain, rtol))
            points.append({p.name: float(value) for p, value in zip(chosen.parameters, values)})
    return Profile(frequencies, np.array(lower), np.array(upper), tuple(points))


def _boxed(system: System, box: Mapping[str, tuple[float, float]] | None) -> System:
    """The system with real elements first, whose ranges are replaced by the box."""
    sorted_system = real_first(system)
    names = [p.name for p in sorted_system.parameters]
    ends = dict(zip(names, intervals_of(sorted_system, box)))
    elements = tuple(
        replace(e, lower=ends[e.name][0], upper=ends[e.name][1]) if isinstance(e, RealParameter) else e
        for e in sorted_system.elements
    )
    return replace(sorted_system, elements=elements)


def _response(system: System, omega: float) -> ComplexArray:
    n = system.order
    if not n or math.isinf(omega):
        return np.asarray(system.D, complex)
    at = np.exp(1j * omega * system.dt) if system.dt else 1j * omega
    matrix = at * np.eye(n) - system.A
    factors, pivots, _ = linalg.lapack.zgetrf(matrix)
    if not np.abs(np.diag(factors)).min() > 1e-14 * np.abs(matrix).max():
        raise InputError(f"the nominal member must have no pole at the frequencies, got one at {omega} rad/s")
    return np.asarray(system.C @ linalg.lapack.zgetrs(factors, pivots, system.B.astype(complex))[0] + system.D)


def _worst_at(
    M: ComplexArray, sizes: Sequence[int], rng: np.random.Generator, samples: int
) -> tuple[float, FloatArray]:
    """Largest gain found at one frequency and the normalised parameters there."""
    count = len(sizes)
    best = 0.0
    where: FloatArray = np.zeros(count)

    def objective(point: FloatArray) -> tuple[float, FloatArray]:
        nonlocal best, where
        inside = np.clip(point, -1.0, 1.0)
        gain, slopes = response_slopes(M, np.repeat(inside, sizes))
        if gain > best:
            best, where = gain, inside.copy()
        if not 0.0 < gain < np.inf:
            return 0.0, np.zeros(count)
        first = np.cumsum([0, *sizes[:-1]])
        return -math.log(gain), -np.add.reduceat(slopes, first) / gain

    starts = [np.zeros(count), *rng.choice([-1.0, 1.0], (samples, count))] if count else [np.zeros(0)]
    for start in starts:
        objective(start)
        if count:
            options = {"maxfun": 60}
            sl_optimize.minimize(
                objective, 0.99 * start, jac=True, method="L-BFGS-B", bounds=[(-1.0, 1.0)] * count, options=options
            )
    return best, where


def _upper_at(M: ComplexArray, system: System, lower: float, rtol: float) -> float:
    """Least level that scalings prove at one frequency, for the response `M` of a normalised system."""
    q = len(system.channels)
    rows, columns, structure = structure_of(system)
    through = [*columns, *range(q, M.shape[1])]
    inner, outer = M[np.ix_(rows, through)], M[np.ix_(range(q, M.shape[0]), through)]
    unit = np.eye(len(through), dtype=complex)

    def proves(level: float) -> bool:
        blocks = [BarrierBlock(block.kind, inner[z], unit[w]) for block, z, w in parts(structure)]
        blocks.append(BarrierBlock(FULL, outer / level, unit[len(columns) :]))
        return find_scalings(blocks, precision=1e-9).margin > 0.0

    if not np.any(M[q:, q:]) and lower <= 0.0 and not np.any(M[q:, :q]):
        return 0.0
    no = max(lower, 1e-12 * float(linalg.norm(M, 2)), 1e-300)
    level = no * (1.0 + rtol)
    for _ in range(40):  # levels, each twice the one before, until one is proven
        if proves(level):
            break
        no, level = level, 2.0 * level
    else:
        return np.inf
    while level > (1.0 + rtol) * no:
        middle = math.sqrt(level * no)
        if proves(middle):
            level = middle
        else:
            no = middle
    return level
