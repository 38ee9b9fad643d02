"""A second check of cells of proofs, in interval arithmetic of mpmath: nothing of the checker's arithmetic is used.

The inequality of a cell (part of a strip between two nodes) is written down anew from its definition, for an interval
of frequencies at a time, with 40 digits and every rounding outwards. In coordinates in which it is about -I all its row
sums, with I added, have to be below 1.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from mpmath import iv, mp, mpf

from lftkit import Port, RealParameter, SampledSystem, System
from lftkit.proofs.sampled_loop import LoopModel, LoopProof, check_loop_proof, loop_model, prove_level
from lftkit.proofs.sampled_loop.model import coordinates
from lftkit.proofs.trusted.arithmetic import UNIT
from lftkit.proofs.trusted.proof import Strip

DT, DIGITS = 0.01, 40
Matrix = Any
"""An array of intervals."""
DEEPEST = 12
BOX = ((-0.2, 0.3), (-0.3, 0.3))
BAND = (0.3, 40.0)


def model() -> LoopModel:
    """A mode with uncertain stiffness and an angle, sampled velocity feedback with a hold, weighted error and force."""
    k, a = RealParameter("k", 1.0, 0.8, 1.3), RealParameter("a", 0.0, -0.2, 0.2)
    A = [[0.0, 1.0], [-1.0, -0.1]]
    B = [[0.0, 0.0, 0.0, 0.0], [-1.0, 0.2, 1.0, 1.0]]
    C = [[1.0, 0.0], [0.3, 0.1], [0.0, 1.0], [1.0, 0.0]]
    inputs, outputs = (Port("force", 1), Port("u", 1)), (Port("v", 1), Port("x", 1))
    plant = System(A, B, C, np.zeros((4, 4)), inputs, outputs, channels=("k", "a"), elements=(k, a))
    law = SampledSystem([[0.8]], [[0.2]], [[-6.0]], [[0.1]], (Port("v", 1),), (Port("u", 1),), dt=DT, name="law")
    own = loop_model(plant, DT, law, commands=["u"], measurements=["v"], frames=[3])
    weights = np.array([[0.5, 2.0, 20.0]])
    return dataclasses.replace(own, angle=(False, True), weights=weights, window=0.02, scale=0.05)


@pytest.fixture(scope="module")
def proof() -> LoopProof:
    own = model()
    found = prove_level(own, BOX, BAND, 2.0)
    assert not found.uncovered
    return LoopProof(own, ("k", "a"), BOX, BAND, 2.0, tuple(found.strips))


def matrix(values: Any) -> Matrix:
    """Doubles as intervals of no width."""
    given = np.atleast_2d(np.asarray(values, complex))
    found = np.empty(given.shape, object)
    for place, number in np.ndenumerate(given):
        found[place] = iv.mpc(iv.mpf(number.real), iv.mpf(number.imag))
    return found


def adjoint(a: Matrix) -> Matrix:
    return np.frompyfunc(lambda x: iv.mpc(x.real, -x.imag), 1, 1)(a.T)


def exponential(re: Any, im: Any) -> Any:
    size = iv.exp(re)
    return iv.mpc(size * iv.cos(im), size * iv.sin(im))


def responses(own: LoopModel, omega: Any) -> tuple[Matrix, Matrix]:
    """``z`` and the bounded error by (w, d); one command."""
    q, y, _, d, _ = own.sizes
    dt, j = iv.mpf(own.dt), iv.mpc(0, 1)
    z = exponential(iv.mpf(0), omega * dt)
    poles = matrix(own.poles)[0]
    phi = 1 / (poles * -1 + j * omega)
    flow = np.frompyfunc(lambda p: exponential(p.real * dt, p.imag * dt), 1, 1)(poles)
    held = (flow - 1) / poles / (flow * -1 + z)
    B, C, D = matrix(own.B), matrix(own.C), matrix(own.D)
    own_part = (C * phi) @ B[:, : q + d] + D[:, : q + d]
    seen = (C[q:] * held) @ B[:, q + d :] + D[q:, q + d :]
    felt = ((C[:q] * phi) @ B[:, q + d :] + D[:q, q + d :]) * ((1 - 1 / z) / (j * omega * dt))
    frame = sum((z ** (-n) for n in range(int(own.frame[0]))), iv.mpc(0)) / int(own.frame[0])
    law = (matrix(own.K_C) / (matrix(own.K_poles) * -1 + z)) @ matrix(own.K_B) + matrix(own.K_D)
    K = law * (frame / z)
    u = K @ own_part[q : q + y] * (1 / (1 - K[0, 0] * seen[0, 0]))
    return own_part[:q] + felt @ u, own_part[q + y :] + seen[y:] @ u


def form(own: LoopModel, strip: Strip, number: int, omega: Any, level: float) -> Matrix:
    """The quadratic form of a cell in (w, d)."""
    q, d = own.sizes[0], own.sizes[3]
    z, e = responses(own, omega)
    w = matrix(np.eye(q, q + d))
    first, last = (iv.mpf(float(node)) for node in strip.nodes[number : number + 2])
    share = (omega - first) / (last - first)

    def between(values: Any) -> Matrix:
        return matrix(values[number]) * (1 - share) + matrix(values[number + 1]) * share

    half = matrix(np.zeros((q + d, q + d)))
    for k, group in enumerate(own.groups):
        zk, wk = z[list(group)], w[list(group)]
        low, high = (iv.mpf(value) for value in strip.box[k])
        ca, sa, cb, sb = (iv.mpf(1), low, iv.mpf(1), high)
        if own.angle[k]:
            ca, sa, cb, sb = iv.cos(low / 2), iv.sin(low / 2), iv.cos(high / 2), iv.sin(high / 2)
        half = half + adjoint(wk * ca - zk * sa) @ between(strip.D[k]) @ (zk * sb - wk * cb)
        half = half + adjoint(zk) @ (between(strip.G[k]) * iv.mpc(0, 1)) @ wk
    factor = between(strip.factor[:, None, None])[0, 0]
    x = iv.mpc(0, 1) * omega * iv.mpf(own.window)
    weight = x * (x + iv.sqrt(iv.mpf(12))) / (x**2 + 6 * x + 12)
    size = (weight.real**2 + weight.imag**2) / (iv.mpf(own.scale) * iv.mpf(level)) ** 2
    whole = half + adjoint(half) + adjoint(e) @ e * (factor * size)
    for k, (a, zero, pole) in enumerate(own.weights):
        amplitude = (omega**2 + iv.mpf(pole) ** 2) / ((omega**2 + iv.mpf(zero) ** 2) * iv.mpf(a) ** 2)
        whole[q + k, q + k] = whole[q + k, q + k] - factor * amplitude
    return whole


def negative(own: LoopModel, strip: Strip, number: int, ends: tuple[float, float], level: float) -> bool:
    """Whether the form is negative definite at all frequencies from one double to another one."""
    low, high = ends
    V = matrix(coordinates(own, strip, number, 0.5 * (low + high), level))
    found = adjoint(V) @ form(own, strip, number, iv.mpf([low, high]), level) @ V + matrix(np.eye(len(V)))
    return all(sum((abs(entry) for entry in row), iv.mpf(0)).b < 1 for row in found)


def verified(own: LoopModel, strip: Strip, number: int, level: float) -> bool:
    """Whether the form is negative definite between two nodes, after bisections."""
    waiting = [(float(strip.nodes[number]), float(strip.nodes[number + 1]), 0)]
    while waiting:
        low, high, depth = waiting.pop()
        if negative(own, strip, number, (low, high), level):
            continue
        if depth == DEEPEST:
            return False
        at = 0.5 * (low + high)
        waiting += [(low, at, depth + 1), (at, high, depth + 1)]
    return True


@pytest.fixture(autouse=True)
def digits() -> Any:
    before, iv.dps = iv.dps, DIGITS
    yield
    iv.dps = before


def cells(proof: LoopProof, count: int) -> list[tuple[Strip, int]]:
    every = [(strip, number) for strip in proof.strips for number in range(len(strip.nodes) - 1)]
    return [every[k] for k in np.unique(np.linspace(0, len(every) - 1, count).astype(int))]


@pytest.mark.further
@pytest.mark.parametrize("count", [2, pytest.param(9, marks=pytest.mark.slow)])
def test_cells_that_the_checker_accepts_hold_in_interval_arithmetic(proof: LoopProof, count: int) -> None:
    assert check_loop_proof(proof).level == proof.level
    for strip, number in cells(proof, count):
        assert verified(proof.model, strip, number, proof.level)


@pytest.mark.further
def test_a_level_that_is_exceeded_does_not_hold_in_it(proof: LoopProof) -> None:
    """At the frequency of the worst case, for the gain of a member there."""
    from lftkit.proofs.sampled_loop.bounds import member_gains

    omega = np.linspace(0.85, 0.95, 21)
    gains = [
        float(member_gains(proof.model, float(w), np.array([[-0.2, a] for a in (-0.3, 0.0, 0.3)])).max()) for w in omega
    ]
    worst = float(omega[int(np.argmax(gains))])
    strip, number = next(
        (s, int(np.searchsorted(s.nodes, worst)) - 1) for s in proof.strips if s.nodes[0] < worst < s.nodes[-1]
    )
    assert not negative(proof.model, strip, number, (worst, worst), 0.99 * max(gains))


def test_functions_of_the_library_keep_the_errors_that_the_checker_grants_them() -> None:
    """Complex exp and expm1, sine, cosine and tangent of doubles, against 60 digits."""
    rng = np.random.default_rng(2)
    with mp.workdps(60):
        for x in rng.uniform(-40.0, 40.0, 400):
            granted = 4.0 * UNIT * (2.0 + abs(x))
            assert abs(mp.mpc(complex(np.exp(1j * x))) - mp.expj(mpf(float(x)))) < granted
            for ours, theirs in ((math.sin, mp.sin), (math.cos, mp.cos)):
                assert abs(mpf(ours(float(x))) - theirs(mpf(float(x)))) <= 4.0 * UNIT * abs(theirs(mpf(float(x))))
        for x in rng.uniform(-1.5, 1.5, 200):
            assert abs(mpf(math.tan(float(x))) / mp.tan(mpf(float(x))) - 1) < 8.0 * UNIT
        for x in rng.uniform(-3.0, 0.0, 200) * np.exp(1j * rng.uniform(-1.6, 1.6, 200)) * np.geomspace(1e-9, 1.0, 200):
            value, granted = mp.mpc(complex(x)), 8.0 * UNIT * (1.0 + abs(x))
            assert abs(mp.mpc(complex(np.expm1(x))) / mp.expm1(value) - 1) < granted
            assert abs(mp.mpc(complex(np.exp(x))) / mp.exp(value) - 1) < granted


def test_held_commands_have_their_error_where_a_mode_turns_by_whole_circles_in_a_tick() -> None:
    """There ``exp(p dt) - 1`` is small beside the rounding of ``p dt``: 1000 times what a relative bound grants."""
    own = model()
    with mp.workdps(60):
        for damping in (1e-5, 1e-3, 0.1):
            for turns in (1, 2, 7):
                omega = 2.0 * math.pi * turns / DT * np.linspace(1.0 - 1e-6, 1.0 + 1e-6, 25)
                poles = np.concatenate([omega * (-damping + 1j), omega[:5] * (-damping - 1j), [-1e-3, -40.0 - 1e-4j]])
                growth, gain = dataclasses.replace(own, poles=poles).growth
                for k, pole in enumerate(poles):
                    x = mp.mpc(complex(pole)) * mpf(DT)
                    for found, exact_value in ((growth, mp.exp(x)), (gain, mp.expm1(x) / mp.mpc(complex(pole)))):
                        assert abs(mp.mpc(complex(found.c[0, k])) - exact_value) <= mpf(float(found.rad[k]))
