"""Check of a proof of a sampled loop: its gain over a box of parameters and a band of frequencies.

A strip of the proof is a box of the parameters with scalings D > 0 and G at some frequencies, its nodes; between two
nodes they are interpolated linearly, which keeps D > 0. With them the sum ::

    f (s^2 e* e / level^2 - d* W^-2 d) + sum 2 Re (first* D second) + 2 Re (z* j G w)

must be negative definite at *every* frequency of the strip. ``first`` and ``second`` are ``w - low z`` and ``high z -
w`` of a parameter in [low, high], so that their term is not negative for ``w = delta z``, and the last term is zero;
what is left bounds the gain, and shows that no pole is on the axis. An angle theta has ``w cos(a/2) - z sin(a/2)`` and
``z sin(b/2) - w cos(b/2)`` with ``w = tan(theta/2) z``. Between the nodes all functions of the frequency are
polynomials with bounded remainders (:mod:`lftkit.proofs.sampled_loop.polynomials`): nothing is taken from a grid.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg

from lftkit.arrays import ComplexArray, FloatArray, Matrices
from lftkit.proofs.sampled_loop.above import windows_above
from lftkit.proofs.sampled_loop.model import LoopModel
from lftkit.proofs.sampled_loop.nominal import nominal_windows, whole_axis
from lftkit.proofs.sampled_loop.polynomials import ORDER, UNIT, Polynomial, constant, stacked
from lftkit.proofs.sampled_loop.premises import require_premises
from lftkit.proofs.sampled_loop.proof import LoopProof
from lftkit.proofs.strips import Interval, Strip
from lftkit.proofs.verdict import ProofError, uncovered

if TYPE_CHECKING:
    from lftkit.proofs.sampled_loop.responses import Responses

PIECES = 4
"""Parts of a window in which the inequality is checked one after the other."""
DEEPEST = 30
"""Most bisections of the frequencies between two nodes."""
TRIG = 4.0 * UNIT
"""Relative error of sine and cosine."""


@dataclass(frozen=True)
class CheckedLoop:
    """What a proof that passed guarantees."""

    level: float
    names: tuple[str, ...]
    box: tuple[Interval, ...]
    band: Interval
    strips: int
    windows: int
    about: dict[str, Any]
    stable: bool
    """Every member of the loop of the file: the band is the whole one up to half of the sampling rate, the nominal loop
    was proven stable, and no pole crosses the axis above.
    """
    stable_below: float
    """No pole crosses the axis up to this frequency [rad/s] and the nominal loop was proven stable: infinite if
    `stable`, zero if nothing was proven of stability.
    """


def ends_of(angle: bool, low: float, high: float) -> tuple[float, float, float, float]:
    """(ca, sa, cb, sb) of ``first = ca w - sa z`` and ``second = sb z - cb w``."""
    if not angle:
        return 1.0, low, 1.0, high
    return math.cos(0.5 * low), math.sin(0.5 * low), math.cos(0.5 * high), math.sin(0.5 * high)


def coordinates(model: Responses, strip: Strip, number: int, omega: float, level: float) -> ComplexArray:
    """(w, d) by coordinates in which the form is about -I at a frequency. Any others would do, less well."""
    q, d = model.sizes[0], model.sizes[3]
    z, e = model.at(omega)
    weight, amplitude = model.amplitudes(omega)
    share = (omega - strip.nodes[number]) / (strip.nodes[number + 1] - strip.nodes[number])

    def between(values: ComplexArray | FloatArray) -> Any:
        return values[number] + share * (values[number + 1] - values[number])

    w = np.eye(q, q + d)
    half = np.zeros((q + d, q + d), complex)
    for k, group in enumerate(map(list, model.groups)):
        ca, sa, cb, sb = ends_of(model.angle[k], *strip.box[k])
        first, second = ca * w[group] - sa * z[group], sb * z[group] - cb * w[group]
        half += (
            first.conj().T @ between(strip.D[k]) @ second + z[group].conj().T @ (1j * between(strip.G[k])) @ w[group]
        )
    form = half + half.conj().T + between(strip.factor) * (weight / level) ** 2 * e.conj().T @ e
    form[q:, q:] -= between(strip.factor) * np.diag(amplitude**-2.0)
    V = _middle(model, strip.box, z)
    scale = 1.0 / np.concatenate([np.ones(q), 1.0 / amplitude])
    for _ in range(2):
        middle = -(V.conj().T @ form @ V)
        size = np.abs(np.diag(middle)) ** -0.5
        factor, info = linalg.lapack.zpotrf(middle * size[:, None] * size, lower=0)
        if info:
            return np.asarray(V * scale)
        V = np.asarray(linalg.solve_triangular(factor, (V * size).T, trans=1).T)
    return V


def _middle(model: Responses, box: Sequence[Interval], z: ComplexArray) -> ComplexArray:
    """(w, d) by (deviation of w from the middle of the box, d)."""
    q, d = model.sizes[0], model.sizes[3]
    cz, sz, cw, sw = middle_of(model, box)
    right = np.hstack([z[:, :q] * sw - np.diag(sz), z[:, q:]])
    inner = linalg.solve(np.diag(cz) - z[:, :q] * cw, right)
    w = cw[:, None] * inner
    w[:, :q] += np.diag(sw)
    return np.vstack([w, np.hstack([np.zeros((d, q)), np.eye(d)])])


def middle_of(model: Responses, box: Sequence[Interval]) -> Matrices:
    """Of each channel ``z = cz z' + sz w'`` and ``w = cw z' + sw w'`` with w' = 0 in the middle, +-z' at the ends."""
    q = model.sizes[0]
    cz, sz, cw, sw = np.ones(q), np.zeros(q), np.zeros(q), np.zeros(q)
    for group, angle, (low, high) in zip(map(list, model.groups), model.angle, box):
        at, width = 0.5 * (low + high), 0.5 * (high - low)
        cw[group], sw[group] = at, width
        if angle and is_circle(low, high):
            cw[group], sw[group] = 0.0, 1.0
        elif angle:
            t = math.tan(0.5 * width)
            cz[group], sz[group] = math.cos(0.5 * at), -t * math.sin(0.5 * at)
            cw[group], sw[group] = math.sin(0.5 * at), t * math.cos(0.5 * at)
    return cz, sz, cw, sw


def is_circle(low: float, high: float) -> bool:
    """Whether an interval of an angle is treated as any angle, with D = 0."""
    return high - low > 6.28


def inequality(model: Responses, strip: Strip, number: int, low: float, high: float, level: float) -> Polynomial:
    """The quadratic form over [low, high], between the nodes `number` and `number` + 1, in its coordinates."""
    q = model.sizes[0]
    middle, half = 0.5 * (low + high), 0.5 * (high - low) * (1.0 + 4.0 * UNIT) + 4.0 * UNIT * high
    V = coordinates(model, strip, number, middle, level)
    z, e = model.responses(middle, half, V)
    w, disturbances = constant(V[:q]), constant(V[q:])
    output, inputs = model.performance(middle, half)
    start, length = strip.nodes[number], strip.nodes[number + 1] - strip.nodes[number]
    share = Polynomial(
        np.array([[(middle - start) / length], [half / length]], dtype=complex), np.array([8.0 * UNIT * high / length])
    )

    def between(values: ComplexArray) -> Polynomial:
        return constant(values[number]) + constant(values[number + 1] - values[number], 2.0 * UNIT) * share

    firsts, seconds = [], []
    D, G = (np.zeros((number + 2, q, q), complex) for _ in range(2))
    for k, (group, angle, ends) in enumerate(zip(map(list, model.groups), model.angle, strip.box)):
        zk, wk = z.rows(group), w.rows(group)
        ca, sa, cb, sb = (constant(value, TRIG) for value in ends_of(angle, *ends))
        firsts.append(ca * wk - sa * zk)
        seconds.append(sb * zk - cb * wk)
        block = np.ix_(range(number, number + 2), group, group)
        D[block], G[block] = strip.D[k][number : number + 2], strip.G[k][number : number + 2]
    back = np.argsort([channel for group in model.groups for channel in group]).tolist()
    first, second = stacked(firsts).rows(back), stacked(seconds).rows(back)
    half_form = first.adjoint() @ (between(D) @ second) + z.adjoint() @ (between(1j * G) @ w)
    error = e.adjoint() @ e * (output * constant(level**-2.0, 4.0 * UNIT))
    allowed = disturbances.adjoint() @ (inputs[:, None] * disturbances)
    factor = between(strip.factor[:, None].astype(complex))
    return half_form + half_form.adjoint() + (error - allowed) * factor


def negative(form: Polynomial) -> bool:
    """Whether a Hermitian polynomial is certainly negative definite for all t in [-1, 1]."""
    if not (np.all(np.isfinite(form.c)) and np.all(np.isfinite(form.rad))):
        return False
    ends = np.linspace(-1.0, 1.0, PIECES + 1)
    for left, right in itertools.pairwise(ends):
        at, width = 0.5 * (left + right), 0.5 * (right - left)
        shifted = [
            -sum(math.comb(j, k) * at ** (j - k) * form.c[j] for j in range(k, ORDER + 1)) * width**k
            for k in range(ORDER + 1)
        ]
        rest = form.rad + sum(np.abs(part) for part in shifted[2:]) + 64.0 * UNIT * np.abs(form.c).sum(axis=0)
        if not all(positive(shifted[0] + sign * shifted[1], rest) for sign in (-1.0, 1.0)):
            return False
    return True


def positive(matrix: ComplexArray, rest: FloatArray) -> bool:
    """Whether the Hermitian part, less anything whose entries are below `rest`, is positive definite (Rump 2006)."""
    middle, n = 0.5 * (matrix + matrix.conj().T), len(matrix)
    k = 8.0 * (n + 4) * UNIT
    off = float(np.maximum(rest, rest.T).sum(axis=1).max(initial=0.0))
    bound = (1.0 + 1e-6) * (k / (1.0 - k) * float(np.trace(middle).real) + off)
    return bool(linalg.lapack.zpotrf(middle - bound * np.eye(n), lower=1)[1] == 0)


def windows_of(model: Responses, strip: Strip, number: int, level: float, deepest: int = DEEPEST) -> int:
    """Windows between two nodes in which the inequality was verified, after bisections; 0 if it was not."""
    waiting, done = [(float(strip.nodes[number]), float(strip.nodes[number + 1]), 0)], 0
    while waiting:
        low, high, depth = waiting.pop()
        try:
            if negative(inequality(model, strip, number, low, high, level)):
                done += 1
                continue
        except (ArithmeticError, linalg.LinAlgError):
            pass
        if depth == deepest:
            return 0
        middle = 0.5 * (low + high)
        waiting += [(middle, high, depth + 1), (low, middle, depth + 1)]
    return done


def scalings_allowed(strip: Strip, angle: Sequence[bool]) -> bool:
    """Whether every D is positive definite (zero for any angle), D and G are Hermitian, factors positive."""
    for k, circle in enumerate(a and is_circle(*ends) for a, ends in zip(angle, strip.box)):
        D, G = strip.D[k], strip.G[k]
        for matrix in (D, G):
            if not (np.all(np.isfinite(matrix)) and np.array_equal(matrix, matrix.conj().swapaxes(1, 2))):
                return False
        if circle and np.any(D):
            return False
        if not circle and not (
            np.all(np.any(D, axis=(1, 2))) and all(positive(d / np.abs(d).max(), 0.0 * abs(d)) for d in D)
        ):
            return False
    return bool(np.all(np.isfinite(strip.factor)) and np.all(strip.factor > 0.0))


def covered(proof: LoopProof) -> None:
    """Whether the strips cover box and band; a ProofError names a hole."""
    require_cover(proof.strips, proof.box, proof.band, "rad/s")


def require_cover(strips: Sequence[Strip], box: Sequence[Interval], band: Interval, unit: str) -> None:
    """Whether strips cover a box and a band of their variable, whose unit is named; a ProofError names a hole."""
    spans = [(float(strip.nodes[0]), float(strip.nodes[-1])) for strip in strips]
    cuts = sorted({*band, *(at for span in spans for at in span)})
    for low, high in itertools.pairwise(cuts):
        if high <= band[0] or low >= band[1]:
            continue
        boxes = [list(s.box) for s, span in zip(strips, spans) if span[0] <= low and span[1] >= high]
        hole = uncovered(list(box), boxes)
        if hole is not None:
            raise ProofError(f"the strips must cover the box, got a hole at {hole} from {low} to {high} {unit}")


def check_strip(item: tuple[Responses, Strip, float]) -> int | str:
    """Number of windows in which the inequality of a strip was verified, or why the strip is refused."""
    model, strip, level = item
    if not scalings_allowed(strip, model.angle):
        return "scalings must be Hermitian, D positive definite and factors positive"
    windows = 0
    for number in range(len(strip.nodes) - 1):
        count = windows_of(model, strip, number, level)
        if not count:
            low, high = strip.nodes[number : number + 2]
            return f"the inequality must hold beyond rounding, got no margin from {low:.9g} to {high:.9g} rad/s"
        windows += count
    return windows


def check_loop_proof(
    proof: LoopProof, each: Callable[..., Iterable[int | str]] = map, stability: bool = True
) -> CheckedLoop:
    """Verify a proof of a loop; a ProofError says why it is refused.

    Parameters
    ----------
    proof : LoopProof
    each : callable
        Maps a function over the strips; they may be checked in several processes.
    stability : bool
        Whether stability is looked at, too; without it the result says that nothing was proven of it.
    """
    try:
        return _checked(proof, each, stability)
    except (KeyError, TypeError, ValueError, IndexError, ArithmeticError, AttributeError, RecursionError) as error:
        known = isinstance(error, ProofError)
        raise ProofError(str(error) if known else f"the file must be a proof of a loop, got {error!r}") from None


def _checked(proof: LoopProof, each: Callable[..., Iterable[int | str]], stability: bool) -> CheckedLoop:
    model, band = proof.model, proof.band
    require_premises(proof)
    covered(proof)
    windows = 0
    for number, outcome in enumerate(each(check_strip, [(model, strip, proof.level) for strip in proof.strips])):
        if isinstance(outcome, str):
            raise ProofError(f"strip {number}: {outcome}")
        windows += outcome
    below = stable_below(model, band, proof.box) if stability else 0.0
    about, stable = dict(proof.about), math.isinf(below)
    return CheckedLoop(proof.level, proof.names, proof.box, band, len(proof.strips), windows, about, stable, below)


def stable_below(model: LoopModel, band: Interval, box: tuple[Interval, ...]) -> float:
    """Frequency [rad/s] up to which no pole of a member crosses the axis, if its gain is bounded over `band`.

    Poles move continuously with the parameters. Infinite if every member was proven stable; half of the sampling rate
    if the nominal loop is, but poles may cross above; zero if that was not proven or the band is a part.
    """
    if not (whole_axis(band, model.dt) and nominal_windows(model)):
        return 0.0
    return math.inf if windows_above(model, box) else math.pi / model.dt
