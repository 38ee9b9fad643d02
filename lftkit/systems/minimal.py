"""Exact minimal realisation of an uncertain system: fewest states, fewest occurrences.

The states and the channels of each element are treated alike: a repeated scalar (1/s, or delta_i) closed around
a block of the LFT matrix. For one block the others count as inputs and outputs; the part that is not controllable
from them, or not observable from them, is removed by an orthogonal change of coordinates of that block (staircase).
Then the parts of all blocks that the inputs reach together are kept: the smallest family of subspaces V_i that
contains what the inputs enter and with M_ij V_j in V_i; likewise for the outputs. The passes are repeated until
nothing more is removed. The response at every value is unchanged; nothing is approximated.

What is zero is a matter of scaling: balancing takes a coupling that is rounding (1e-30 beside 100) for a real one, and
scales its state until true couplings look like zero. So there are three ways to scale, and the first one is taken
that leaves the response at points of s and of the elements as it was; where none does, nothing is removed.

Assumption: parameters and 1/s are treated as non-commuting, which never removes too much. Source: Beck,
Doyle and Glover, IEEE TAC 41 (1996), "Model reduction of multidimensional and uncertain systems"; D'Andrea and
Khatri, ACC 1997.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray
from lftkit.support.settings import AlgorithmSettings
from lftkit.support.state_units import in_balanced_units
from lftkit.systems.arguments import checked
from lftkit.systems.delta import delta_response
from lftkit.systems.system import System
from lftkit.uncertainty.elements import width

Scaling = Callable[[FloatArray], FloatArray]
"""Of a square block the sizes of its coordinates, a diagonal change of coordinates."""


@dataclass(frozen=True)
class MinimalSettings(AlgorithmSettings):
    """Numbers of the choice of a scaling.

    Attributes
    ----------
    rounding : entries below this fraction of the largest do not count for the scaling
    same : two responses are the same within this fraction of the largest value of each entry: lost states make far
        more
    zero : largest entry of a response, over the largest of all and over `same`, that may be zero but for rounding
    slowest : eigenvalues below this fraction of the fastest may be a double integrator and rounding
    """

    rounding: float = 1e-14
    same: float = 1e-6
    zero: float = 1e-11
    slowest: float = 1e-7


SETTINGS = MinimalSettings()


@dataclass(frozen=True)
class Reduction:
    """A minimal system with the numbers of states and occurrences that were removed.

    Parameters
    ----------
    system : System
    removed_states : int
    removed_occurrences : dict
        Parameter name to number of occurrences removed (0 where none).
    """

    system: System
    removed_states: int
    removed_occurrences: dict[str, int]

    def __str__(self) -> str:
        parts = [f"{self.removed_states} states"]
        parts += [f"{n} of {name}" for name, n in self.removed_occurrences.items() if n]
        return "removed " + ", ".join(parts)


@checked
def minimal_realisation(system: System, *, tolerance: float = 1e-11, settings: MinimalSettings = SETTINGS) -> Reduction:
    """Remove uncontrollable and unobservable states and Delta channels.

    Parameters
    ----------
    system : System
    tolerance : float
        Couplings below this fraction of the norm of the (balanced) block are treated as zero.
    settings : MinimalSettings
        Numbers of the choice of a scaling.

    Returns
    -------
    Reduction
        Channels of a parameter are adjacent in the new system. A block that is already minimal keeps its
        coordinates.

    Examples
    --------
    Two integrators of the same input reduce to one state:

    >>> from lftkit import Port, state_space
    >>> u, y = [Port("u", 1)], [Port("y", 1)]
    >>> twice = state_space(np.zeros((2, 2)), [[1.0], [1.0]], [[0.5, 0.5]], [[0.0]], u, y)
    >>> str(minimal_realisation(twice))
    'removed 1 states'
    """
    in_order = system.sorted_channels()
    count = Counter(in_order.channels)
    scalings: tuple[Scaling, ...] = (  # balanced without what may be rounding, balanced, as it is
        lambda A: in_balanced_units(np.where(np.abs(A) > settings.rounding * np.abs(A).max(initial=0.0), A, 0.0))[1],
        lambda A: in_balanced_units(A)[1],
        lambda A: np.ones(len(A)),
    )
    candidates = (_reduced(in_order, tolerance, scaling) for scaling in scalings)
    kept = next((one for one in candidates if _is_same(one, in_order, settings)), in_order)
    left = Counter(kept.channels)
    removed = {e.name: (count[e.name] - left[e.name]) // width(e) for e in in_order.elements}
    return Reduction(kept, in_order.order - kept.order, removed)


def _reduced(full: System, tolerance: float, scaling: Scaling) -> System:
    """The system without what cannot be reached or seen, as one scaling shows it."""
    count = Counter(full.channels)
    names = [e.name for e in full.elements]
    sizes = [full.order, *(count[name] for name in names)]
    fixed = [False, *(width(e) > 1 for e in full.elements)]  # a matrix of dynamics keeps its channels
    M = np.block([[full.A, full.B], [full.C, full.D]])
    while True:
        before = list(sizes)
        for i in range(len(sizes)):
            if not fixed[i]:
                M, sizes[i] = _reduced_block(M, sum(sizes[:i]), sizes[i], tolerance, scaling)
        if sizes == before:
            # Reduce all blocks to what the inputs reach, and then to what the outputs see, through all blocks
            # together
            M, sizes = _keep_jointly_reachable(M, sizes, fixed, tolerance, scaling)
            turned, sizes = _keep_jointly_reachable(M.T, sizes, fixed, tolerance, scaling)
            M = turned.T
        if sizes == before:
            break
    n = sizes[0]
    channels = tuple(name for name, size in zip(names, sizes[1:]) for _ in range(size))
    return replace(full, A=M[:n, :n], B=M[:n, n:], C=M[n:, :n], D=M[n:, n:], channels=channels)


def _responses(system: System, full: System, slowest: float) -> ComplexArray:
    """Response at values of s (or z) as slow and as fast as the given system, and at values of its elements."""
    rng = np.random.default_rng(0)
    centre = 1.0 if full.dt else 0.0
    speeds = np.unique(np.abs(linalg.eigvals(full.A) - centre)) if full.order else np.zeros(0)
    speeds = speeds[speeds > slowest * speeds.max(initial=0.0)]
    speeds = np.quantile(speeds, np.linspace(0.0, 1.0, 7), method="nearest") if len(speeds) else np.ones(1)
    responses: list[ComplexArray] = []
    for speed in (0.1 * speeds[0], *(0.7 * speeds), 10.0 * speeds[-1]):
        point = centre + speed * np.exp(1.2j)  # beside the axis and the circle
        values = full.sample_values(rng)[0]
        point = complex(point)
        n, q = system.order, len(system.channels)
        delta = delta_response(system.channels, system.elements, values, point)
        M = np.block([[system.A, system.B], [system.C, system.D]]).astype(complex)
        inner = M[: n + q, : n + q].copy()
        entering, leaving = M[: n + q, n + q :].copy(), M[n + q :, : n + q]
        inner[n:], entering[n:] = delta @ inner[n:], delta @ entering[n:]
        loop = np.diag([point] * n + [1.0] * q) - inner
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", linalg.LinAlgWarning)  # the two responses disagree where that matters
            responses.append(M[n + q :, n + q :] + leaving @ linalg.solve(loop, entering))
    return np.array(responses)


def _is_same(reduced: System, full: System, settings: MinimalSettings) -> bool:
    """Whether two responses agree at all points, each entry within a fraction of its largest value."""
    if (reduced.order, reduced.channels) == (full.order, full.channels):
        return True
    try:
        expected, actual = (_responses(one, full, settings.slowest) for one in (full, reduced))
    except linalg.LinAlgError:
        return False
    size = np.abs(expected).max(axis=0, initial=0.0)
    zero = settings.zero / settings.same * size.max(initial=0.0)  # an entry may be zero but for rounding
    size = np.maximum(size, zero)
    return bool(np.all(np.abs(actual - expected) <= settings.same * size))


def _reduced_block(M: FloatArray, start: int, size: int, tolerance: float, scaling: Scaling) -> tuple[FloatArray, int]:
    """Reduce the block of `size` rows and columns from `start` on; the other rows and columns stay."""
    if size == 0:
        return M, 0
    M, size = _keep_reachable(M, start, size, tolerance, scaling)
    if size == 0:
        return M, 0
    turned, size = _keep_reachable(M.T, start, size, tolerance, scaling)
    return turned.T, size


def _keep_jointly_reachable(
    M: FloatArray, sizes: list[int], fixed: list[bool], tolerance: float, scaling: Scaling
) -> tuple[FloatArray, list[int]]:
    k = sum(sizes)
    if k == 0:
        return M, sizes
    scale = scaling(M[:k, :k])
    scaled = M[:k, :k] * scale / scale[:, None]
    entering = M[:k, k:] / scale[:, None]
    ends = np.cumsum(sizes)
    blocks = [slice(int(end) - size, int(end)) for end, size in zip(ends, sizes)]
    allowed = tolerance * max(1.0, float(linalg.norm(scaled, 2)))
    bases = [np.eye(size)[:, : size if keep else 0] for size, keep in zip(sizes, fixed)]
    fresh = []
    for i, block in enumerate(blocks):
        part = entering[block]
        lengths = np.sqrt(np.sum(part**2, axis=0))
        new = _orthonormal(part[:, lengths > 0] / lengths[lengths > 0], bases[i], tolerance)
        fresh.append(bases[i] if fixed[i] else new)
        bases[i] = bases[i] if fixed[i] else new
    while any(f.shape[1] for f in fresh):
        onward = []
        for i, block in enumerate(blocks):
            columns = np.hstack([scaled[block, other] @ f for other, f in zip(blocks, fresh)])
            onward.append(_orthonormal(columns, bases[i], allowed))
        bases = [np.hstack([Q, new]) for Q, new in zip(bases, onward)]
        fresh = onward
    kept = [Q.shape[1] for Q in bases]
    if kept == sizes:
        return M, sizes
    Q = np.asarray(linalg.block_diag(*bases)).reshape(k, sum(kept))
    lift, drop = scale[:, None] * Q, Q.T / scale
    M = np.vstack([drop @ M[:k], M[k:]])
    return np.hstack([M[:, :k] @ lift, M[:, k:]]), kept


def _keep_reachable(M: FloatArray, start: int, size: int, tolerance: float, scaling: Scaling) -> tuple[FloatArray, int]:
    inside = np.arange(start, start + size)
    others = np.setdiff1d(np.arange(M.shape[1]), inside)
    A, B = M[np.ix_(inside, inside)], M[np.ix_(inside, others)]
    scale = scaling(A)
    scaled = A * scale / scale[:, None]
    # Orthonormal basis of the smallest A-invariant subspace that contains the columns of B
    B = B / scale[:, None]
    sizes = np.sqrt(np.sum(B**2, axis=0))
    columns = B[:, sizes > 0] / sizes[sizes > 0]
    allowed = tolerance * max(1.0, float(linalg.norm(scaled, 2)))
    Q: FloatArray = np.zeros((size, 0))
    fresh = _orthonormal(columns, Q, tolerance)
    while fresh.shape[1]:
        Q = np.hstack([Q, fresh])
        fresh = _orthonormal(scaled @ fresh, Q, allowed)
    if Q.shape[1] == size:
        return M, size
    lift, drop = scale[:, None] * Q, Q.T / scale
    M = np.vstack([M[:start], drop @ M[inside], M[start + size :]])
    M = np.hstack([M[:, :start], M[:, inside] @ lift, M[:, start + size :]])
    return M, Q.shape[1]


def _orthonormal(columns: FloatArray, Q: FloatArray, allowed: float) -> FloatArray:
    for _ in range(2):  # Gram-Schmidt twice is enough for orthogonality to rounding
        columns = columns - Q @ (Q.T @ columns)
    if columns.shape[1] == 0 or Q.shape[1] == Q.shape[0]:
        return np.zeros((Q.shape[0], 0))
    U, s, _ = linalg.svd(columns, full_matrices=False)
    U = U[:, s > allowed]
    U = U - Q @ (Q.T @ U)
    return np.asarray(linalg.qr(U, mode="economic")[0]) if U.shape[1] else U
