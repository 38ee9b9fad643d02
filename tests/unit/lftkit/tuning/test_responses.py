"""Tuning on frequency responses against state-space closed loops, differences, and the tuner of state-space models."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy import linalg

from lftkit.tuning import Descent, DescentOptions, descend
from lftkit.tuning.responses import (
    ControllerBlock,
    PlantSamples,
    ResponseGain,
    ResponseLook,
    ResponseNoise,
    ResponseProblem,
    ResponseSource,
    gain_matrices,
    parameters_of,
)
from lftkit.tuning.responses.blocks import entry_sizes, with_least_decay

STATES, MEASURED, ERRORS, DISTURBED, COMMANDS = 6, 4, 2, 3, 3
RNG = np.random.default_rng(4)
A = RNG.standard_normal((STATES, STATES))
A = A - A.T - 0.3 * np.eye(STATES)
B = RNG.standard_normal((STATES, DISTURBED + COMMANDS))
C = RNG.standard_normal((MEASURED + ERRORS, STATES))
D = 0.1 * RNG.standard_normal((MEASURED + ERRORS, DISTURBED + COMMANDS))
DELAY = 0.05


def samples(omega: np.ndarray) -> PlantSamples:
    eye = np.eye(STATES)
    response = np.array([D + C @ linalg.solve(1j * w * eye - A, B) for w in omega])
    return PlantSamples(omega, response, MEASURED, COMMANDS)


def block(name: str, order: int, measured: slice, commands: slice, delay: float = 0.0) -> ControllerBlock:
    shape = order + commands.stop - commands.start, order + measured.stop - measured.start
    return ControllerBlock(
        name,
        order,
        measured,
        commands,
        variable=lambda omega: np.asarray(1j * omega, dtype=complex),
        before=lambda omega: np.ones((len(omega), measured.stop - measured.start), complex),
        after=lambda omega: np.exp(-1j * omega * delay),
        free=np.ones(shape, dtype=bool),
    )


BLOCKS = (block("one", 2, slice(0, 4), slice(0, 2), DELAY), block("two", 1, slice(1, 3), slice(2, 3)))
GAINS = (
    ResponseGain("error", (0, 1), None, None, lambda w: 1.0 / (1.0 + w)),
    ResponseGain("error, one alone", (0,), None, None, np.ones_like),
    ResponseGain("command", (0, 1), slice(0, 2), None, np.ones_like),
    ResponseGain("sensitivity", (0, 1), slice(0, 2), slice(0, 2), np.ones_like, hard=True),
    ResponseGain("added to error", (0, 1), None, slice(2, 3), np.ones_like),
)


def controller(seed: int, size: float = 0.3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    matrices = []
    for one in BLOCKS:
        M = size * rng.standard_normal(one.shape)
        M[: one.order, : one.order] -= np.eye(one.order)
        matrices.append(M)
    return parameters_of(BLOCKS, matrices)


def closed_response(x: np.ndarray, omega: float, active: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    """Errors, commands by disturbances and added commands: one linear system of all signals, solved at once."""
    P = D + C @ np.linalg.inv(1j * omega * np.eye(STATES) - A) @ B
    K = np.zeros((COMMANDS, MEASURED), complex)
    for k, (one, M) in enumerate(zip(BLOCKS, gain_matrices(BLOCKS, x))):
        n = one.order
        if k in active:
            own = M[n:, n:] + M[n:, :n] @ np.linalg.inv(1j * omega * np.eye(n) - M[:n, :n]) @ M[:n, n:]
            K[one.commands, one.measurements] = own * one.after(np.array([omega]))[0]
    ny, nu = MEASURED, COMMANDS
    # unknowns y, u: y - Pyu u = Pyw w, u - K y = added
    whole = np.block([[np.eye(ny), -P[:ny, DISTURBED:]], [-K, np.eye(nu)]])
    given = np.block([[P[:ny, :DISTURBED], np.zeros((ny, nu))], [np.zeros((nu, DISTURBED)), np.eye(nu)]])
    u = np.linalg.solve(whole, given)[ny:]
    e = np.hstack([P[ny:, :DISTURBED], np.zeros((ERRORS, nu))]) + P[ny:, DISTURBED:] @ u
    return e[:, :DISTURBED], u[:, :DISTURBED], u[:, DISTURBED:], e[:, DISTURBED:]


def noise(omega: np.ndarray, active: tuple[int, ...] = (0, 1)) -> ResponseNoise:
    density = np.broadcast_to(np.array([1.0, 0.5, 2.0, 0.1]), (len(omega), MEASURED))
    return ResponseNoise("noise", active, samples(omega), density, np.gradient(omega) / np.pi, 0.7)


def problem(omega: np.ndarray) -> ResponseProblem:
    return ResponseProblem(BLOCKS, samples(omega), GAINS, (noise(omega), noise(omega, (0,))))


OMEGA = np.geomspace(0.05, 20.0, 15)


def test_values_are_those_of_the_closed_loop() -> None:
    x = controller(1)
    found = problem(OMEGA).values(x)
    for k, w in enumerate(OMEGA):
        e, u, s, added = closed_response(x, w, (0, 1))
        alone = closed_response(x, w, (0,))[0]
        expected = [e / (1.0 + w), alone, u[:2], s[:2, :2], added[:, 2:]]
        np.testing.assert_allclose(found[:, k], [np.linalg.norm(T, 2) for T in expected], rtol=1e-9)


def test_gradients_agree_with_differences() -> None:
    x, rng = controller(2), np.random.default_rng(0)
    one = problem(OMEGA)
    entries = np.array([(g, k) for g in range(len(GAINS)) for k in (0, 7, 14)])
    values, slopes, owners = one.slopes(x, entries)
    direction, h = rng.standard_normal(len(x)), 1e-6
    ahead, behind = one.values(x + h * direction), one.values(x - h * direction)
    at = 0
    for g in range(len(GAINS)):
        own = np.flatnonzero(owners == g)[:3]  # the first of each gain are the entries themselves
        for row, k in zip(own, (0, 7, 14)):
            assert values[row] == pytest.approx(one.values(x)[g, k], rel=1e-9)
            assert slopes[row] @ direction == pytest.approx((ahead[g, k] - behind[g, k]) / (2 * h), rel=1e-6, abs=1e-9)
            at += 1
    assert at == len(entries)
    value, slope = one.noise_slopes(x)
    np.testing.assert_allclose(value, one.noise(x), rtol=1e-12)
    differences = (one.noise(x + h * direction) - one.noise(x - h * direction)) / (2 * h)
    np.testing.assert_allclose(slope @ direction, differences, rtol=1e-6)


def test_planes_of_close_singular_values_are_below_the_gain() -> None:
    """Two equal axes: each plane is a lower bound of the largest singular value, also away from the point."""
    twice = np.kron(np.array([[1.0, 0.4], [0.7, 1.0]]), np.eye(2))
    plant = PlantSamples(np.array([1.0]), twice[None].astype(complex), 2, 2)
    own = (block("K", 1, slice(0, 2), slice(0, 2)),)
    gain = ResponseGain("e", (0,), None, None, np.ones_like)
    one = ResponseProblem(own, plant, (gain,))
    x = parameters_of(own, [np.array([[-1.0, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, 0.3]])])
    values, slopes, _ = one.slopes(x, np.array([[0, 0]]))
    assert len(values) == 6  # the first, the second, and four mixtures
    np.testing.assert_allclose(values, one.values(x)[0, 0], rtol=1e-12)
    rng = np.random.default_rng(1)
    for _ in range(20):
        d = 1e-4 * rng.standard_normal(len(x))
        assert one.values(x + d)[0, 0] >= (values + slopes @ d).max() - 1e-7


def test_noise_is_the_h2_norm() -> None:
    """Over a fine grid: the H2 norm of the closed state space by Lyapunov's equation."""
    omega = np.unique(np.r_[0.0, np.geomspace(1e-4, 5.0, 3000), np.geomspace(5.0, 3e3, 2000)])[1:]
    own = (block("K", 2, slice(0, 4), slice(0, 2)),)
    M = 0.2 * np.random.default_rng(8).standard_normal(own[0].shape)
    M[:2, :2] -= np.eye(2)
    M[2:, 2:] = 0.0  # strictly proper: the norm is finite
    density = np.broadcast_to(np.array([1.0, 0.5, 2.0, 0.1]), (len(omega), MEASURED))
    one = ResponseNoise("n", (0,), samples(omega), density, np.gradient(omega) / np.pi, 1.0)
    found = ResponseProblem(own, samples(omega[:1]), (GAINS[1],), (one,)).noise(parameters_of(own, [M]))
    K = control.ss(M[:2, :2], M[:2, 2:], np.vstack([M[2:, :2], np.zeros((1, 2))]), np.zeros((3, 4)))
    plant = control.ss(A, B[:, DISTURBED:], C, D[:, DISTURBED:])
    # noise is added to the measurements: u = K (y + n), e = Peu u
    loop = control.feedback(K, plant[:MEASURED, :], sign=1)
    closed = plant[MEASURED:, :] * loop * control.ss([], [], [], np.diag([1.0, 0.5, 2.0, 0.1]))
    assert (closed.poles().real < 0.0).all()
    W = linalg.solve_continuous_lyapunov(closed.A, -closed.B @ closed.B.T)
    assert found[0] == pytest.approx(np.sqrt(np.trace(closed.C @ W @ closed.C.T)), rel=2e-3)


def stable(x: np.ndarray) -> bool:
    """Poles of the loop without the delay."""
    matrices = gain_matrices(BLOCKS, x)
    n, (f, g) = STATES, (BLOCKS[0].order, BLOCKS[1].order)
    AK = linalg.block_diag(*(M[: b.order, : b.order] for b, M in zip(BLOCKS, matrices)))
    BK = np.vstack([M[: b.order, b.order :] @ np.eye(MEASURED)[b.measurements] for b, M in zip(BLOCKS, matrices)])
    CK, DK = np.zeros((COMMANDS, f + g)), np.zeros((COMMANDS, MEASURED))
    for b, M, at in zip(BLOCKS, matrices, (slice(0, f), slice(f, f + g))):
        CK[b.commands, at], DK[b.commands, b.measurements] = M[b.order :, : b.order], M[b.order :, b.order :]
    Bu, Cy, Dyu = B[:, DISTURBED:], C[:MEASURED], D[:MEASURED, DISTURBED:]
    E = np.linalg.inv(np.eye(COMMANDS) - DK @ Dyu)
    u_x, u_k = E @ DK @ Cy, E @ CK
    closed = np.block([[A + Bu @ u_x, Bu @ u_k], [BK @ (Cy + Dyu @ u_x), AK + BK @ Dyu @ u_k]])
    return bool(np.linalg.eigvals(closed).real.max() < 0.0) and n > 0


def descended(
    one: ResponseProblem, x: np.ndarray, iterations: int = 60, tolerance: float = 1e-4, confirm: bool = False
) -> Descent[ResponseLook]:
    return descend(ResponseSource(one, stable), x, DescentOptions(iterations, tolerance, confirm=confirm))


@pytest.mark.further
def test_a_descent_is_converged_only_where_nothing_near_is_lower() -> None:
    """Random directions of another seed than the descent's own find nothing 0.1 % lower; a start is not converged."""
    omega = np.geomspace(0.02, 50.0, 40)
    one = ResponseProblem(BLOCKS, samples(omega), GAINS[:1])
    found = descended(one, controller(1, 0.05), 2000, 1e-3, confirm=True)
    assert found.status == "converged"
    rng, sizes = np.random.default_rng(77), entry_sizes(BLOCKS, found.x)
    for length in (1e-3, 1e-2, 1e-1):
        for _ in range(50):
            x = found.x + length * sizes * rng.standard_normal(len(found.x))
            assert one.values(x).max() > 0.999 * found.point.value or not stable(x)
    further = descended(one, found.x, 60, 1e-6)
    assert further.point.value > 0.995 * found.point.value, "a descent that goes on from there"
    assert descended(one, controller(1, 0.05), 6, 1e-3, confirm=True).status == "iterations"


def test_a_descent_stops_at_its_target_and_at_its_limits() -> None:
    one = problem(OMEGA)
    x = controller(1, 0.05)
    start = one.values(x).max()
    source = ResponseSource(one, stable)
    assert descend(source, x, DescentOptions(target=2.0 * start)).status == "target"
    assert descend(source, x, DescentOptions(iterations=0)).status == "iterations"
    late = descend(source, x, DescentOptions(deadline=0.0))
    assert late.status == "out_of_time"
    np.testing.assert_array_equal(late.x, x)


def test_what_is_refused() -> None:
    one = problem(OMEGA)
    with pytest.raises(ValueError, match="start must be a stabilising controller"):
        descend(ResponseSource(one, lambda x: False), controller(1))
    response = samples(OMEGA).response
    with pytest.raises(ValueError, match=r"response must be finite, got a value that is not at 0\.05 rad/s"):
        PlantSamples(OMEGA, np.where(np.arange(len(OMEGA))[:, None, None] == 0, np.nan, response), MEASURED, COMMANDS)
    with pytest.raises(ValueError, match="response must have one matrix for each of 3 frequencies"):
        PlantSamples(OMEGA[:3], response, MEASURED, COMMANDS)
    with pytest.raises(ValueError, match="response must have more rows than 6 measurements"):
        PlantSamples(OMEGA, response, 6, COMMANDS)
    with pytest.raises(ValueError, match=r"gain matrix of two must have the shape \(2, 3\), got \(3, 3\)"):
        parameters_of(BLOCKS, [np.zeros(BLOCKS[0].shape), np.zeros((3, 3))])
    with pytest.raises(ValueError, match="limit must be positive"):
        ResponseNoise("n", (0,), samples(OMEGA), np.zeros((len(OMEGA), MEASURED)), OMEGA, 0.0)
    with pytest.raises(ValueError, match="density and step must have the shapes"):
        ResponseNoise("n", (0,), samples(OMEGA), np.zeros((2, MEASURED)), OMEGA, 1.0)


@pytest.mark.parametrize(
    "poles",
    [[[1e-3, 0.0], [0.0, -2.0]], [[0.01, 3.0], [-3.0, 0.01]], [[1e-3, 1.0], [0.0, 1e-3]]],
    ids=["real", "pair", "Jordan block"],
)
def test_poles_that_grow_are_moved_to_the_least_decay(poles: list[list[float]]) -> None:
    change = np.array([[1.0, 0.4], [-0.3, 2.0]])
    M = RNG.standard_normal(BLOCKS[0].shape)
    M[:2, :2] = change @ np.array(poles) @ np.linalg.inv(change)
    one = replace(BLOCKS[0], least_decay=0.1)
    before, after = np.linalg.eigvals(M[:2, :2]), with_least_decay([one], M.ravel()).reshape(M.shape)
    moved = np.linalg.eigvals(after[:2, :2])
    assert moved.real.max() == pytest.approx(-0.1, abs=1e-6)
    assert np.sort(moved.imag) == pytest.approx(np.sort(before.imag), abs=1e-5)
    assert np.array_equal(after[2:], M[2:]) and np.array_equal(after[:, 2:], M[:, 2:])
    if before.real.min() < -1.0:
        assert moved.real.min() == pytest.approx(before.real.min())


@pytest.mark.further
def test_a_descent_keeps_the_least_decay_of_the_controllers() -> None:
    """Without it the same descent ends with a slower pole; what is hard is kept."""
    gains = (GAINS[0], ResponseGain("sensitivity", (0, 1), slice(0, 3), slice(0, 3), lambda w: 0.5 + 0 * w, hard=True))
    slowest = {}
    for decay in (None, 1.2):
        own = tuple(replace(b, least_decay=decay) for b in BLOCKS)
        one = ResponseProblem(own, samples(np.geomspace(0.02, 50.0, 150)), gains)
        found = descended(one, controller(1, 0.05))
        assert stable(found.x) and found.point.values[1] <= 1.0 + 1e-9
        assert found.point.values[0] < 0.5 * one.values(controller(1, 0.05))[0].max()
        poles = [np.linalg.eigvals(M[: b.order, : b.order]) for b, M in zip(own, gain_matrices(own, found.x))]
        slowest[decay] = max(p.real.max() for p in poles)
    assert slowest[None] > -1.1 and slowest[1.2] <= -1.2 + 1e-9
