"""Published answers of robustness analysis lie between the proven and the found bound."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from published.values.robustness import SLICOT
from support.uncertain_examples import aligned_modes, de_gaston_safonov, tangent_crossing, two_mass_benchmark

from lftkit.proofs import BoundOptions, check_proof, robust_stability, worst_case_gain
from lftkit.proofs.state_space.barrier import FULL, REAL, BarrierBlock
from lftkit.proofs.state_space.scaling_search import find_scalings

LONG = BoundOptions(wall_limit=3600.0)
"""Wall limit [s] that no machine reaches; the number of cells ends a computation."""


def test_the_example_of_slicot_ab13md() -> None:
    """Two real scalars, a full 2 x 2 block and two complex scalars: upper bound 41.74753408 of mu."""
    inputs = np.eye(6, dtype=complex)
    structure = [(REAL, slice(0, 1)), (REAL, slice(1, 2)), *((FULL, slice(*ends)) for ends in ((2, 4), (4, 5), (5, 6)))]

    def passes(level: float) -> bool:
        blocks = [BarrierBlock(kind, SLICOT[part] / level, inputs[part]) for kind, part in structure]
        return find_scalings(blocks, precision=1e-12).margin > 0.0

    assert passes(41.74753408 * (1 + 1e-7))
    assert not passes(41.74753408 * (1 - 1e-7))


def test_the_stability_margin_of_de_gaston_and_safonov() -> None:
    bounds = robust_stability(de_gaston_safonov(), options=LONG)
    assert bounds.status == "closed"
    assert bounds.lower < 3.41740 and bounds.upper == pytest.approx(3.41740, abs=1e-5)
    assert bounds.upper <= 1.05 * bounds.lower
    assert bounds.proof is not None and check_proof(bounds.proof.content).stable


@pytest.mark.slow
def test_the_margin_of_the_two_mass_benchmark() -> None:
    bounds = robust_stability(two_mass_benchmark(), options=LONG)
    assert bounds.status == "closed" and bounds.lower < 2.8826
    assert bounds.upper == pytest.approx(2.8864, abs=1e-4) and bounds.upper <= 1.05 * bounds.lower
    assert bounds.frequency == pytest.approx(575.0339, abs=0.01)
    assert bounds.point["k"] == pytest.approx(1.5773, abs=1e-3)
    assert bounds.proof is not None
    checked: Any = check_proof(bounds.proof.content)
    assert checked.box["m1"][0] < 0.45


def test_the_stiffness_margin_of_the_two_mass_benchmark() -> None:
    """With the spring alone the characteristic polynomial is affine in k: its roots give the crossing."""
    system = two_mass_benchmark(masses=False)
    bounds = robust_stability(system, options=LONG)
    lead = 100.0 * np.poly1d([1.0, 1.0]) ** 3
    lag = np.poly1d([1e-3, 1.0]) ** 3
    fixed, by_k = np.poly1d([1.0, 0, 0, 0, 0]) * lag, np.poly1d([2.0, 0, 0]) * lag + lead
    crossings = []
    for w in _imaginary_roots(fixed, by_k):
        k = -(fixed(1j * w) / by_k(1j * w)).real
        crossings.append(abs(k - 1.0) / 0.2)
    assert bounds.lower < min(crossings) <= 1.05 * bounds.lower
    assert bounds.upper == pytest.approx(min(crossings), rel=1e-6)


def _imaginary_roots(fixed: np.poly1d, by_k: np.poly1d) -> list[float]:
    """Frequencies at which ``fixed(jw) / by_k(jw)`` is real."""

    def parts(p: np.poly1d) -> tuple[np.poly1d, np.poly1d]:
        coefficients = [c * 1j ** (p.order - i) for i, c in enumerate(p.coeffs)]
        return np.poly1d(np.real(coefficients)), np.poly1d(np.imag(coefficients))

    (a, b), (c, d) = parts(fixed), parts(by_k)
    roots = (b * c - a * d).roots
    return [float(r.real) for r in roots if abs(r.imag) < 1e-6 * abs(r) and r.real > 1e-9]


@pytest.mark.parametrize("count", [1, 2, 3])
def test_aligned_modes_have_the_worst_gain_of_their_construction(count: int) -> None:
    """Stiffnesses that can bring all modes to one frequency: the gain there is count / (2 damping)."""
    bounds = worst_case_gain(aligned_modes(count, damping=0.02), options=LONG)
    truth = count / 0.04
    assert bounds.lower <= truth * (1 + 1e-9) and truth <= bounds.upper <= 1.05 * bounds.lower
    assert bounds.proof is not None and check_proof(bounds.proof.content).level == bounds.upper


def test_bounds_stay_apart_where_the_margin_is_discontinuous() -> None:
    """Damping (delta - 1)^2 + excess: the margin is 1 without excess and has no limit with any."""
    touching = robust_stability(tangent_crossing(0.0), largest=2.0, options=replace(LONG, max_tests=40))
    assert 0.5 < touching.lower <= 1.0 <= touching.upper
    free = robust_stability(tangent_crossing(0.1), largest=2.0, options=LONG)
    assert free.lower == 2.0 and free.upper == np.inf and free.status == "closed"
