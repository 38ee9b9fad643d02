"""Numbers out of range: no checker accepts what is too large, too small, infinite or not a number.

Arithmetic with such numbers overflows into infinities and NaN, of which every comparison is false and which LAPACK
takes without a word. Each form that is scaled, and each entry that is replaced, must be refused, or prove no more than
the proof it is made of.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mpmath import mp
from support.forged_proofs import forged
from support.uncertain_examples import aligned_modes

from lftkit import Port, RealParameter, System
from lftkit.arrays import ComplexArray
from lftkit.proofs import BoundOptions, ProofError, check_mu, check_proof, mu, real_block, worst_case_gain
from lftkit.proofs.axis.proof import AxisProof
from lftkit.proofs.sampled_loop import LoopProof, box_of, check_loop_proof, loop_model, prove_level
from lftkit.proofs.trusted.arithmetic import Ball, definite_ratio, positive
from lftkit.proofs.trusted.noise import NoisePart, NoiseProof, check_noise_proof, window_power
from lftkit.proofs.trusted.polynomials import Polynomial, constant, inverse, reciprocal, span, weighted_share
from lftkit.proofs.trusted.proof import Strip
from lftkit.proofs.trusted.stability import nominal_windows, windows_above

POWERS = (-320, -160, 160, 308)
VALUES = (math.inf, math.nan, 5e-324, 1e308, -1e308)


def indefinite() -> ComplexArray:
    """Hermitian, with eigenvalues -1 and 3."""
    return np.array([[1.0, 2.0j], [-2.0j, 1.0]])


@pytest.mark.parametrize("power", POWERS)
def test_a_form_that_is_not_definite_is_refused_at_every_scale(power: int) -> None:
    scale = float(f"1e{power}")
    with np.errstate(all="ignore"):
        for form in (indefinite(), -np.eye(2), np.zeros((2, 2))):
            assert not positive(scale * form, np.zeros((2, 2)))
            assert not positive(form, np.full((2, 2), scale))
        assert definite_ratio(Ball(scale * np.array([[0.5, 1.0], [1.0, 0.5]]))) == 0.0


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("entry", [(0, 0), (0, 2), (2, 1)])
def test_a_number_out_of_range_in_any_entry_is_refused(value: float, entry: tuple[int, int]) -> None:
    """In the matrix or in the bound of its error; one that is tiny off the diagonal leaves it definite."""
    matrix, rest = np.eye(3), np.zeros((3, 3))
    matrix[entry] = value
    harmless = abs(value) < 1.0 and entry[0] != entry[1]
    for own in (matrix, matrix.astype(complex)):
        assert positive(own, rest) == harmless or (value == 1e308 and entry[0] == entry[1]) == positive(own, rest)
    rest[entry] = abs(value)
    assert positive(np.eye(3), rest) == (abs(value) < 1.0)


def test_rounding_is_counted_as_in_a_matrix_that_is_just_definite() -> None:
    """Random factors: positive where the smallest eigenvalue is well above rounding, not where it is below zero."""
    rng = np.random.default_rng(4)
    for n in (1, 2, 7, 40):
        half = rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))
        matrix = half @ half.conj().T
        least = float(np.linalg.eigvalsh(matrix)[0])
        size = float(np.trace(matrix).real)
        assert positive(matrix + (1e-10 * size - least) * np.eye(n), np.zeros((n, n)))
        assert not positive(matrix - (1e-10 * size + least) * np.eye(n), np.zeros((n, n)))


INFINITE = (math.inf, -math.inf, math.nan, complex(0.0, math.nan))
SINGULAR = (np.zeros((2, 2)), np.full((2, 2), 1e300), np.full((2, 2), 5e-324), np.diag([1e-320, 1.0]))
LARGE = np.full((2, 2), 1e200)


@pytest.mark.parametrize(
    "make",
    [
        *(lambda value=value: constant(np.array([[1.0, value]])) for value in INFINITE),
        *(lambda value=value: Polynomial(np.ones((1, 2)), np.array([1.0, abs(value)])) for value in INFINITE),
        lambda: constant(LARGE) @ constant(LARGE),
        *(lambda matrix=matrix: inverse(constant(matrix)) for matrix in SINGULAR),
        lambda: reciprocal(constant(np.array([5e-324]))),
        lambda: reciprocal(Polynomial(np.array([[1.0], [0.95]]), np.zeros(1))),
        lambda: reciprocal(Polynomial(np.array([[0.0], [0.5]]), np.zeros(1))),
    ],
)
def test_no_polynomial_is_made_of_or_of_arithmetic_with_numbers_out_of_range(make: Callable[[], object]) -> None:
    """Nor of a reciprocal near a zero; LAPACK inverts some of the matrices."""
    with np.errstate(all="ignore"), pytest.raises(ArithmeticError):
        make()


def test_a_window_contains_its_ends_among_the_smallest_numbers() -> None:
    for low, high in ((0.0, 5e-324), (5e-324, 1e-323), (1e-310, 1.1e-310)):
        middle, half = span(low, high)
        assert middle - half <= low and middle + half >= high


def test_a_share_of_subnormal_sizes_is_no_small_share() -> None:
    """Sizes that underflow would make a row sum of 0.95 nothing."""
    bound = np.array([[0.0, 1e160, 0.0], [0.0, 0.0, 1e160], [0.0, 0.0, 0.95]])
    with np.errstate(all="ignore"):
        assert not weighted_share(bound)[0] < 0.95


@pytest.fixture(scope="module")
def loop() -> LoopProof:
    system = aligned_modes(1, damping=0.1)
    model, box, band = loop_model(system, dt=0.5), box_of(system), (0.0, 6.28)
    found = prove_level(model, box, band, level=11.0)
    assert not found.uncovered
    return LoopProof(model, tuple(p.name for p in system.parameters), box, band, 11.0, tuple(found.strips))


def scaled(strips: Any, factor: float) -> Any:
    """All scalings times a factor, which leaves a true inequality true and a false one false."""
    with np.errstate(all="ignore"):
        return tuple(
            dataclasses.replace(
                s, D=tuple(factor * m for m in s.D), G=tuple(factor * m for m in s.G), factor=factor * s.factor
            )
            for s in strips
        )


@pytest.mark.parametrize("power", POWERS)
def test_scaled_scalings_prove_no_lower_level(loop: LoopProof, power: int) -> None:
    """The gain of the modes is 5: no level below it must be proven by overflow."""
    strips = scaled(loop.strips, float(f"1e{power}"))
    with pytest.raises(ProofError):
        check_loop_proof(dataclasses.replace(loop, strips=strips, level=4.9), stability=False)


@pytest.mark.parametrize("value", VALUES)
def test_one_scaling_out_of_range_proves_no_lower_level(loop: LoopProof, value: float) -> None:
    for name in ("D", "G", "factor"):
        given = [getattr(strip, name) for strip in loop.strips]
        full = [
            np.full(g.shape, value) if name == "factor" else tuple(np.full(m.shape, value + 0j) for m in g)
            for g in given
        ]
        strips = tuple(dataclasses.replace(strip, **{name: one}) for strip, one in zip(loop.strips, full))
        with pytest.raises(ProofError):
            check_loop_proof(dataclasses.replace(loop, strips=strips, level=0.01), stability=False)


@pytest.mark.parametrize("name", ["C", "B", "D", "weights", "poles"])
@pytest.mark.parametrize("value", VALUES)
def test_a_loop_of_numbers_out_of_range_is_refused_or_bounded(loop: LoopProof, name: str, value: float) -> None:
    """Two entries of each matrix of the model: refused, but for entries that are about zero as before."""
    array = getattr(loop.model, name)
    for place in list(np.ndindex(array.shape))[:2]:
        changed = array.copy()
        changed[place] = value
        forged = dataclasses.replace(loop, model=dataclasses.replace(loop.model, **{name: changed}), level=0.01)
        with pytest.raises(ProofError):
            check_loop_proof(forged)


def test_a_loop_of_huge_numbers_is_not_called_stable(loop: LoopProof) -> None:
    for name, factor in (("C", 1e300), ("B", 1e300), ("D", 1e308)):
        changed = getattr(loop.model, name) * factor + (factor if name == "D" else 0.0)
        model = dataclasses.replace(loop.model, **{name: changed})
        try:
            found = nominal_windows(model) and windows_above(model, loop.box)
        except (ArithmeticError, ValueError):
            found = 0
        assert not found


@pytest.fixture(scope="module")
def cells() -> dict[str, Any]:
    bounds = worst_case_gain(aligned_modes(1, damping=0.1), options=BoundOptions(method="cells"))
    assert bounds.proof is not None
    return dict(bounds.proof.content)


def leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all numbers of a JSON value."""
    if isinstance(value, (dict, list)):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return [found for key, item in items for found in leaves(item, (*path, key))]
    return [path] if isinstance(value, (int, float)) else []


def changed(content: dict[str, Any], change: dict[tuple[Any, ...], Any]) -> dict[str, Any]:
    def put(found: dict[str, Any]) -> None:
        for path, value in change.items():
            entry(found, path[:-1])[path[-1]] = value

    return forged(content, put)


def entry(content: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        content = content[key]
    return content


@pytest.mark.parametrize("power", POWERS)
def test_scaled_cells_prove_no_lower_level(cells: dict[str, Any], power: int) -> None:
    """P, Q, D, G and the factor of a cell times a power of ten, and a level that is exceeded."""
    scaled = {
        path: float(f"1e{power}") * entry(cells, path)
        for path in leaves(cells)
        if path[0] == "cells" and path[2] in ("P", "Q", "D", "G", "performance")
    }
    with pytest.raises(ProofError):
        check_proof(changed(cells, {**scaled, ("claim", "level"): 0.01 * cells["claim"]["level"]}))


@pytest.mark.parametrize("value", VALUES)
def test_any_number_of_cells_out_of_range_proves_no_lower_level(cells: dict[str, Any], value: float) -> None:
    low = changed(cells, {("claim", "level"): 0.01 * cells["claim"]["level"]})
    numbers = [path for path in leaves(low) if path[0] in ("cells", "stable")]
    for path in numbers[:: max(len(numbers) // 25, 1)]:
        with pytest.raises(ProofError):
            check_proof(changed(low, {path: value}))


@pytest.mark.further
def test_an_axis_proof_of_scaled_scalings_proves_no_lower_level() -> None:
    bounds = worst_case_gain(aligned_modes(1, damping=0.1), options=BoundOptions(method="axis"))
    proof = bounds.proof
    assert isinstance(proof, AxisProof) and check_proof(proof)
    for power in POWERS:
        sides = {side: scaled(getattr(proof, side), float(f"1e{power}")) for side in ("below", "above")}
        with pytest.raises(ProofError):
            check_proof(dataclasses.replace(proof, level=0.01 * bounds.lower, **sides))


@pytest.mark.parametrize("power", POWERS)
def test_a_certificate_of_mu_at_any_scale_proves_no_lower_bound(power: int) -> None:
    M, structure = np.array([[2.0, 2.0], [-1.0, -1.0]], complex), [real_block(), real_block()]
    own = mu(M, structure).certificate
    assert own is not None
    scale = float(f"1e{power}")
    with np.errstate(all="ignore"):
        D, G = (tuple(scale * m for m in part) for part in (own.D, own.G))
    for level in (0.5 * own.level, 1e-300, 1e-160):
        with pytest.raises(ProofError):
            check_mu(M, structure, dataclasses.replace(own, D=D, G=G, level=level))


def test_noise_of_a_level_that_overflows_is_refused(loop: LoopProof) -> None:
    band = (0.0, math.pi / loop.model.dt)
    for level in (1e200, 1e308):
        part = NoisePart(loop.model.rows, band, level, loop.strips)
        with pytest.raises(ProofError):
            check_noise_proof(NoiseProof(loop.model, loop.names, loop.box, (part,)))


def test_the_weight_of_the_relative_error_is_bounded_from_above_however_slow() -> None:
    """One less something near one loses all digits at a small frequency."""
    with mp.workdps(60):
        for y in (1e-300, 1e-12, 1e-8, 1e-6, 1e-3, 0.1, 1.0, 10.0, 1e3):
            at = mp.mpf(y)
            assert mp.mpf(window_power(y)) >= 1 - 144 / (at**4 + 12 * at**2 + 144)


@pytest.mark.parametrize("exponent", [307.6, 307.8, 307.95])
@pytest.mark.parametrize("factor", [1.0, 1e300])
def test_a_form_that_overflows_as_it_is_made_hermitian_proves_nothing(exponent: float, factor: float) -> None:
    """A mode of gain 5 and one number as all scalings: "below 0.01 of the limit" was accepted."""
    p = RealParameter("p", 0.0, -1.0, 1.0)
    B, C = [[0.0, 0.0], [-0.1, 1.0]], [[0.1, 0.0], [1.0, 0.0]]
    ports = [Port("f", 1)], [Port("x", 1)]
    mode = System([[0.0, 1.0], [-1.0, -0.2]], B, C, np.zeros((2, 2)), *ports, channels=("p",), elements=(p,))
    model, box, band = loop_model(mode, dt=0.1), box_of(mode), (0.0, math.pi / 0.1)
    nodes = np.array([0.0, *np.geomspace(1e-3, band[1], 60)])
    D = np.full((61, 1, 1), 10.0**exponent, complex)
    strip = Strip(box, nodes, (D,), (0.0 * D,), np.full(61, factor))
    with pytest.raises(ProofError):
        check_loop_proof(LoopProof(model, ("p",), box, band, 0.01, (strip,)), stability=False)
