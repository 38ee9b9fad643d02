"""Complex numbers and dynamics in bounds over the frequency axis: closed forms, members, forged proofs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from lftkit import System, complex_gain, dynamic, hinf_norm, real, s
from lftkit.proofs import BoundOptions, ProofError, check_proof, robust_performance, robust_stability, worst_case_gain
from lftkit.proofs.axis import AxisProof
from lftkit.proofs.trusted.axis import check_axis_proof
from lftkit.proofs.trusted.proof import Strip
from lftkit.uncertainty.elements import DynamicElement

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


@pytest.mark.parametrize("sizes", [(1, 1), (3, 3), (2, 1)])
def test_a_matrix_by_hand(sizes: tuple[int, int], tmp_path: Path) -> None:
    """Gain 1 / (1 - 0.5) at zero where Delta is square, unstable from twice the bound on."""
    system = lags(*sizes)
    gain = worst_case_gain(system, options=replace(LONG, method="axis"))
    assert gain.status == "closed" and gain.lower <= gain.upper <= 1.05 * gain.lower
    member = system.at(gain.point)
    assert hinf_norm(*member.matrices).value == pytest.approx(gain.lower, rel=1e-6)
    if sizes[0] == sizes[1]:
        assert gain.lower == pytest.approx(2.0, rel=1e-6)
    gain.proof.to_file(tmp_path / "proof.npz")
    checked = check_proof(tmp_path / "proof.npz")
    assert checked.stable and checked.disks == {"f": 0.5} and checked.box == {}
    margin = robust_stability(system, options=replace(LONG, method="axis"))
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


def test_robust_performance_of_more_states() -> None:
    """``1 / (s + 1 - f)`` behind fast lags has the gain ``1 / (1 - 0.5 m)``: 1.5 from two thirds of the bound on."""
    bounds = robust_performance(lags(1, 1, 8), 1.5, options=LONG)
    assert bounds.status == "closed" and isinstance(bounds.proof, AxisProof)
    assert bounds.upper == pytest.approx(2.0 / 3.0, rel=1e-5) and bounds.lower <= bounds.upper <= 1.05 * bounds.lower


@pytest.fixture(scope="module")
def full() -> AxisProof:
    proof = worst_case_gain(lags(3, 3), options=replace(LONG, method="axis")).proof
    assert isinstance(proof, AxisProof) and check_axis_proof(proof).stable
    return proof


def _strips(proof: AxisProof, change: Callable[[Strip], Strip]) -> dict[str, Any]:
    return {side: tuple(change(strip) for strip in getattr(proof, side)) for side in ("below", "above")}


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
def test_what_is_altered_is_refused(full: AxisProof, change: Callable[[AxisProof], dict[str, Any]]) -> None:
    with pytest.raises(ProofError):
        check_axis_proof(replace(full, **change(full)))


def test_a_weaker_claim_follows(full: AxisProof) -> None:
    """A smaller matrix, one number in place of the matrix, real or complex."""
    check_axis_proof(replace(full, box=((-0.4, 0.4),)))
    for kind in ("complex", "real"):
        check_axis_proof(replace(full, system=replace(full.system, kinds=(kind,))))


def test_a_proof_of_a_real_parameter_is_none_of_a_complex_one() -> None:
    """A real change of the stiffness by 0.15 leaves the mode stable, one of -0.1j takes its damping."""
    system = (1 / (s**2 + 0.1 * s + 1 + real("p", 0.0, -0.15, 0.15))).system("u", "y")
    proof = worst_case_gain(system, options=replace(LONG, method="axis")).proof
    assert isinstance(proof, AxisProof) and check_axis_proof(proof).stable
    with pytest.raises(ProofError, match="must have a whole disk, G zero"):
        check_axis_proof(replace(proof, system=replace(proof.system, kinds=("complex",))))
