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
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg

from lftkit.proofs.trusted.arithmetic import INFLATE, TINY, Ball, definite_ratio, scalar
from lftkit.proofs.trusted.axis import neumann
from lftkit.proofs.trusted.proof import FloatArray, indices, refusing, require


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
    left, right : ndarray, shape (n, n)
        ``T = left right'``; zero where one of both has no columns.
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


class CheckedLowerBound(NamedTuple):
    """What is proven of all controllers of a plant; `margin` is that of positive definiteness over all rounding."""

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
            f"proven: for this plant with {self.order} states, {time}, no stabilising controller of any order from "
            f"outputs {seen} to inputs {driven} has a loop with an H-infinity norm below {level}"
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
        own = _sums(A, B, C, D, seen, claim.unseen, claim.dt)
        adjoint = _sums(A.T, C.T, B.T, D.T, moved, claim.unmoved, claim.dt)
        margin = definite_ratio(_coupled(claim, own, adjoint))
        require(margin >= 1.0, "the matrix of both sums must be positive definite beyond rounding, got no margin")
        level, trace = scalar(claim.level), Ball(claim.left.reshape(1, -1)) @ Ball(claim.right.reshape(-1, 1))
        spent = (own.inputs + adjoint.inputs).times(level @ level) + trace.times(scalar(2.0 * claim.level))
        gained = own.outputs + adjoint.outputs - spent
        excess = bool(gained.mid[0, 0] > INFLATE * gained.rad[0, 0] + TINY)
        require(excess, f"the inequalities must contradict each other beyond rounding at the level {claim.level:.9g}")
        return CheckedLowerBound(claim.level, len(A), claim.measured, claim.commanded, claim.dt, margin)


def require_plant(claim: LowerBoundClaim) -> None:
    """Finite matrices that fit to each other, a positive level, signals on both sides."""
    n, (rows, columns) = len(claim.A), claim.D.shape
    y, u = len(claim.measured), len(claim.commanded)
    own = indices(claim.measured, rows) and len({*claim.measured}) == y and 0 < y < rows
    require(own, f"some outputs must be measured and some not, got {claim.measured} of {rows}")
    own = indices(claim.commanded, columns) and len({*claim.commanded}) == u and 0 < u < columns
    require(own, f"some inputs must be commanded and some not, got {claim.commanded} of {columns}")
    shapes = {"A": (n, n), "B": (n, columns), "C": (rows, n), "D": (rows, columns)}
    shapes |= {"left": (n, n), "right": (n, n)}
    vectors = {"unseen": n + columns - u, "unmoved": n + rows - y}
    for name in (*shapes, *vectors):
        array = getattr(claim, name)
        fits = array.shape == shapes[name] if name in shapes else array.ndim == 2 and len(array) == vectors[name]
        finite = fits and array.dtype == np.float64 and np.all(np.isfinite(array))
        require(finite, f"{name} must be finite, of type float64 and of the plant's size, got another")
    for name, value, least in (("level", claim.level, 5e-324), ("dt", claim.dt, 0.0)):
        known = type(value) is float and least <= value < math.inf
        require(known, f"{name} must be a finite number from {least:g} on, got {value}")


class _Sums(NamedTuple):
    """``G S G'`` and G, by which it is about the unit matrix; sums of the squares of outputs and of inputs."""

    storage: Ball
    G: Ball
    outputs: Ball
    inputs: Ball


def _sums(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, seen: FloatArray, vectors: FloatArray, dt: float
) -> _Sums:
    """For vectors that `seen` maps to zero. Any square G will do, as no form is positive definite in singular ones."""
    exact = _in_kernel(seen, vectors)
    x, w = (Ball(exact.mid[part], exact.rad[part]) for part in (slice(len(A)), slice(len(A), None)))
    rate, output = Ball(A) @ x + Ball(B) @ w, Ball(C) @ x + Ball(D) @ w
    G = Ball(np.eye(len(A)))
    if vectors.shape[1] and len(A):
        root, info = linalg.lapack.dpotrf(_storage(x, rate, dt).mid, lower=1)
        require(not info, "sums of rates must be positive definite, got others")
        G = Ball(linalg.lapack.dtrtri(root, lower=1)[0])
    return _Sums(_storage(G @ x, G @ rate, dt), G, _square(output), _square(w))


def _storage(x: Ball, rate: Ball, dt: float) -> Ball:
    """S of states and their rates, or of those one sample later."""
    product = rate @ x.transposed()
    return rate @ rate.transposed() - x @ x.transposed() if dt else product + product.transposed()


def _in_kernel(matrix: FloatArray, vectors: FloatArray) -> Ball:
    """Vectors next to the given ones that a matrix maps to zero exactly: v - R (M R)^-1 M v with any R."""
    R = np.asarray(linalg.pinv(matrix), dtype=float)
    left = Ball(matrix) @ Ball(vectors)
    share = Ball(matrix) @ Ball(R) - Ball(np.eye(len(matrix)))
    size = np.abs(left.mid) + left.rad
    return Ball(vectors, INFLATE * (np.abs(R) @ (size + neumann(np.abs(share.mid) + share.rad) @ size)) + TINY)


def _square(values: Ball) -> Ball:
    """Sum of the squares of all entries."""
    row = Ball(values.mid.reshape(1, -1), values.rad.reshape(1, -1))
    return row @ row.transposed()


def _coupled(claim: LowerBoundClaim, own: _Sums, adjoint: _Sums) -> Ball:
    """``[S, T; T', R]`` in other coordinates, without what belongs to no vectors: of it nothing is claimed."""
    present = [one.storage for one, vectors in ((own, claim.unseen), (adjoint, claim.unmoved)) if vectors.shape[1]]
    if len(present) == 2:
        T = (own.G @ Ball(claim.left)) @ (adjoint.G @ Ball(claim.right)).transposed()
        blocks = [[own.storage, T], [T.transposed(), adjoint.storage]]
        return Ball(*(np.block([[getattr(one, part) for one in row] for row in blocks]) for part in ("mid", "rad")))
    require(present and not claim.left.any(), "a proof must have vectors, and those of both sides for a coupling")
    return present[0]
