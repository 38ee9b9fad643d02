"""Check of a lower bound of the H-infinity norm that controllers of any order can reach.

A plant ``x' = A x + B1 w + B2 u, z = C1 x + D11 w + D12 u, y = C2 x + D21 w + D22 u`` has a controller with which the
loop is stable and its norm is below g only if there is a matrix X > 0 with ::

    2 x' X (A x + B1 w) + |C1 x + D11 w|^2 - g^2 |w|^2 < 0    for all (x, w) other than zero with C2 x + D21 w = 0,

as the bounded-real inequality of the loop says it for a controller that is at rest and sees nothing. The loop's adjoint
has a Y > 0 with ``2 p' Y (A' p + C1' q) + |B1' p + D11' q|^2 - g^2 |q|^2 < 0`` where ``B2' p + D12' q = 0``. X and Y
are blocks of a matrix and of g^2 times its inverse, so that ``[X, g I; g I, Y] >= 0`` (Gahinet and Apkarian 1994).

A proof has some (x, w), some (p, q) and a matrix T. With the sums S of ``x (A x + B1 w)' + (A x + B1 w) x'`` and R, the
same of the adjoint, let ``[S, T; T', R] > 0``. The sums of all inequalities then contradict each other where ::

    sum |C1 x + D11 w|^2 + sum |B1' p + D11' q|^2 - g^2 (sum |w|^2 + sum |q|^2) - 2 g trace(T) > 0.

In discrete time S is the sum of ``x+ x+' - x x'`` with ``x+ = A x + B1 w``. Vectors of a file meet their condition but
for rounding: next to them are some that meet it, and the bounds of all that follows hold for these.

A measurement e x without noise is zero for all (x, w), and ``e S e'`` with it. Vectors are then taken whose ``e (A x +
B1 w)`` is zero, too, a further measurement, of which again some combinations may have no noise. Where this leaves a
state without inputs, ``x' = F x``, its stable modes have to be zero, too: rows e with ``e F = L e``. With all such rows
E of full rank, ``E S = 0``: S > 0 is asked for where E x = 0 alone, and T has ``E T = 0``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from scipy import linalg

from lftkit.proofs.trusted.arithmetic import INFLATE, TINY, UNIT, Ball, definite_ratio, scalar
from lftkit.proofs.trusted.axis import neumann
from lftkit.proofs.trusted.digests import plant_digest
from lftkit.proofs.trusted.proof import FloatArray, indices, refusing, require

ROWS = "decaying", "decaying_adjoint", "undisturbed", "undisturbed_adjoint"
COMBINATIONS = "noiseless", "weightless"


@dataclass(frozen=True)
class LowerBoundClaim:
    """A plant, a level and what proves that no controller reaches less.

    Parameters
    ----------
    level : float
    A, B, C, D : ndarray
        Of the plant, shapes (n, n), (n, w + u), (z + y, n), (z + y, w + u).
    measured, commanded : tuple of int
        Rows of C that the controller sees, columns of B that it drives.
    dt : float
        Sampling period [s], 0 for continuous time.
    unseen : ndarray, shape (n + w, k)
        Columns (x, w).
    unmoved : ndarray, shape (n + z, l)
        Columns (p, q).
    left, right : ndarray, shape (n, m)
        ``T = left right'``; zero where one of both has no columns.
    noiseless : ndarray, shape (r, any)
        Row k combines the measurements, the undisturbed states and their rates that do not follow, and the rates of
        the k combinations before, to one that no w reaches.
    weightless : ndarray, shape (s, any)
        The same of the adjoint.
    decaying, decaying_adjoint : ndarray, shape (k, n)
        Rows on x and p that are left-invariant but for rounding where there are no inputs.
    undisturbed, undisturbed_adjoint : ndarray, shape (k, n)
        Rows on x and p whose rates follow from themselves and the measurements, as those of a weight of measurements.
    """

    level: float
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    measured: tuple[int, ...]
    commanded: tuple[int, ...]
    dt: float
    unseen: FloatArray
    unmoved: FloatArray
    left: FloatArray
    right: FloatArray
    noiseless: FloatArray
    weightless: FloatArray
    decaying: FloatArray
    decaying_adjoint: FloatArray
    undisturbed: FloatArray
    undisturbed_adjoint: FloatArray


class CheckedLowerBound(NamedTuple):
    """What is proven of all controllers of a plant, which is named by the digest of its numbers.

    `margin` is that of positive definiteness over all rounding.
    """

    plant: str
    level: float
    order: int
    measured: tuple[int, ...]
    commanded: tuple[int, ...]
    dt: float
    margin: float

    def __str__(self) -> str:
        seen, driven = (", ".join(str(k + 1) for k in own) for own in (self.measured, self.commanded))
        time = f"sampled every {self.dt:g} s" if self.dt else "in continuous time"
        level = f"{self.level * (1.0 - 6e-9):.9g}"  # rounded, it is not above the level
        return (
            f"plant {self.plant}, {self.order} states, {time}\n"
            f"proven: no stabilising controller of any order from outputs {seen} to inputs {driven} has a loop with an "
            f"H-infinity norm below {level}"
        )


def check_lower_bound(claim: LowerBoundClaim) -> CheckedLowerBound:
    """Verify a proof; a ProofError says why it is refused."""
    with refusing("a proof of a lower bound"):
        require_plant(claim)
        y, u = list(claim.measured), list(claim.commanded)
        z, w = ([k for k in range(size) if k not in own] for size, own in zip(claim.D.shape, (y, u)))
        A, B, C, D = claim.A, claim.B[:, w], claim.C[z], claim.D[np.ix_(z, w)]
        seen = np.hstack([claim.C[y], claim.D[np.ix_(y, w)]])
        moved = np.hstack([claim.B[:, u].T, claim.D[np.ix_(z, u)].T])
        sides = (
            _constraints(A, B, (seen, claim.undisturbed, claim.noiseless), claim.decaying),
            _constraints(A.T, C.T, (moved, claim.undisturbed_adjoint, claim.weightless), claim.decaying_adjoint),
        )
        own = _sums((A, B, C, D), sides[0], claim.unseen, claim.dt)
        adjoint = _sums((A.T, C.T, B.T, D.T), sides[1], claim.unmoved, claim.dt)
        T = tuple(_in_kernel(side.states, part) for side, part in zip(sides, (claim.left, claim.right)))
        margin = definite_ratio(_coupled(claim, own, adjoint, T))
        require(margin >= 1.0, "the matrix of both sums must be positive definite beyond rounding, got no margin")
        level, trace = scalar(claim.level), _flat(T[0]) @ _flat(T[1]).transposed()
        spent = (own.inputs + adjoint.inputs).times(level @ level) + trace.times(scalar(2.0 * claim.level))
        gained = own.outputs + adjoint.outputs - spent
        excess = bool(gained.mid[0, 0] > INFLATE * gained.rad[0, 0] + TINY)
        require(excess, f"the inequalities must contradict each other beyond rounding at the level {claim.level:.9g}")
        plant = plant_digest(claim.dt, (), {}, {}, (claim.A, claim.B, claim.C, claim.D))
        return CheckedLowerBound(plant, claim.level, len(A), claim.measured, claim.commanded, claim.dt, margin)


def require_plant(claim: LowerBoundClaim) -> None:
    """Finite matrices that fit to each other, a positive level, signals on both sides."""
    n, (rows, columns) = len(claim.A), claim.D.shape
    y, u = len(claim.measured), len(claim.commanded)
    own = indices(claim.measured, rows) and len({*claim.measured}) == y and 0 < y < rows
    require(own, f"some outputs must be measured and some not, got {claim.measured} of {rows}")
    own = indices(claim.commanded, columns) and len({*claim.commanded}) == u and 0 < u < columns
    require(own, f"some inputs must be commanded and some not, got {claim.commanded} of {columns}")
    shapes = {"A": (n, n), "B": (n, columns), "C": (rows, n), "D": (rows, columns)}
    shapes |= {name: (len(getattr(claim, name)), n) for name in ROWS}
    shapes |= {name: (len(getattr(claim, name)), getattr(claim, name).shape[-1]) for name in COMBINATIONS}
    shapes |= {"left": (n, claim.left.shape[-1]), "right": (n, claim.left.shape[-1])}
    vectors = {"unseen": n + columns - u, "unmoved": n + rows - y}
    for name in (*shapes, *vectors):
        array = getattr(claim, name)
        fits = array.shape == shapes[name] if name in shapes else array.ndim == 2 and len(array) == vectors[name]
        finite = fits and array.dtype == np.float64 and np.all(np.isfinite(array))
        require(finite, f"{name} must be finite, of type float64 and of the plant's size, got another")
    for name, value, least in (("level", claim.level, 5e-324), ("dt", claim.dt, 0.0)):
        known = type(value) is float and least <= value < math.inf
        require(known, f"{name} must be a finite number from {least:g} on, got {value}")


class Constraints(NamedTuple):
    """What the vectors of a side meet: rows of E on x, and rows on (x, w) with those of the rates of E x."""

    states: Ball
    vectors: Ball


def exact_constraints(
    A: FloatArray, B: FloatArray, seen: FloatArray, undisturbed: FloatArray, combinations: FloatArray
) -> tuple[Any, Any]:
    """Rows of both, as rational numbers: what is seen, undisturbed states and combinations without noise.

    Raises
    ------
    ProofError
        A combination that some w reaches.
    """
    dynamics, rows, states, n = rational(np.hstack([A, B])), rational(seen), rational(undisturbed), len(A)
    rows = np.vstack([rows, np.hstack([states, rational(np.zeros((len(states), B.shape[1])))])])
    for rate in states @ dynamics:
        rows = rows if follows(rate, rows) else np.vstack([rows, rate])
    for k, combination in enumerate(rational(combinations)):
        size = min(len(combination), len(rows))
        row = combination[:size] @ rows[:size]
        require(not row[n:].any(), f"combination {k + 1} of measurements must have no noise, got some")
        states, rows = np.vstack([states, row[:n]]), np.vstack([rows, row[:n] @ dynamics])
    return states, rows


def follows(row: Any, rows: Any) -> bool:
    """Whether a row of rational numbers is a combination of others, by Gaussian elimination."""
    left, rest = rows.tolist(), row.tolist()
    for column in range(len(rest)):
        pivot = next((own for own in left if own[column]), None)
        if pivot is None and rest[column]:
            return False
        if pivot is not None:
            reduced = [own for own in left if own is not pivot]
            *left, rest = (
                [a - own[column] / pivot[column] * b for a, b in zip(own, pivot)] for own in [*reduced, rest]
            )
    return True


def rational(matrix: FloatArray) -> Any:
    """Entries as rational numbers."""
    return np.array([Fraction(value) for value in matrix.ravel().tolist()], dtype=object).reshape(matrix.shape)


def _constraints(
    A: FloatArray, B: FloatArray, given_rows: tuple[FloatArray, FloatArray, FloatArray], decaying: FloatArray
) -> Constraints:
    given = Constraints(*map(_rounded, exact_constraints(A, B, *given_rows)))
    if not len(decaying):
        return given
    rows = _invariant(A, B, given, decaying)
    on_inputs = Ball(np.zeros((len(decaying), B.shape[1])))
    return Constraints(_block([[given.states], [rows]]), _block([[given.vectors], [_block([[rows, on_inputs]])]]))


def _invariant(A: FloatArray, B: FloatArray, given: Constraints, near: FloatArray) -> Ball:
    """Rows e next to the given ones with ``e x' = L e x`` for all (x, w) that meet the constraints.

    These are ``(x, w) = (X, W) c`` with ``c' = F c`` where they have as many dimensions as x. In coordinates with the
    rows as the first ones ``(I H)`` is invariant where ``H F22 - F11 H = H F21 H - F12``, and some H of a size is so by
    Brouwer's theorem if this equation, linear on the left, maps all of that size to such ones.
    """
    n, k, m = len(A), len(near), len(A) - len(given.states.mid)
    kernel = _in_kernel(given.vectors, np.asarray(linalg.null_space(given.vectors.mid)))
    x, w = _part(kernel, slice(n)), _part(kernel, slice(n, None))
    alone = n + B.shape[1] - len(given.vectors.mid) == m
    require(alone and x.mid.shape[1] == m > k, "decaying modes must be some of a state without inputs, got others")
    coordinates = _left_inverse(x)
    T = np.vstack([near @ x.mid, _complement(near @ x.mid).T])
    F = Ball(T) @ coordinates @ (Ball(A) @ x + Ball(B) @ w) @ _left_inverse(Ball(T))
    first, others = slice(k), slice(k, None)
    own, rest = _part(F, first, first), _part(F, others, others)
    linear = _kron(np.eye(k), rest.transposed()) - _kron(own, np.eye(m - k))
    inverse, across, back = (
        _size(M) for M in (_left_inverse(linear), _part(F, first, others), _part(F, others, first))
    )
    gain, least = float(inverse.sum(axis=1).max()), float(across.max())
    size = 2.0 * gain * least * INFLATE + TINY
    met = INFLATE * gain * (least + size**2 * float(back.sum())) <= size
    require(met, "decaying modes must be apart from the others beyond rounding, got none that are")
    return Ball(T[:k], np.tile(size * INFLATE * np.abs(T[k:]).sum(axis=0), (k, 1))) @ coordinates


def _rounded(matrix: Any) -> Ball:
    mid = matrix.astype(float)
    return Ball(mid, INFLATE * UNIT * np.abs(mid) + TINY)


class _Sums(NamedTuple):
    """``G S G'`` and G, by which it is about the unit matrix; sums of the squares of outputs and of inputs."""

    storage: Ball
    G: Ball
    outputs: Ball
    inputs: Ball


def _sums(plant: tuple[FloatArray, ...], given: Constraints, vectors: FloatArray, dt: float) -> _Sums:
    """For vectors next to the given ones.

    S is zero on all rows E of states, and any others will do for G: if ``G S G'`` is positive definite, G has full rank
    on the x with E x = 0 as it has as many rows as these have dimensions.
    """
    A, B, C, D = plant
    exact = _in_kernel(given.vectors, vectors)
    x, w = _part(exact, slice(len(A))), _part(exact, slice(len(A), None))
    rate, output = Ball(A) @ x + Ball(B) @ w, Ball(C) @ x + Ball(D) @ w
    G = Ball(_complement(given.states.mid).T)
    if vectors.shape[1] and len(G.mid):
        root, info = linalg.lapack.dpotrf(_storage(G @ x, G @ rate, dt).mid, lower=1)
        require(not info, "sums of rates must be positive definite, got others")
        G = Ball(linalg.lapack.dtrtri(root, lower=1)[0] @ G.mid)
    return _Sums(_storage(G @ x, G @ rate, dt), G, _square(output), _square(w))


def _complement(rows: FloatArray) -> FloatArray:
    """Columns next to which all rows are zero, n - r of them."""
    count, n = rows.shape
    require(count <= n, f"combinations without noise must be at most {n}, got {count}")
    return np.asarray(linalg.qr(rows.T)[0][:, count:]) if count else np.eye(n)


def _part(matrix: Ball, rows: slice, columns: slice = slice(None)) -> Ball:
    return Ball(matrix.mid[rows, columns], matrix.rad[rows, columns])


def _size(matrix: Ball) -> FloatArray:
    """Bounds of the entries."""
    return np.asarray(INFLATE * (np.abs(matrix.mid) + matrix.rad))


def _block(rows: list[list[Ball]]) -> Ball:
    return Ball(*(np.block([[getattr(one, part) for one in row] for row in rows]) for part in ("mid", "rad")))


def _kron(left: Ball | FloatArray, right: Ball | FloatArray) -> Ball:
    """Kronecker product with a matrix of zeros and ones."""
    mid, rad = (
        np.kron(*(getattr(one, part) if isinstance(one, Ball) else one for one in (left, right)))
        for part in ("mid", "rad")
    )
    return Ball(np.asarray(mid), np.asarray(rad))


def _left_inverse(matrix: Ball) -> Ball:
    """``(R M)^-1 R`` with any R."""
    R = np.asarray(linalg.pinv(matrix.mid), dtype=float)
    share = Ball(R) @ matrix - Ball(np.eye(len(R)))
    return Ball(R, INFLATE * (neumann(np.abs(share.mid) + share.rad) @ np.abs(R)) + TINY)


def _storage(x: Ball, rate: Ball, dt: float) -> Ball:
    """S of states and their rates, or of those one sample later."""
    product = rate @ x.transposed()
    return rate @ rate.transposed() - x @ x.transposed() if dt else product + product.transposed()


def _in_kernel(matrix: Ball, vectors: FloatArray) -> Ball:
    """Vectors next to the given ones that a matrix maps to zero exactly: v - R (M R)^-1 M v with any R.

    It raises an ArithmeticError where the matrix may have less than full row rank.
    """
    R = np.asarray(linalg.pinv(matrix.mid), dtype=float)
    left = matrix @ Ball(vectors)
    share = matrix @ Ball(R) - Ball(np.eye(len(matrix.mid)))
    size = np.abs(left.mid) + left.rad
    return Ball(vectors, INFLATE * (np.abs(R) @ (size + neumann(np.abs(share.mid) + share.rad) @ size)) + TINY)


def _flat(values: Ball) -> Ball:
    """All entries in one row."""
    return Ball(values.mid.reshape(1, -1), values.rad.reshape(1, -1))


def _square(values: Ball) -> Ball:
    """Sum of the squares of all entries."""
    row = _flat(values)
    return row @ row.transposed()


def _coupled(claim: LowerBoundClaim, own: _Sums, adjoint: _Sums, T: tuple[Ball, ...]) -> Ball:
    """``[S, T; T', R]`` in other coordinates, without what belongs to no vectors: of it nothing is claimed."""
    present = [one.storage for one, vectors in ((own, claim.unseen), (adjoint, claim.unmoved)) if vectors.shape[1]]
    if len(present) == 2:
        coupling = (own.G @ T[0]) @ (adjoint.G @ T[1]).transposed()
        return _block([[own.storage, coupling], [coupling.transposed(), adjoint.storage]])
    require(present and not claim.left.any(), "a proof must have vectors, and those of both sides for a coupling")
    return present[0]
