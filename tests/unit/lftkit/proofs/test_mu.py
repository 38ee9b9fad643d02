"""The structured singular value: closed forms, bounds in order, certificates and perturbations that hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from lftkit.proofs import MuCertificate, ProofError, check_mu, complex_block, full_block, mu, real_block
from lftkit.proofs.trusted.proof import REAL
from lftkit.proofs.trusted.structured import UncertaintyBlock, parts

STRUCTURES = [
    [complex_block()] * 4,
    [complex_block(2), full_block(2), complex_block()],
    [real_block(), real_block(), complex_block(), full_block(2)],
    [real_block()] * 5,
    [real_block(2), real_block(2), complex_block()],
    [full_block(2, 3), real_block(2), full_block(1, 2)],
    [full_block(1, 3), full_block(3, 1)],
]


def random_matrix(structure: list[UncertaintyBlock], seed: int) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(seed)
    shape = sum(b.columns for b in structure), sum(b.rows for b in structure)
    sides = [np.exp(rng.normal(size=(n, 1))) for n in shape]
    return sides[0] * (rng.normal(size=shape) + 1j * rng.normal(size=shape)) * sides[1].T


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("number", range(len(STRUCTURES)))
def test_bounds_are_in_order_and_hold(number: int, seed: int) -> None:
    structure = STRUCTURES[number]
    M = random_matrix(structure, seed)
    bounds = mu(M, structure, starts=4, seed=seed)
    assert 0.0 < bounds.lower <= bounds.upper
    assert check_mu(M, structure, bounds.certificate) >= 1.0 and bounds.certificate.level == bounds.upper
    delta = bounds.perturbation
    assert delta is not None and delta.shape == M.shape[::-1]
    assert linalg.svd(np.eye(len(M)) - M @ delta, compute_uv=False)[-1] <= 1e-10
    rest = delta.copy()
    norms = []
    for block, z, w in parts(structure):
        part = delta[w, z]
        norms.append(linalg.norm(part, 2))
        if block.kind != "full":
            np.testing.assert_allclose(part, part[0, 0] * np.eye(block.rows), atol=1e-14)
            assert block.kind != REAL or abs(part[0, 0].imag) <= 1e-14 * abs(part[0, 0])
        rest[w, z] = 0.0
    assert not np.any(rest) and 1.0 / max(norms) == pytest.approx(bounds.lower, rel=1e-12)
    if not any(block.kind == REAL for block in structure):
        assert bounds.upper <= 1.03 * bounds.lower, "for few complex blocks both bounds are close"


def test_no_perturbation_below_the_upper_bound_makes_the_loop_singular() -> None:
    """Random members of norm 1 / upper: the determinant keeps away from zero along the way to each of them."""
    rng = np.random.default_rng(5)
    for number, structure in enumerate(STRUCTURES):
        M = random_matrix(structure, 10 + number)
        upper = mu(M, structure, starts=1).upper
        for _ in range(100):
            delta = np.zeros(M.shape[::-1], complex)
            for block, z, w in parts(structure):
                if block.kind == "full":
                    part = rng.normal(size=(block.rows, block.columns)) + 1j * rng.normal(
                        size=(block.rows, block.columns)
                    )
                    part = part / linalg.norm(part, 2)
                else:
                    phase = rng.choice([-1.0, 1.0]) if block.kind == REAL else np.exp(2j * np.pi * rng.random())
                    part = phase * np.eye(block.rows)
                delta[w, z] = part
            values = linalg.eigvals(M @ delta)
            real = values.real[np.abs(values.imag) <= 1e-9 * np.abs(values)]
            assert real.max(initial=0.0) <= upper


@pytest.mark.parametrize("seed", range(2))
def test_closed_forms(seed: int) -> None:
    """Rank one: sum of |u_i v_i|; one repeated complex scalar: spectral radius; one full block: norm; diagonal."""
    rng = np.random.default_rng(seed)
    u, v = (rng.normal(size=5) + 1j * rng.normal(size=5) for _ in range(2))
    M = rng.normal(size=(4, 4)) + 1j * rng.normal(size=(4, 4))
    diagonal = rng.normal(size=4) + 1j * rng.normal(size=4)
    real = rng.normal(size=(3, 3))
    eigenvalues = linalg.eigvals(real)
    cases = [
        (np.outer(u, v.conj()), [complex_block()] * 5, float(np.abs(u * v.conj()).sum())),
        (M, [complex_block(4)], float(np.abs(linalg.eigvals(M)).max())),
        (M, [full_block(4)], float(linalg.norm(M, 2))),
        (np.diag(diagonal), [complex_block()] * 4, float(np.abs(diagonal).max())),
        (real, [real_block(3)], float(np.abs(eigenvalues.real[np.abs(eigenvalues.imag) < 1e-12]).max())),
    ]
    for matrix, structure, value in cases[: 4 if seed else 5]:
        bounds = mu(matrix, structure, rtol=1e-5)
        assert bounds.lower <= bounds.upper
        assert bounds.lower == pytest.approx(value, rel=1e-6)
        assert value <= bounds.upper * (1.0 + 1e-12)
        if structure != [real_block(3)]:
            assert bounds.upper <= value * (1.0 + 1e-4)


def test_scaling_of_blocks_changes_nothing() -> None:
    structure = STRUCTURES[2]
    M = random_matrix(structure, 3)
    scale = np.array([1e5, 1e-4, 30.0, 2.0, 2.0])
    one, two = (mu(m, structure, rtol=1e-6) for m in (M, scale[:, None] * M / scale))
    assert two.upper == pytest.approx(one.upper, rel=1e-5) and two.lower == pytest.approx(one.lower, rel=1e-5)


def test_altered_certificates_are_refused() -> None:
    structure = STRUCTURES[2]
    M = random_matrix(structure, 0)
    good = mu(M, structure).certificate
    assert isinstance(good, MuCertificate)
    for bad in (
        replace(good, level=0.999 * good.level),
        replace(good, level=np.inf),
        replace(good, D=tuple(-d for d in good.D)),
        replace(good, D=tuple(0.0 * d for d in good.D)),
        replace(good, D=good.D[1:]),
        replace(good, G=tuple(-g for g in good.G)),
        replace(good, G=tuple(np.nan * g for g in good.G)),
        replace(good, G=(*good.G[:2], np.ones((1, 1)), good.G[3])),
    ):
        with pytest.raises(ProofError):
            check_mu(M, structure, bad)
    with pytest.raises(ProofError):
        check_mu(1.001 * M, structure, good)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: mu(np.eye(2), [real_block()]), "shape"),
        (lambda: mu(np.eye(2), []), "shape"),
        (lambda: mu([[np.nan]], [real_block()]), "finite"),
        (lambda: mu(np.ones((2, 3)), [full_block(2, 3)]), "shape"),
        (lambda: UncertaintyBlock("imaginary", 1, 1), "must"),
        (lambda: UncertaintyBlock("real", 0, 0), "must"),
        (lambda: UncertaintyBlock("real", 1, 2), "must"),
        (lambda: UncertaintyBlock("full", 0, 2), "must"),
    ],
)
def test_bad_matrices_and_blocks_are_refused(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
