"""Proven lower bounds of the H-infinity norm that controllers of any order can reach.

The least level at which the inequalities of :mod:`lftkit.proofs.trusted.lower_bound` have a solution is found by
semidefinite programming, ::

    minimise g^2 with  g^2 W' W - Q' X P - P' X Q - Z' Z >= 0,  [X, I; I, Y] >= 0,
    [q' q - r' Y p - p' Y r, v'; v, g^2 I] >= 0,

where P, Q, W and Z are x, its rate, w and z of vectors that are not measured, and p, r, q and v those of the adjoint.
The dual matrices of the first and third are sums of vectors that contradict each lower level. Where combinations of
measurements have no noise, their states are zero in all vectors, and X is of the others
(:mod:`lftkit.proofs.trusted.lower_bound`).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import linalg

from lftkit.analysis.eigenvectors import balanced
from lftkit.arrays import FloatArray
from lftkit.proofs.lower_bound import LowerBoundProof
from lftkit.proofs.trusted.lower_bound import check_lower_bound, exact_constraints
from lftkit.proofs.trusted.proof import ProofError
from lftkit.support.settings import AlgorithmSettings
from lftkit.synthesis.noiseless import noiseless_combinations, undisturbed_states
from lftkit.synthesis.semidefinite import MatrixInequality, iterates, lower_factor
from lftkit.synthesis.standard_plant import Names, standard_plant
from lftkit.systems.arguments import checked
from lftkit.systems.exchange import as_system
from lftkit.systems.sampled.bilinear import to_continuous
from lftkit.systems.system import System

NO_VECTORS = "no vectors were found that contradict a level beyond rounding"
CONFINED = (
    "measurements without noise (D21 of less than full row rank) leave no definite sum of the plant",
    "commands without a weight (D12 of less than full column rank) leave no definite sum of the adjoint",
)
Side = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
Sides = tuple[bool, bool]
"""Whether vectors of the plant, and of its adjoint, are looked for."""
ATTEMPTS = (
    ((True, True), 0.7), ((True, False), 0.7), ((False, True), 0.7), ((True, True), 0.4), ((True, True), 0.9),
)  # fmt: skip
"""Sides and centring (:func:`~lftkit.synthesis.semidefinite.iterates`) of attempts, until one is close. One side alone
is what is left where the other says nothing, as all that it has are stable modes without a disturbance."""


@dataclass(frozen=True)
class LowerBoundSettings(AlgorithmSettings):
    """Numbers of the search for a proof, and of the numerical bound.

    Attributes
    ----------
    most_states : states up to which a proof is looked for
    below : relative distances from the level of vectors at which one is claimed, until the check has a margin
    claimed : iterates with the highest levels that are tried: the earlier ones are farther from singular sums
    close : relative distance of a proven level from the optimum of the program below which one attempt is enough
    confirmed : relative distance from the value of a closed loop at which an optimum of the program counts
    accuracy : relative distance of two runs that agree
    scales, centred : units of the error over that value, and centring, of the runs of which two must agree
    marginal : real parts of modes over the size of the matrix below which they count as stable
    """

    most_states: int = 20
    below: tuple[float, ...] = (1e-7, 1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 1e-2)
    claimed: int = 12
    close: float = 5e-4
    confirmed: float = 2e-3
    accuracy: float = 5e-4
    scales: tuple[float, ...] = (1.0, 10.0, 10.0, 1.0, 0.1, 0.1)
    centred: tuple[float, ...] = (0.3, 0.1, 0.3, 0.1, 0.3, 0.1)
    marginal: float = 1e-9


SETTINGS = LowerBoundSettings()


@dataclass(frozen=True)
class ProvenLowerBound:
    """Proven lower bound of the H-infinity norm that controllers of any order can reach.

    Attributes
    ----------
    level : float
        No stabilising controller has a norm below it; minus infinity where nothing is proven.
    proof : LowerBoundProof or None
        For :func:`~lftkit.proofs.check_proof`.
    reason : str
        Why there is no proof; empty with one.
    """

    level: float
    proof: LowerBoundProof | None = field(repr=False)
    reason: str = ""


@checked
def lower_bound_proof(
    plant: System, measured: Names, commanded: Names, *, settings: LowerBoundSettings = SETTINGS
) -> ProvenLowerBound:
    """Proven lower bound of the H-infinity norm that any controller can reach, from and to the other ports.

    Parameters
    ----------
    plant : System
        Certain, continuous or sampled.
    measured, commanded : str or sequence of str
        Its outputs that a controller sees, and its inputs that it drives.
    settings : LowerBoundSettings
        Numbers of the search.

    Returns
    -------
    ProvenLowerBound

    Raises
    ------
    ValueError
        An uncertain plant, a port that it does not have, a mode that no controller can stabilise.

    Examples
    --------
    An integrator with noise and disturbance, for which the least norm is the root of two:

    >>> from lftkit import System
    >>> from lftkit.proofs import check_proof
    >>> ports = [("w", 2), ("u", 1)], [("z", 2), ("y", 1)]
    >>> P = System([[0.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]], *ports)
    >>> found = lower_bound_proof(P, "y", "u")
    >>> round(found.level, 3), check_proof(found.proof).level == found.level
    (1.414, True)
    """
    system = as_system(plant)
    problem = _problem(system, measured, commanded, settings)
    if problem is None:
        return ProvenLowerBound(-np.inf, None, f"the plant has {system.order} states, more than {settings.most_states}")
    try:
        working = _Working.of(problem)
    except ValueError as error:
        return ProvenLowerBound(-np.inf, None, str(error))
    best: LowerBoundProof | None = None
    for sides, centred in ATTEMPTS:
        proof, optimum = _best(working, sides, centred, settings)
        if proof is not None and (best is None or proof.level > best.level):
            best, working = proof, _Working.of(problem, proof.level)
        if proof is not None and all(sides) and proof.level > (1.0 - settings.close) * optimum:
            break
    if best is None:
        confined = [text for half, text in zip(working.halves, CONFINED) if half.confined]
        return ProvenLowerBound(-np.inf, None, "; ".join([NO_VECTORS, *confined]))
    return ProvenLowerBound(best.level, best)


def confirmed_optimum(
    plant: System, measured: Names, commanded: Names, value: float, settings: LowerBoundSettings = SETTINGS
) -> float:
    """Numerical lower bound of the norm that controllers reach, where a controller is known that nearly reaches it.

    Unlike those of the Riccati equations the program has its optimum for plants without noise or weights, too. Rounding
    may end it elsewhere, so it counts only where two runs agree and nearly reach the `value` of a loop.

    Returns
    -------
    float
        Minus infinity where no attempt ends near to the value, and for too many states.
    """
    problem = _problem(as_system(plant), measured, commanded, settings)
    if problem is None:
        return -np.inf
    ratios: list[float] = []
    for scale, centred in zip(settings.scales, settings.centred):
        working = _Working.of(problem, scale * value)
        program = _program(working.halves, [half.kernel for half in working.halves], (True, True))
        squares = [float(v[-1]) for v, _ in iterates(*program, centred)]
        ratio = scale * float(np.sqrt(max(squares[-1], 0.0))) if squares else 0.0
        if abs(ratio - 1.0) > settings.confirmed:
            continue
        if any(abs(ratio - other) <= settings.accuracy for other in ratios):
            return float(min(*ratios, ratio, 1.0) * (1.0 - settings.accuracy) * value)
        ratios.append(ratio)
    return -np.inf


def _problem(system: System, measured: Names, commanded: Names, settings: LowerBoundSettings) -> LowerBoundProof | None:
    """A proof without vectors; None for too many states."""
    ports = standard_plant(system, measured, commanded)
    if system.order > settings.most_states:
        return None
    rows, columns = (
        tuple(map(int, places([p.name for p in group])))
        for places, group in ((system.output_indices, ports.measured), (system.input_indices, ports.commanded))
    )
    none = [np.zeros((0, 0))] * 10
    claim = LowerBoundProof(0.0, *system.matrices, rows, columns, float(system.dt), *none)
    undisturbed = [
        undisturbed_states(A, B, seen, claim.dt, marginal=settings.marginal) for A, B, _, _, seen in _sides(claim)
    ]
    # what a sampled plant measures without noise may change until the next sample: sums of squares, not zero
    combinations = [
        np.zeros((0, len(seen))) if claim.dt else noiseless_combinations(A, B, seen, states)
        for (A, B, _, _, seen), states in zip(_sides(claim), undisturbed)
    ]
    halves = [_Half.of(side, *rows) for side, *rows in zip(_sides(claim), undisturbed, combinations)]
    decaying, adjoint = (half.decaying_modes(claim.dt, settings.marginal) for half in halves)
    noiseless, weightless = combinations
    return replace(
        claim,
        noiseless=noiseless,
        weightless=weightless,
        decaying=decaying,
        decaying_adjoint=adjoint,
        undisturbed=undisturbed[0],
        undisturbed_adjoint=undisturbed[1],
    )


@dataclass(frozen=True)
class _Half:
    """Motion that a controller does not see: ``rate = A x + B w, z = C x + D w`` for (x, w) in the kernel of `seen`.

    Columns of `basis`, orthonormal, are all x that can be other than zero there.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    seen: FloatArray
    basis: FloatArray

    @classmethod
    def of(
        cls, side: Side, undisturbed: FloatArray, combinations: FloatArray, decaying: FloatArray | None = None
    ) -> _Half:
        """With undisturbed states, rates of measurements without noise, and decaying modes among what is seen."""
        A, B, C, D, seen = side
        states, rows = (part.astype(float) for part in exact_constraints(A, B, seen, undisturbed, combinations))
        if decaying is not None:
            states, rows = np.vstack([states, decaying]), np.vstack([rows, np.pad(decaying, ((0, 0), (0, B.shape[1])))])
        return cls(A, B, C, D, rows, _null_space(states))

    def decaying_modes(self, dt: float, marginal: float) -> FloatArray:
        """Rows on x of the stable modes that no w reaches, where it reaches none: sums S are not positive there."""
        kernel, n = self.kernel, len(self.A)
        x = kernel[:n]
        if not x.size or x.shape[1] != self.basis.shape[1] or linalg.null_space(x).size:
            return np.zeros((0, n))
        coordinates = linalg.pinv(x)
        F = coordinates @ (self.A @ x + self.B @ kernel[n:])
        ends = marginal * float(np.abs(F).max(initial=0.0))
        _, Q, count = linalg.schur(
            F.T, sort=(lambda re, im: np.hypot(re, im) < 1.0) if dt else lambda re, im: re < ends
        )
        return np.asarray(Q[:, :count].T @ coordinates) if 0 < count < len(F) else np.zeros((0, n))

    @property
    def kernel(self) -> FloatArray:
        """Orthonormal (x, w) as columns."""
        return _null_space(self.seen)

    @property
    def confined(self) -> bool:
        """Some of the states is zero in all of the kernel: sums of its rates are zero there, not definite."""
        states = self.basis.T @ self.kernel[: len(self.A)]
        return len(states) > 0 and (not states.size or linalg.null_space(states.T).size > 0)

    def signals(self, vectors: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """States and their rates in coordinates of the basis, w and z."""
        x, w = vectors[: len(self.A)], vectors[len(self.A) :]
        return self.basis.T @ x, self.basis.T @ (self.A @ x + self.B @ w), w, self.C @ x + self.D @ w


def _null_space(matrix: FloatArray) -> FloatArray:
    """Orthonormal columns that it maps to zero, for rows of any size."""
    if not len(matrix):
        return np.eye(matrix.shape[1])
    sizes = np.asarray(linalg.norm(matrix, axis=1, keepdims=True))
    return np.asarray(linalg.null_space(matrix / np.where(sizes > 0.0, sizes, 1.0)))


def _sides(plant: LowerBoundProof) -> tuple[Side, Side]:
    """A, B, C, D and what is seen, of the plant without its controller and of its adjoint."""
    y, u = list(plant.measured), list(plant.commanded)
    z, w = ([k for k in range(size) if k not in used] for size, used in zip(plant.D.shape, (y, u)))
    A, B, C, D = plant.A, plant.B[:, w], plant.C[z], plant.D[np.ix_(z, w)]
    seen = np.hstack([plant.C[y], plant.D[np.ix_(y, w)]])
    moved = np.hstack([plant.B[:, u].T, plant.D[np.ix_(z, u)].T])
    return (A, B, C, D, seen), (A.T, C.T, B.T, D.T, moved)


@dataclass(frozen=True)
class _Working:
    """The plant in continuous time, in balanced units of its states, its errors over a level.

    Vectors of a sampled plant are ``x = (A + I)^-1 (2 xi - B w)`` where xi are those of its bilinear image, whose S is
    the same up to a factor.
    """

    given: LowerBoundProof
    given_halves: tuple[_Half, ...]
    halves: tuple[_Half, ...]
    units: FloatArray
    level: float

    @classmethod
    def of(cls, claim: LowerBoundProof, level: float = 1.0) -> _Working:
        """Raises a ValueError for a sampled plant with a pole at -1, which has no image."""
        A, B, C, D = claim.A, claim.B, claim.C, claim.D
        if claim.dt:
            A, B, C, D = to_continuous(A, B, C, D, claim.dt)
        one = np.eye(len(A))
        units = np.diag(balanced(A, one, one)[2]) if len(A) else np.zeros(0)
        scale = np.array([1.0 if k in claim.measured else 1.0 / level for k in range(len(D))])[:, None]
        A, B, C = balanced(A, B, C)
        kept = (
            (claim.undisturbed, claim.noiseless, claim.decaying),
            (claim.undisturbed_adjoint, claim.weightless, claim.decaying_adjoint),
        )
        halves = tuple(_Half.of(side, *rows) for side, rows in zip(_sides(claim), kept))
        this = cls(claim, halves, (), units, level)
        maps = this.vectors(*(np.eye(half.seen.shape[1]) for half in halves))
        sides = [
            _Half(*side[:4], half.seen @ part, np.asarray(linalg.qr(half.basis / unit[:, None], mode="economic")[0]))
            for side, half, part, unit in zip(
                _sides(replace(claim, A=A, B=B, C=scale * C, D=scale * D)), halves, maps, (units, 1.0 / units)
            )
        ]
        return replace(this, halves=tuple(sides))

    def vectors(self, unseen: FloatArray, unmoved: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Those of the given plant that belong to those of this one."""
        n = len(self.units)
        (x, w), (p, q) = ((v[:n], v[n:] / self.level) for v in (unseen, unmoved))
        x, p = self.units[:, None] * x / self.level, p / self.units[:, None]
        if self.given.dt:
            one, (first, adjoint) = np.eye(n), self.given_halves
            x = linalg.solve(first.A + one, 2.0 * x - first.B @ w)
            p = linalg.solve(adjoint.A + one, 2.0 / self.given.dt * p - adjoint.B @ q)
        return np.vstack([x, w]), np.vstack([p, q])

    def claimed(self, unseen: FloatArray, unmoved: FloatArray, below: float) -> LowerBoundProof | None:
        """The proof with the best coupling and level of vectors, less a part of both; None where there is none.

        ``[S, T; T', R] >= 0`` holds for ``T = -L K M'`` with ``S = L L', R = M M'`` and any K of norm one; the polar
        factor of ``L' M`` makes ``-trace(T)`` the sum of its singular values, which is the most.
        """
        sums, squares = [], np.zeros(2)
        for half, vectors in zip(self.given_halves, (unseen, unmoved)):
            x, rate, w, z = half.signals(vectors)
            product = rate @ x.T
            sums.append(rate @ rate.T - x @ x.T if self.given.dt else product + product.T)
            squares += float(np.sum(z**2)), float(np.sum(w**2))
        P: FloatArray = np.zeros((len(self.units), 0))
        Q = P
        present = [len(part.T) > 0 for part in (unseen, unmoved)]
        try:
            roots = [half.basis @ lower_factor(S) for half, S, kept in zip(self.given_halves, sums, present) if kept]
        except linalg.LinAlgError:
            return None
        if all(present):
            L, M = roots
            U, _, V = linalg.svd(L.T @ M, full_matrices=False)
            P, Q = -(1.0 - below) * L @ (U @ V), M
        trace, (gained, spent) = float(np.sum(P * Q)), squares
        root = trace**2 + spent * gained
        if not (spent > 0.0 and root > 0.0):
            return None
        level = float((1.0 - below) * (np.sqrt(root) - trace) / spent)
        return replace(self.given, unseen=unseen, unmoved=unmoved, left=P, right=Q, level=level)


def _best(
    working: _Working, sides: Sides, centred: float, settings: LowerBoundSettings
) -> tuple[LowerBoundProof | None, float]:
    """The proof with the highest level that the check accepts, and the optimum of the program."""
    plant, adjoint = working.halves
    kernels = [half.kernel if used else np.zeros((len(half.kernel), 0)) for half, used in zip(working.halves, sides)]
    c, inequalities = _program(working.halves, kernels, sides)
    n, m, second = plant.basis.shape[1], adjoint.basis.shape[1], kernels[1].shape[1]
    proofs, optimum = [], np.inf
    for v, dual in iterates(c, inequalities, centred):
        if v[-1] > 0.0:
            W = dual[2]
            unseen = _met(plant, kernels[0] @ _root(dual[0]), W[:n, :n])
            unmoved = _met(adjoint, kernels[1] @ _root(dual[1][:second, :second]), W[len(W) - m :, len(W) - m :])
            root = np.sqrt(v[-1])
            optimum = working.level * float(root)
            proof = working.claimed(*working.vectors(unseen, unmoved / root), 0.0)
            if proof is not None:
                proofs.append(proof)
    best: LowerBoundProof | None = None
    for proof in sorted(proofs, key=lambda one: -one.level)[: settings.claimed]:
        for below in settings.below:
            if best is not None and (1.0 - below) * proof.level <= best.level:
                break
            claimed = working.claimed(proof.unseen, proof.unmoved, below)
            if claimed is not None:
                with suppress(ProofError):
                    check_lower_bound(claimed)
                    best = claimed
                    break
    return best, optimum


def _met(half: _Half, V: FloatArray, wanted: FloatArray) -> FloatArray:
    """Combinations of vectors, near to the given ones, whose sum S is the one that is wanted but for rounding.

    In the iterates it is so up to the error of a system of equations that is nearly singular at the optimum. Here it is
    met by the least change of the unit matrix in ``V I V'``.
    """
    k, n = V.shape[1], len(wanted)
    if not k or not n:
        return V
    x, rate, *_ = half.signals(V)
    basis, rows = _symmetric_basis(k), _symmetric_basis(n).reshape(-1, n * n)
    product = rate @ basis @ x.T
    equations = rows @ (product + product.transpose(0, 2, 1)).reshape(len(basis), -1).T
    missing = rows @ (wanted - rate @ x.T - x @ rate.T).ravel()
    change = np.asarray(linalg.lstsq(equations, missing)[0])
    return np.asarray(V @ _root(np.eye(k) + np.tensordot(change, basis, 1)))


def _program(
    halves: tuple[_Half, ...], kernels: list[FloatArray], sides: Sides
) -> tuple[FloatArray, list[MatrixInequality]]:
    """Objective and inequalities in X, Y (of the sides that are used) and g^2."""
    side, adjoint = halves
    n, m = (half.basis.shape[1] for half in halves)
    bases = _symmetric_basis(n), _symmetric_basis(m)
    sizes = [len(basis) if used else 0 for basis, used in zip(bases, sides)]
    states = [size if used else 0 for size, used in zip((n, m), sides)]
    (P, Q, W, Z), (p, r, q, v) = (half.signals(kernel) for half, kernel in zip(halves, kernels))
    first, second, nw, count = P.shape[1], p.shape[1], len(v), sum(sizes) + 1
    forms = [np.zeros((count, size, size)) for size in (first, second + nw, sum(states))]
    constants = [-Z.T @ Z, np.block([[q.T @ q, v.T], [v, np.zeros((nw, nw))]]), np.zeros((sum(states),) * 2)]
    forms[0][-1] = W.T @ W
    forms[1][-1, second:, second:] = np.eye(nw)
    if sides[0]:
        product = Q.T @ bases[0] @ P
        forms[0][: sizes[0]] = -product - product.transpose(0, 2, 1)
        forms[2][: sizes[0], :n, :n] = bases[0]
    if sides[1]:
        product = r.T @ bases[1] @ p
        forms[1][sizes[0] : -1, :second, :second] = -product - product.transpose(0, 2, 1)
        forms[2][sizes[0] : -1, states[0] :, states[0] :] = bases[1]
    if all(sides):
        constants[2][:n, n:] = side.basis.T @ adjoint.basis
        constants[2][n:, :n] = adjoint.basis.T @ side.basis
    return np.eye(count)[-1], [MatrixInequality(C, F) for C, F in zip(constants, forms)]


def _symmetric_basis(n: int) -> FloatArray:
    """Orthonormal symmetric matrices (n (n + 1) / 2, n, n)."""
    basis = np.zeros((n * (n + 1) // 2, n, n))
    for k, (i, j) in enumerate(zip(*np.tril_indices(n))):
        basis[k, i, j] = basis[k, j, i] = 1.0 if i == j else np.sqrt(0.5)
    return basis


def _root(matrix: FloatArray) -> FloatArray:
    """V with ``V V'`` equal to a positive semidefinite matrix."""
    values, vectors = linalg.eigh(matrix) if len(matrix) else (np.zeros(0), np.zeros((0, 0)))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
