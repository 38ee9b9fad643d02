"""Proven lower bounds for all controllers: against existence conditions, loops, exact arithmetic, and forged."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from oracles.full_order_bound import full_order_bound
from scipy import linalg
from support.full_order_plants import mixed_sensitivity, random_plant

from lftkit import Port, System, close_loop, hinf_norm, s
from lftkit.proofs import CheckedLowerBound, ProofError, check_proof
from lftkit.proofs.lower_bound import LowerBoundProof
from lftkit.synthesis import hinfsyn, lower_bound_proof
from lftkit.synthesis.lower_bound import SETTINGS
from lftkit.systems.sampled.bilinear import to_discrete
from lftkit.tuning.published_plants import published_plant


@pytest.fixture(scope="module")
def proof() -> LowerBoundProof:
    found = lower_bound_proof(random_plant(1, 3), "y", "u").proof
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("seed", "n", "through"), [(0, 2, True), (1, 2, False), (0, 3, True), (1, 4, False), (2, 5, True), (1, 8, False)]
)
def test_the_bound_is_within_a_thousandth_of_existence_conditions(seed: int, n: int, through: bool) -> None:
    """Two Riccati equations of which neither the search nor the check knows anything."""
    plant = random_plant(seed, n, through)
    found, least = lower_bound_proof(plant, "y", "u"), full_order_bound(plant)
    assert (1.0 - 1e-3) * least <= found.level <= (1.0 + 2e-6) * least, found.reason
    assert isinstance(checked := check_proof(found.proof), CheckedLowerBound) and checked.level == found.level


@pytest.mark.parametrize("seed", range(2))
def test_a_sampled_plant_has_the_bound_of_its_continuous_image(seed: int) -> None:
    """The check is that of the discrete inequality: it knows no bilinear map."""
    plant, dt = random_plant(seed, 2 + seed), 0.1
    image = System(*to_discrete(*plant.matrices, dt), plant.inputs, plant.outputs, "P", dt)
    found = lower_bound_proof(image, "y", "u")
    least = full_order_bound(plant)
    assert (1.0 - 1e-3) * least <= found.level <= (1.0 + 2e-6) * least
    assert f"sampled every {dt} s" in str(check_proof(found.proof))


def test_mixed_sensitivity_of_a_textbook() -> None:
    """Skogestad and Postlethwaite (2005), section 2.8.2: the norm 1.37 is printed, and no controller reaches 1.365.

    Nothing excites the plant's states where the measurement is zero, so that one side of the proof is empty.
    """
    plant = mixed_sensitivity(200 / ((10 * s + 1) * (0.05 * s + 1) ** 2), (s / 1.5 + 10) / (s + 1e-3), 1.0)
    found = lower_bound_proof(plant, "y", "u")
    assert found.proof is not None and found.proof.unseen.shape[1] == 0
    assert found.level > 1.3655 and hinfsyn(plant, "y", "u").value < 1.0005 * found.level


@pytest.mark.parametrize("slow", [1e-2, 1e-4, 1e-6])
def test_slow_weights_have_a_bound(slow: float) -> None:
    plant = mixed_sensitivity(1 / (s + 1), (0.5 * s + 1) / (s + slow), 0.1)
    assert 0.0 <= 1.0 - lower_bound_proof(plant, "y", "u").level / hinfsyn(plant, "y", "u").value < 1e-3


@pytest.mark.parametrize("level", [None, 60.0])
def test_a_certified_design_has_its_proof(level: float | None) -> None:
    plant = random_plant(2, 3)
    design = hinfsyn(plant, "y", "u", level, certify=True)
    checked = check_proof(design.proof)
    without = hinfsyn(plant, "y", "u", level)
    assert isinstance(checked, CheckedLowerBound) and without.proof is None and not design.reason
    assert design.lower == max(checked.level, without.lower) and checked.level <= design.value


def test_a_proof_that_fails_leaves_the_bound_that_is_known() -> None:
    plant = random_plant(3, SETTINGS.most_states + 1)
    without, design = hinfsyn(plant, "y", "u"), hinfsyn(plant, "y", "u", certify=True)
    assert design.proof is None and f"more than {SETTINGS.most_states}" in design.reason
    assert 0.0 < design.lower == without.lower


@pytest.mark.further
def test_without_a_weight_on_commands_a_certified_design_says_what_is_proven() -> None:
    """Where the equations need a small weight there is no numerical bound; a proof needs no weight."""
    plant = random_plant(4, 3)
    D = plant.D.copy()
    D[:3, 3:] = 0.0
    D[0, 3] = 1.0
    design = hinfsyn(System(*plant.matrices[:3], D, plant.inputs, plant.outputs), "y", "u", certify=True)
    assert design.regularised > 0.0 and 0.0 < design.lower <= design.value and design.gap < 0.5


def test_no_random_controller_undercuts_a_bound() -> None:
    """Controllers about the best one, of its order, whose loops are stable."""
    plant = random_plant(1, 3)
    level, best, rng = lower_bound_proof(plant, "y", "u").level, hinfsyn(plant, "y", "u"), np.random.default_rng(0)
    reached = []
    for size in np.repeat([1e-3, 1e-2, 1e-1], 15):
        K = best.controller
        other = System(*(M + size * rng.standard_normal(M.shape) for M in K.matrices), K.inputs, K.outputs)
        closed = close_loop(plant, other, ["w"], ["z"])
        if linalg.eigvals(closed.A).real.max() < 0.0:
            reached.append(hinf_norm(*closed.matrices).value)
    assert len(reached) > 15 and min(reached) >= level


def changed(name: str, change: Callable[[Any], Any]) -> Callable[[LowerBoundProof], LowerBoundProof]:
    return lambda proof: dataclasses.replace(proof, **{name: change(getattr(proof, name))})  # type: ignore[arg-type]


def with_entry(value: float) -> Callable[[Any], Any]:
    def change(array: Any) -> Any:
        found = array.copy()
        found[0, 0] = value
        return found

    return change


FORGED = {
    "level 1 % above": changed("level", lambda g: 1.01 * g),
    "infinite level": changed("level", lambda g: np.inf),
    "level that is no number": changed("level", lambda g: np.nan),
    "vectors of one side doubled": changed("unseen", lambda V: 2.0 * V),
    "a vector left out": changed("unmoved", lambda V: V[:, 1:]),
    "vectors that are measured": changed("unseen", lambda V: np.roll(V, 1, axis=0)),
    "not a number": changed("unseen", with_entry(np.nan)),
    "infinite": changed("unmoved", with_entry(np.inf)),
    "near overflow": changed("unseen", with_entry(1e200)),
    "one side without vectors": changed("unseen", lambda V: V[:, :0]),
    "coupling too large": changed("left", lambda T: 1.01 * T),
    "coupling of the other sign": changed("left", lambda T: -T),
    "single precision": changed("unseen", lambda V: V.astype(np.float32)),
    "sides exchanged": lambda p: dataclasses.replace(p, unseen=p.unmoved, unmoved=p.unseen),
    "other measurements": changed("measured", lambda _: (0, 1)),
    "a measurement twice": changed("measured", lambda _: (3, 3)),
    "a truth value": changed("commanded", lambda _: (True, 4)),
    "everything measured": changed("measured", lambda _: tuple(range(5))),
    "another plant": changed("A", lambda A: A - 0.05 * np.eye(len(A))),
    "a plant with smaller errors": changed("C", lambda C: np.vstack([0.95 * C[:3], C[3:]])),
    "a sampled plant": changed("dt", lambda _: 0.1),
    "a period that is negative": changed("dt", lambda _: -0.1),
    "a measurement with noise as one without": changed("noiseless", lambda _: np.eye(1, 3)),
    "one dimension": changed("noiseless", lambda _: np.zeros(3)),
    "no sizes": changed("undisturbed", lambda _: np.zeros(())),
    "a disturbed state as one that is not": changed("undisturbed", lambda _: np.eye(1, 3)),
    "decaying modes of a state with inputs": changed("decaying", lambda _: np.eye(1, 3)),
}


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_proof_is_refused(proof: LowerBoundProof, name: str) -> None:
    with pytest.raises(ProofError):
        check_proof(FORGED[name](proof))


SINGULAR = {
    "level 1 % above": changed("level", lambda g: 1.01 * g),
    "another rate without noise": changed("noiseless", lambda N: np.vstack([np.pad(N, ((0, 0), (0, 1))), [[0, 1, 0]]])),
    "the same measurement twice": changed("noiseless", lambda N: np.vstack([np.pad(N, ((0, 0), (0, 1))), [[1, 0, 0]]])),
    "a measurement that is none": changed("noiseless", lambda N: 0.0 * N),
    "no measurement without noise": changed("noiseless", lambda N: np.zeros((0, 1))),
    "other modes": changed("decaying_adjoint", lambda E: np.roll(E, 1, axis=1)),
    "modes that grow": changed("decaying_adjoint", lambda E: linalg.null_space(E).T),
    "no modes": changed("decaying_adjoint", lambda E: E[:0]),
    "modes twice": changed("decaying_adjoint", lambda E: np.vstack([E, E])),
    "not a number": changed("decaying_adjoint", with_entry(np.nan)),
    "noise that is small": changed("D", lambda D: D + 1e-300),
}


@pytest.mark.parametrize("name", SINGULAR)
def test_a_forged_proof_without_noise_is_refused(name: str) -> None:
    """HE1: a noiseless measurement, and one mode of the adjoint that decays and three that grow."""
    found = lower_bound_proof(published_plant("HE1"), "y", "u").proof
    assert found is not None and (len(found.noiseless), len(found.decaying_adjoint)) == (1, 1)
    with pytest.raises(ProofError):
        check_proof(SINGULAR[name](found))


def test_a_file_says_what_is_proven_of_which_plant(proof: LowerBoundProof, tmp_path: Path) -> None:
    file = tmp_path / "bound.npz"
    proof.to_file(file)
    checked = check_proof(file)
    assert checked == check_proof(proof)
    said, printed = str(checked).rsplit(" ", 1)
    assert said == (
        f"plant {checked.plant}, 3 states, in continuous time\n"
        "proven: no stabilising controller of any order from outputs 4, 5 to inputs 4, 5 has a loop with an H-infinity "
        "norm below"
    )
    assert proof.level * (1.0 - 2e-8) < float(printed) <= proof.level


@pytest.mark.parametrize("name", ["HE1", "NN17", "AC3", "REA2", "MFP"])
def test_published_plants_without_noise_have_a_proof(name: str) -> None:
    """HE1 has a stable zero from its commands, too, and NN17 neither noise nor all weights."""
    plant = published_plant(name)
    found, design = lower_bound_proof(plant, "y", "u"), hinfsyn(plant, "y", "u")
    assert 0.0 <= 1.0 - found.level / design.value < 1e-3
    assert found.level <= design.lower * (1.0 + 1e-9), (
        "the bound of a design without a certificate is the better one of both"
    )


def test_a_proof_beside_actuators_that_no_error_weighs() -> None:
    """COMPleib's AC7, whose bound 0.037849 was numerical; the best loop that is known here has the norm 0.037905."""
    assert 0.0378 < lower_bound_proof(published_plant("AC7"), "y", "u").level <= 0.037905


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("free", [1, 2])
def test_measurements_without_noise_have_a_bound_near_to_a_loop(free: int, dt: float) -> None:
    plant = random_plant(3, 3)
    A, B, C, D = (matrix.copy() for matrix in plant.matrices)
    D[3 : 3 + free, :3] = 0.0
    if dt:
        A, B = np.split(linalg.expm(dt * np.block([[A, B], [np.zeros((5, 8))]]))[:3], [3], axis=1)
    given = System(A, B, C, D, plant.inputs, plant.outputs, "P", dt)
    assert 0.0 <= 1.0 - lower_bound_proof(given, "y", "u").level / hinfsyn(given, "y", "u").value < 1e-3


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_a_weight_beside_disturbances_of_the_plant_leaves_a_proof(dt: float) -> None:
    """``y = w1 - G (u + w2)`` with a weight of y: nothing reaches its state where y is zero, and w2 the others."""
    A = np.array([[0.7, 1.0, 0.0], [0.0, -0.4, 0.0], [-1.0, 0.0, -0.05]])
    B = np.array([[0.0, 0.0, 0.0], [0.0, 0.3, 1.0], [1.0, 0.0, 0.0]])
    C, D = np.array([[-0.5, 0.0, 1.0], [0, 0, 0], [-1.0, 0.0, 0.0]]), np.array([[0.5, 0, 0], [0, 0, 0.1], [1, 0, 0]])
    if dt:
        A, B = np.split(linalg.expm(dt * np.block([[A, B], [np.zeros((3, 6))]]))[:3], [3], axis=1)
        A[2], B[2] = [-dt, 0.0, 1.0 - 0.05 * dt], [dt, 0.0, 0.0]
    plant = System(A, B, C, D, (Port("w", 2), Port("u", 1)), (Port("z", 2), Port("y", 1)), "P", dt)
    found = lower_bound_proof(plant, "y", "u")
    assert found.proof is not None and found.proof.undisturbed.tolist() == [[0.0, 0.0, 1.0]]
    assert 0.0 <= 1.0 - found.level / hinfsyn(plant, "y", "u").value < 1e-3


def test_mixed_sensitivity_of_an_unstable_plant_has_a_proof() -> None:
    """Nothing excites its states where the measurement is zero: sums are not positive in the stable ones of them."""
    plant = mixed_sensitivity((s + 3) / ((s - 1) * (s + 2) * (s + 0.3)), (0.6 * s + 1) / (s + 0.01), 0.1)
    found = lower_bound_proof(plant, "y", "u")
    assert found.proof is not None and len(found.proof.decaying) == 3
    assert 0.0 <= 1.0 - found.level / hinfsyn(plant, "y", "u").value < 1e-4


def test_what_is_not_known_has_a_reason() -> None:
    large = lower_bound_proof(random_plant(0, 21), "y", "u")
    assert (large.level, large.proof) == (-np.inf, None) and "21 states, more than 20" in large.reason
    n = 2
    plant = random_plant(0, n)
    shifted = System(-np.eye(n), *plant.matrices[1:], plant.inputs, plant.outputs, "P", 0.1)
    assert "no pole at z = -1" in lower_bound_proof(shifted, "y", "u").reason


Exact = np.ndarray[Any, Any]


def exact(matrix: Any) -> Exact:
    """Rational numbers."""
    return np.array([[Fraction(float(x)) for x in row] for row in matrix], dtype=object).reshape(np.shape(matrix))


def reduced(a: Exact, b: Exact) -> tuple[list[Fraction], Exact]:
    """Pivots of Gaussian elimination without exchanges, and the solution of ``a x = b``."""
    rows, n, pivots = np.hstack([a, b]), len(a), []
    for k in range(n):
        pivots.append(rows[k, k])
        rows[k] = rows[k] / rows[k, k]
        for i in range(k + 1, n):
            rows[i] = rows[i] - rows[i, k] * rows[k]
    for k in reversed(range(n)):
        for i in range(k):
            rows[i] = rows[i] - rows[i, k] * rows[k]
    return pivots, rows[:, n:]


def projected(V: Exact, seen: Exact) -> Exact:
    """Parts of vectors in the kernel of a matrix."""
    V = V - seen.T @ reduced(seen @ seen.T, seen @ V)[1]
    assert not (seen @ V).any()
    return V


def half(A: Exact, B: Exact, C: Exact, D: Exact, V: Exact) -> tuple[Exact, Fraction, Fraction]:
    """S and the sums of squares of outputs and inputs, of vectors of states and inputs."""
    x, w = V[: len(A)], V[len(A) :]
    rate, z = A @ x + B @ w, C @ x + D @ w
    return rate @ x.T + x @ rate.T, (z * z).sum(), (w * w).sum()


def check_contradiction(found: LowerBoundProof, noiseless: int) -> None:
    """Sums are zero along measured directions e without noise, and positive beside them."""
    A, B1, B2 = (exact(M) for M in (found.A, found.B[:, :3], found.B[:, 3:]))
    C1, C2, D11 = exact(found.C[:3]), exact(found.C[3:]), exact(found.D[:3, :3])
    D12, D21, e = exact(found.D[:3, 3:]), exact(found.D[3:, :3]), exact(found.C[3 : 3 + noiseless])
    seen, moved = np.vstack([np.hstack([C2, D21]), e @ np.hstack([A, B1])]), np.hstack([B2.T, D12.T])
    S, gained, spent = half(A, B1, C1, D11, projected(exact(found.unseen), seen))
    R, gained_too, spent_too = half(A.T, C1.T, B1.T, D11.T, projected(exact(found.unmoved), moved))
    assert not (e @ S).any()
    left = projected(exact(found.left), e) if noiseless else exact(found.left)
    T = left @ exact(found.right).T
    beside = np.array([[-e[0, 1], e[0, 0]]]) if noiseless else exact(np.eye(len(A)))
    W = np.block([[beside @ S @ beside.T, beside @ T], [(beside @ T).T, R]])
    assert min(reduced(W, 0 * W[:, :1])[0]) > 0
    g = Fraction(found.level)
    assert gained + gained_too - g * g * (spent + spent_too) - 2 * g * np.trace(T) > 0


@pytest.mark.parametrize("n", [1, 2])
def test_the_contradiction_holds_in_exact_arithmetic(n: int) -> None:
    """Rational numbers throughout: vectors projected on the kernel, pivots of the matrix, the sum of inequalities."""
    found = lower_bound_proof(random_plant(3, n), "y", "u").proof
    assert found is not None
    check_contradiction(found, 0)


def test_a_state_without_noise_has_no_sum_of_rates_in_exact_arithmetic() -> None:
    plant = random_plant(3, 2)
    D = plant.D.copy()
    D[3, :3] = 0.0
    found = lower_bound_proof(System(*plant.matrices[:3], D, plant.inputs, plant.outputs), "y", "u").proof
    assert found is not None and found.noiseless.tolist() == [[1.0, 0.0, 0.0]] and not len(found.weightless)
    check_contradiction(found, 1)


def test_decaying_modes_have_no_sum_of_rates_in_40_digits() -> None:
    """A plant and its weight where the measurement ``C2 x + w`` is zero: one mode grows, the other two decay."""
    plant = mixed_sensitivity(1 / ((s - 1) * (s + 2)), (0.6 * s + 1) / (s + 0.01), 0.1)
    found = lower_bound_proof(plant, "y", "u").proof
    assert found is not None and len(found.decaying) == 2 and not len(found.decaying_adjoint)
    with mpmath.workdps(40):
        A, B, C, D, V, U, left, right = (
            mpmath.matrix(array.tolist())
            for array in (found.A, found.B, found.C, found.D, found.unseen, found.unmoved, found.left, found.right)
        )
        F = A - B[:, 0] * C[2, :] / D[2, 0]
        values, rows = mpmath.eig(F, left=True, right=False)
        E = mpmath.matrix([[mpmath.re(rows[k, j]) for j in range(3)] for k in range(3) if mpmath.re(values[k]) < 0])
        x, left = (part - E.T * (E * E.T) ** -1 * (E * part) for part in (V[:3, :], left))
        w, moved = -C[2, :] * x / D[2, 0], mpmath.matrix([[*B[:, 1], *D[:2, 1]]])
        U -= moved.T * (moved * U) / (moved * moved.T)[0, 0]
        p, q = U[:3, :], U[3:, :]
        rate, back = F * x, A.T * p + C[:2, :].T * q
        S, R, T = rate * x.T + x * rate.T, back * p.T + p * back.T, left * right.T
        assert E.rows == 2 and mpmath.mnorm(E * S) < 1e-30 * mpmath.mnorm(S)
        grown, both = mpmath.ones(1, 3), mpmath.zeros(4)
        both[0, 0], both[0, 1:], both[1:, 0] = (grown * S * grown.T)[0, 0], grown * T, (grown * T).T
        both[1:, 1:] = R
        mpmath.cholesky(both)  # raises where it is not positive definite
        z, v = C[:2, :] * x + D[:2, 0] * w, B[:, 0].T * p + D[:2, 0].T * q
        squares = [mpmath.fsum(entry**2 for entry in part) for part in (z, v, w, q)]
        g, trace = mpmath.mpf(found.level), T[0, 0] + T[1, 1] + T[2, 2]
        assert squares[0] + squares[1] - g**2 * (squares[2] + squares[3]) - 2 * g * trace > 0
