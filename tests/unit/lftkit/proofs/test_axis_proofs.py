"""Bounds over the frequency axis: enclosures hold, proofs of real and complex elements pass, altered ones do not."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import linalg
from support.slow_cases import slow
from support.uncertain_examples import aligned_modes, chain_of_masses, transport_aircraft

from lftkit import RealParameter, System, complex_gain, dynamic, hinf_norm, real, s
from lftkit.analysis.frequency_response import refined_response
from lftkit.proofs import BoundOptions, ProofError, check_proof, robust_performance, robust_stability, worst_case_gain
from lftkit.proofs.axis.bounds import _Axis, axis_takes, modal_form
from lftkit.proofs.axis.proof import AxisModel, AxisProof
from lftkit.proofs.trusted.axis import check_axis_proof, neumann
from lftkit.proofs.trusted.proof import REAL, Strip
from lftkit.uncertainty.elements import DynamicElement

AXIS, CELLS = (BoundOptions(wall_limit=3600.0, method=method) for method in ("axis", "cells"))
axis_gain, axis_stability = (partial(f, options=AXIS) for f in (worst_case_gain, robust_stability))


@pytest.mark.parametrize("radius", [1e-9, 0.1, 0.5, 0.85])
@pytest.mark.parametrize("n", [1, 2, 5])
def test_errors_of_a_pencil_are_bounded_up_to_nine_tenths_of_its_size(n: int, radius: float) -> None:
    """Of all errors within a share the share itself, with the sign of a pole, has the largest ``(I - S)^-1 - I``."""
    rng = np.random.default_rng(n)
    share = rng.uniform(0.0, 1.0, (n, n)) * 10.0 ** rng.uniform(-4.0, 4.0, (n, 1)) / 10.0 ** rng.uniform(-4.0, 4.0, n)
    share *= radius / np.abs(linalg.eigvals(share)).max()
    exact = linalg.inv(np.eye(n) - share) - np.eye(n)
    assert np.all(exact <= neumann(share))
    with pytest.raises(ArithmeticError, match="may have a pole"):
        neumann(share / radius)


def random_system(seed: int) -> System:
    """Five states, three parameters of which one occurs twice, with feedthrough everywhere."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(5, 5))
    A -= (linalg.eigvals(A).real.max() + 0.3) * np.eye(5)
    D = 0.2 * rng.normal(size=(6, 5))
    parameters = tuple(
        RealParameter(f"p{i}", 1.0, 1.0 - rng.uniform(0.1, 0.3), 1.0 + rng.uniform(0.1, 0.3)) for i in range(3)
    )
    B, C = 0.5 * rng.normal(size=(5, 5)), 0.5 * rng.normal(size=(6, 5))
    return System(A, B, C, D, [("u", 1)], [("y", 2)], channels=("p0", "p1", "p2", "p1"), elements=parameters)


@pytest.fixture(scope="module")
def proof() -> AxisProof:
    bounds = axis_gain(chain_of_masses(2, 0.2))
    assert bounds.status == "closed" and isinstance(bounds.proof, AxisProof)
    return bounds.proof


def test_windows_contain_the_responses_of_the_given_matrices() -> None:
    """At 400 points of random windows, on both sides of the border, to 1e-9 of the response where windows are short."""
    rng = np.random.default_rng(1)
    for seed in range(4):
        system = random_system(seed)
        for beyond in (False, True):
            matrices = system.A, system.B, system.C, system.D, *modal_form(system.A)
            model = AxisModel(*matrices, ((0,), (1, 3), (2,)), (REAL,) * 3, beyond)
            assert model.nominal_stable()
            V = rng.normal(size=(5, 4)) + 1j * rng.normal(size=(5, 4))
            for width in (1e-6, 0.02):
                middle = rng.uniform(0.1, 1.5)
                parts = model.responses(middle, width, V)
                for t in (-1.0, *rng.uniform(-1.0, 1.0, 5), 1.0):
                    x = middle + width * t
                    exact = refined_response(system.A, system.B, system.C, system.D, 1.0 / x if beyond else x) @ V
                    for part, rows in zip(parts, (exact[:4], exact[4:])):
                        value = sum(c * t**k for k, c in enumerate(part.c))
                        assert np.all(np.abs(value - rows) <= part.rad + 1e-13)
                        assert np.all(part.rad < 1e-9 if width < 1e-3 else 1.0)


def test_an_inexact_basis_of_eigenvectors_is_within_the_bound() -> None:
    """T and X come from a file: any will do, their error is part of the remainder."""
    system, rng = random_system(2), np.random.default_rng(0)
    poles, T, X = modal_form(system.A)
    for size, passes in ((1e-6, True), (1e-3, True), (3.0, False)):
        wrong = X + size * rng.normal(size=X.shape) * np.abs(X)
        matrices = system.A, system.B, system.C, system.D, poles, T, wrong
        model = AxisModel(*matrices, ((0,), (1, 3), (2,)), (REAL,) * 3, False)
        if not passes:
            with pytest.raises(ArithmeticError):
                model.responses(0.7, 1e-3, np.eye(5, dtype=complex))
            assert not model.nominal_stable()
            continue
        z, e = model.responses(0.7, 1e-3, np.eye(5, dtype=complex))
        exact = refined_response(system.A, system.B, system.C, system.D, 0.7)
        assert np.all(np.abs(z.c[0] - exact[:4]) <= z.rad) and np.all(np.abs(e.c[0] - exact[4:]) <= e.rad)


def _system(proof: AxisProof, **changes: Any) -> dict[str, Any]:
    return {"system": replace(proof.system, **changes)}


def _without(name: str) -> Callable[[AxisProof], dict[str, Any]]:
    return lambda p: {name: getattr(p, name)[1:]}


@pytest.mark.parametrize(
    "change",
    [
        lambda p: {"level": 0.93 * p.level},  # the gain that was found is at least 0.952 of it
        lambda p: {"level": np.inf},
        lambda p: {"kind": "stability"},
        _without("below"),
        _without("above"),
        lambda p: {"box": ((0.8, 1.2), (0.8, 1.2 + 1e-9))},
        lambda p: {"nominal": (1.0, 1.0 + 1e-9)},
        lambda p: _system(p, A=p.system.A + 0.02 * np.eye(4)),  # less damping
        lambda p: _system(p, A=p.system.A * np.nan),
        lambda p: _system(p, B=1.1 * p.system.B),
        lambda p: _system(p, X=0.0 * p.system.X),
        lambda p: _system(p, poles=-p.system.poles),
        lambda p: {"border": 0.5 * p.border},
        lambda p: {"border": 1.1 * p.border},
        lambda p: _system(p, groups=((0,), (0,))),
        lambda p: {"below": tuple(replace(s, factor=-s.factor) for s in p.below)},
        lambda p: {"below": tuple(replace(s, D=tuple(0.0 * d for d in s.D)) for s in p.below)},
        lambda p: {"below": tuple(replace(s, D=tuple(-d for d in s.D)) for s in p.below)},
        lambda p: {"above": tuple(replace(s, nodes=0.5 * s.nodes) for s in p.above)},
    ],
)
def test_what_is_altered_is_refused(proof: AxisProof, change: Callable[[AxisProof], dict[str, Any]]) -> None:
    with pytest.raises(ProofError):
        check_axis_proof(replace(proof, **change(proof)))


@pytest.mark.further
def test_a_proof_of_a_smaller_box_or_a_higher_level_passes_too(proof: AxisProof) -> None:
    """What follows from a claim is no forgery."""
    assert proof.level is not None
    check_axis_proof(replace(proof, level=2.0 * proof.level))
    check_axis_proof(replace(proof, box=((0.9, 1.1), (0.85, 1.2))))


@pytest.mark.parametrize("seed", [0, *(slow(seed) for seed in range(1, 6))])
def test_bounds_are_those_of_the_other_prover(seed: int) -> None:
    system = random_system(seed)
    here, there = axis_gain(system), worst_case_gain(system, options=CELLS)
    assert here.status == there.status
    if here.status == "unstable":
        return
    assert here.lower == pytest.approx(there.lower, rel=1e-6)
    assert here.lower <= here.upper <= 1.05 * here.lower and there.lower <= here.upper
    assert check_axis_proof(here.proof).stable


@pytest.mark.further
@pytest.mark.parametrize("band", [(2.0, np.inf), *(slow(band) for band in ((0.0, 0.5), (0.5, 3.0), (300.0, 400.0)))])
def test_a_band_is_closed_and_checked(band: tuple[float, float]) -> None:
    bounds = axis_gain(aligned_modes(2, damping=0.05), band=band)
    assert bounds.status == "closed" and bounds.upper <= 1.05 * bounds.lower
    checked = check_axis_proof(bounds.proof)
    assert checked.band == band and not checked.stable


@pytest.mark.further
def test_levels_and_boxes() -> None:
    system = aligned_modes(2, damping=0.05)
    assert axis_gain(system, level=19.0).status == "violated"  # 20 is reached
    assert axis_gain(system, level=21.0).upper == 21.0
    fixed = axis_gain(system, {"k0": (1.0, 1.0)})
    assert fixed.status == "closed" and check_axis_proof(fixed.proof).box["k0"] == (1.0, 1.0)
    late = axis_gain(system, options=replace(AXIS, wall_limit=1e-9))
    assert late.upper == np.inf and late.status == "out_of_time" and late.uncovered
    with pytest.raises(ValueError, match="nominal member must be in the box"):
        axis_gain(system, {"k0": (1.5, 2.0)})


def test_what_a_level_leaves_is_proven_for_a_higher_one() -> None:
    """A spring in [0.8, 1.2] and a damper of 0.1: pieces without the nominal one are left."""
    k = RealParameter("k", 1.0, 0.8, 1.2)
    A, B, C = [[0, 1], [-1, -0.1]], [[0, 0], [-1, 1]], [[1, 0], [1, 0]]
    mode = System(A, B, C, np.zeros((2, 2)), [("f", 1)], [("x", 1)], channels=("k",), elements=(k,))
    axis = _Axis.of(mode, "gain", [(0.8, 1.2)], (0.9, 1.0))
    assert not axis.prove(11.0, math.inf) and axis.worst is not None and 11.0 <= axis.worst.gain < 11.2
    assert axis.prove(13.0, math.inf) and check_axis_proof(axis.finished(13.0)).level == 13.0


@pytest.mark.further
def test_a_margin_where_the_interconnection_becomes_singular() -> None:
    """``z = w + x``: at p = 1 the loop of the LFT is singular; with x driven by w it is unstable from p = 1/2."""
    p = RealParameter("p", 0.0, -1.0, 1.0)
    for driven, margin in ((1.0, 0.5), (0.0, 1.0)):
        system = System([[-1.0]], [[driven]], [[driven]], [[1.0]], (), (), channels=("p",), elements=(p,))
        bounds = axis_stability(system)
        assert bounds.upper == pytest.approx(margin, rel=1e-6) and margin <= 1.05 * bounds.lower <= 1.05 * margin
        assert check_axis_proof(bounds.proof).stable


def test_what_the_method_cannot_take_is_a_line_and_goes_to_the_other() -> None:
    ports = [("u", 1)], [("y", 1)]
    p = RealParameter("p", 0.0, -0.1, 0.1)
    A = np.diag(-np.ones(7)) + np.diag(np.ones(6), 1)  # no basis of eigenvectors
    B, C = np.zeros((7, 2)), np.zeros((2, 7))
    B[6], C[0, 6], C[1, 0] = 1.0, 1.0, 1.0
    chain = System(A, B, C, np.zeros((2, 2)), *ports, channels=("p",), elements=(p,))
    certain = System([[-1.0]], [[1.0]], [[1.0]], [[0.0]], *ports)
    for system, message in ((chain, "separate poles"), (certain, "must have uncertain elements")):
        with pytest.raises(ValueError, match=message):
            axis_gain(system)
        with pytest.raises(ValueError, match=message):
            axis_stability(system)
    assert worst_case_gain(certain).status == "closed"
    assert not axis_takes(chain, [(-0.1, 0.1)])


@pytest.mark.slow
def test_the_margin_of_the_aircraft_to_ten_percent() -> None:
    bounds = axis_stability(transport_aircraft(), options=replace(AXIS, gap=0.1))
    assert bounds.status == "closed" and bounds.upper <= 1.1 * bounds.lower
    assert check_axis_proof(bounds.proof).stable


@pytest.mark.slow
@pytest.mark.parametrize("count", [12, 16])
def test_chains_of_many_uncertain_springs(count: int) -> None:
    bounds = axis_gain(chain_of_masses(count, 0.2, damping=0.03))
    assert bounds.status == "closed" and bounds.upper <= 1.05 * bounds.lower
    assert check_axis_proof(bounds.proof).stable


LONG = BoundOptions(wall_limit=3600.0)


def lags(outputs: int, inputs: int, order: int = 0) -> System:
    """``(s + 1) x = Delta x' + u`` of a matrix of norm 0.5, x' the first entries of x, before `order` fast lags."""
    n = max(outputs, inputs)
    into, out = np.diag(np.arange(n) < outputs) * 1.0, np.diag(np.arange(n) < inputs) * 1.0
    B, C, D = np.hstack([into, np.eye(n)]), np.vstack([out, np.eye(n)]), np.zeros((2 * n, 2 * n))
    element = DynamicElement("f", outputs, inputs, 0.5)
    core = System(-np.eye(n), B, C, D, [("u", n)], [("y", n)], channels=("f",) * n, elements=(element,))
    return fast(order).system("y", "v") @ core if order else core


def fast(order: int) -> Any:
    """Lags with separate poles of -50 rad/s and beyond."""
    return math.prod([1 / (0.02 * s / (1 + 0.2 * k) + 1) for k in range(order)])


@pytest.mark.further
@pytest.mark.parametrize("sizes", [(1, 1), (3, 3), (2, 1)])
def test_a_matrix_by_hand(sizes: tuple[int, int], tmp_path: Path) -> None:
    """Gain 1 / (1 - 0.5) at zero where Delta is square, unstable from twice the bound on."""
    system = lags(*sizes)
    gain = worst_case_gain(system, options=AXIS)
    assert gain.status == "closed" and gain.lower <= gain.upper <= 1.05 * gain.lower
    member = system.at(gain.point)
    assert hinf_norm(*member.matrices).value == pytest.approx(gain.lower, rel=1e-6)
    if sizes[0] == sizes[1]:
        assert gain.lower == pytest.approx(2.0, rel=1e-6)
    gain.proof.to_file(tmp_path / "proof.npz")
    checked = check_proof(tmp_path / "proof.npz")
    assert checked.stable and checked.disks == {"f": 0.5} and checked.box == {}
    margin = robust_stability(system, options=AXIS)
    assert margin.upper == pytest.approx(2.0, rel=1e-6) and 2.0 / 1.05 <= margin.lower <= 2.0


def mixed(order: int) -> System:
    """A mode with an uncertain stiffness, a complex number in its damping and dynamics at its input."""
    k, c = real("k", 1.0, percent=20), complex_gain("c", 0.0, radius=0.04)
    mode = 1 / (s**2 + (0.2 + c) * s + k)
    return (mode * (1 + 0.3 * dynamic("f")) * fast(order)).system("u", "y")


@pytest.mark.slow
def test_the_bounds_of_cells_and_of_the_axis_agree() -> None:
    cells, axis = (worst_case_gain(mixed(0), options=replace(LONG, gap=0.3, method=m)) for m in ("cells", "axis"))
    assert axis.status == cells.status == "closed" and axis.lower == pytest.approx(cells.lower, rel=1e-5)
    assert max(axis.lower, cells.lower) <= min(axis.upper, cells.upper)


@pytest.mark.further
def test_more_states_than_cells_take() -> None:
    """Members at random, with every value at its bound, stay below; the one that is named reaches the lower bound."""
    system = mixed(6)
    assert system.order > 7
    bounds = worst_case_gain(system, options=replace(LONG, gap=0.3))
    assert bounds.status == "closed" and isinstance(bounds.proof, AxisProof) and check_proof(bounds.proof).stable
    rng = np.random.default_rng(0)
    gains = []
    for _ in range(2000):
        values = {"k": rng.choice([0.8, rng.uniform(0.8, 1.2)]), "f": np.exp(2j * np.pi * rng.random())}
        values["c"] = 0.04 * np.exp(2j * np.pi * rng.random())
        gains.append(float(abs(_response(system, bounds.frequency * rng.uniform(0.97, 1.03), values)[0, 0])))
    named = {**bounds.point, "f": bounds.point["f"](1j * bounds.frequency)}  # type: ignore[operator]
    there = abs(_response(system, bounds.frequency, named)[0, 0])
    assert there == pytest.approx(bounds.lower, rel=1e-6) and 0.9 * there < max(gains) <= bounds.upper


def _response(system: System, omega: float, values: dict[str, Any]) -> Any:
    """Of a member at a frequency, from the matrices."""
    q = len(system.channels)
    M = system.C @ linalg.solve(1j * omega * np.eye(system.order) - system.A, system.B) + system.D
    nominal = {"k": 1.0, "c": 0.0, "f": 0.0}
    delta = np.diag([values[name] - nominal[name] for name in system.channels])
    return M[q:, q:] + M[q:, :q] @ delta @ linalg.solve(np.eye(q) - M[:q, :q] @ delta, M[:q, q:])


@pytest.mark.further
def test_robust_performance_of_more_states() -> None:
    """``1 / (s + 1 - f)`` behind fast lags has the gain ``1 / (1 - 0.5 m)``: 1.5 from two thirds of the bound on."""
    bounds = robust_performance(lags(1, 1, 8), 1.5, options=LONG)
    assert bounds.status == "closed" and isinstance(bounds.proof, AxisProof)
    assert bounds.upper == pytest.approx(2.0 / 3.0, rel=1e-5) and bounds.lower <= bounds.upper <= 1.05 * bounds.lower


@pytest.fixture(scope="module")
def full() -> AxisProof:
    proof = worst_case_gain(lags(3, 3), options=AXIS).proof
    assert isinstance(proof, AxisProof) and check_axis_proof(proof).stable
    return proof


def _strips(proof: AxisProof, change: Callable[[Strip], Strip]) -> dict[str, Any]:
    return {side: tuple(change(strip) for strip in getattr(proof, side)) for side in ("below", "above")}


@pytest.mark.further
@pytest.mark.parametrize(
    "change",
    [
        lambda p: {"system": replace(p.system, kinds=("whole",))},
        lambda p: {"system": replace(p.system, kinds=())},
        lambda p: {"nominal": (0.1,)},
        lambda p: {"box": ((-0.5, 0.4),)},
        lambda p: {"box": ((-0.6, 0.6),)},
        lambda p: _strips(p, lambda s: replace(s, box=((0.0, 0.6),))),
        lambda p: _strips(p, lambda s: replace(s, box=((-0.5, s.box[0][1]),))),
        lambda p: _strips(p, lambda s: replace(s, G=(s.G[0] + 1e-3 * np.abs(s.D[0]).max() * np.eye(3),))),
        lambda p: _strips(p, lambda s: replace(s, D=(s.D[0] * np.diag([1.0, 1.0 + 1e-9, 1.0]),))),
        lambda p: _strips(p, lambda s: replace(s, D=(s.D[0] + 1e-9 * np.abs(s.D[0]).max() * (1 - np.eye(3)),))),
    ],
)
def test_what_is_altered_of_a_matrix_of_dynamics_is_refused(
    full: AxisProof, change: Callable[[AxisProof], dict[str, Any]]
) -> None:
    with pytest.raises(ProofError):
        check_axis_proof(replace(full, **change(full)))


@pytest.mark.further
def test_a_weaker_claim_follows(full: AxisProof) -> None:
    """A smaller matrix, one number in place of the matrix, real or complex."""
    check_axis_proof(replace(full, box=((-0.4, 0.4),)))
    for kind in ("complex", "real"):
        check_axis_proof(replace(full, system=replace(full.system, kinds=(kind,))))


@pytest.mark.further
def test_a_proof_of_a_real_parameter_is_none_of_a_complex_one() -> None:
    """A real change of the stiffness by 0.15 leaves the mode stable, one of -0.1j takes its damping."""
    system = (1 / (s**2 + 0.1 * s + 1 + real("p", 0.0, -0.15, 0.15))).system("u", "y")
    proof = worst_case_gain(system, options=AXIS).proof
    assert isinstance(proof, AxisProof) and check_axis_proof(proof).stable
    with pytest.raises(ProofError, match="must have a whole disk, G zero"):
        check_axis_proof(replace(proof, system=replace(proof.system, kinds=("complex",))))
