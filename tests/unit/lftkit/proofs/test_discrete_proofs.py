"""Worst-case gain and robust stability in discrete time: proofs about the unit circle."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import linalg
from support.forged_proofs import forged

from lftkit import Port, RealParameter, System
from lftkit.proofs import (
    BoundOptions,
    ProofError,
    check_proof,
    robust_stability,
    worst_case_disk_margin,
    worst_case_gain,
)

PORTS = ((Port("u", 1),), (Port("y", 1),))
Content = dict[str, Any]


def lag(dt: float = 0.1, sign: float = 1.0) -> System:
    """``x+ = sign p x + u``, p in [0, 0.6] about 0.3."""
    p = RealParameter("p", 0.3, 0.0, 0.6)
    D = np.zeros((2, 2))
    return System([[0.3 * sign]], [[sign, 1.0]], [[1.0], [1.0]], D, *PORTS, channels=("p",), elements=(p,), dt=dt)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_lag_by_hand(sign: float) -> None:
    """Gain 1 / (1 - p) at z = 1, or at z = -1; unstable from p = 1 on, 0.7 / 0.3 of the half range."""
    system, dt = lag(sign=sign), 0.1
    gain = worst_case_gain(system)
    assert gain.status == "closed"
    assert gain.lower == pytest.approx(2.5, rel=1e-6) and 2.5 <= gain.upper <= 1.05 * 2.5
    assert gain.point == {"p": 0.6}
    assert gain.frequency == pytest.approx(0.0 if sign > 0.0 else np.pi / dt, abs=1e-6)
    checked = check_proof(gain.proof)
    assert checked.stable and checked.band == pytest.approx((0.0, np.pi / dt))
    margin = robust_stability(system)
    assert margin.status == "closed" and margin.upper == pytest.approx(0.7 / 0.3, rel=1e-6)
    assert margin.frequency == pytest.approx(0.0 if sign > 0.0 else np.pi / dt, abs=1e-6)
    assert check_proof(margin.proof).stable


@pytest.mark.further
def test_a_band_in_rad_per_second() -> None:
    system, band = lag(), (10.0, 20.0)
    found = worst_case_gain(system, band=band)
    exact = (1.0 / np.abs(np.exp(1j * 10.0 * 0.1) - np.linspace(0.0, 0.6, 100001))).max()
    assert found.lower == pytest.approx(exact, rel=1e-6) and exact <= found.upper <= 1.05 * exact
    checked = check_proof(found.proof)
    assert not checked.stable and checked.band[0] <= 10.0 and checked.band[1] >= 20.0
    assert worst_case_gain(system, band=(10.0, np.pi / 0.1)).upper <= 1.05 * exact
    with pytest.raises(ValueError, match="below pi / dt"):
        worst_case_gain(system, band=(40.0, 50.0))


def random_system(rng: np.random.Generator) -> System:
    """Two parameters in three channels."""
    n = int(rng.integers(1, 5))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.5, 0.98) / np.abs(linalg.eigvals(A)).max()
    B, C = 0.15 * rng.standard_normal((n, 4)), 0.7 * rng.standard_normal((4, n))
    elements = tuple(RealParameter(name, 1.0, 0.5, 1.7) for name in "ab")
    D = 0.1 * rng.standard_normal((4, 4))
    return System(A, B, C, D, *PORTS, channels=("a", "a", "b"), elements=elements, dt=0.01)


@pytest.mark.further
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in range(1, 30))])
def test_no_member_is_above_what_is_proven(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = random_system(rng)
    gain = worst_case_gain(system, options=BoundOptions(wall_limit=60.0))
    margin = robust_stability(system, largest=3.0, options=BoundOptions(wall_limit=60.0))
    omega = np.linspace(0.0, np.pi / system.dt, 60)
    for values in system.sample_values(rng, 200):
        member = system.at(values)
        radius = np.abs(member.poles()).max()
        if gain.proof is not None:
            assert radius < 1.0 and np.abs(member.response(omega)).max() <= gain.upper
        if margin.lower >= 1.0:
            assert radius < 1.0
    if gain.proof is not None:
        assert check_proof(gain.proof).stable
        at_point = system.at(gain.point).response(gain.frequency)
        assert np.abs(at_point).max() == pytest.approx(gain.lower, rel=1e-9)
    if np.isfinite(margin.upper):
        assert np.abs(system.at(margin.point, beyond_range=True).poles()).max() == pytest.approx(1.0, abs=1e-6)


def test_a_member_that_is_not_well_posed_is_not_covered() -> None:
    """``w = p w`` at p = 1 is seen by no state and no output, so nothing on the circle tells it."""
    p = RealParameter("p", 0.0, -0.5, 1.5)
    matrices = [[0.3]], [[1.0, 1.0]], [[0.0], [1.0]], [[1.0, 0.0], [0.0, 0.0]]
    system = System(*matrices, *PORTS, channels=("p",), elements=(p,), dt=0.1)
    found = worst_case_gain(system, options=BoundOptions(wall_limit=3.0, max_tests=200))
    assert found.proof is None and found.status != "closed" and np.isinf(found.upper)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_a_loop_of_parameters_is_shown_to_be_well_posed(dt: float) -> None:
    """``y = p (u + y)``: gain p / (1 - p), 9 at p = 0.9, in either time."""
    p = RealParameter("p", 0.0, -0.5, 0.9)
    none = np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0))
    system = System(*none, [[1.0, 1.0], [1.0, 0.0]], *PORTS, channels=("p",), elements=(p,), dt=dt)
    found = worst_case_gain(system)
    assert found.lower == pytest.approx(9.0) and found.upper <= 1.05 * 9.0
    assert found.proof is not None and check_proof(found.proof).stable
    assert bool(found.proof.content.get("posed")) == (dt > 0.0)
    assert robust_stability(system).upper == pytest.approx(1.0 / 0.9)


@pytest.fixture(scope="module")
def proof() -> Content:
    bounds = worst_case_gain(lag())
    assert bounds.proof is not None
    return bounds.proof.content


HALF = [0.0, 0.3]
FORGED: dict[str, Callable[[Content], object]] = {
    "faster, the circle stays whole": lambda c: (c["plant"].update(dt=0.05), c["claim"].update(band=[0.0, 1.0])),
    "not well posed": lambda c: c.update(posed=[]),
    "half well posed": lambda c: c["posed"][0].update(intervals=[HALF]),
    "in continuous time": lambda c: (c["plant"].pop("dt"), c.pop("posed")),
    "without its tick": lambda c: c["plant"].pop("dt"),
    "without a list": lambda c: c.pop("posed"),
    "unstable": lambda c: c["plant"].update(A=[[0.6]]),
    "other dynamics": lambda c: (c["plant"].update(A=[[-0.3]], B=[[-1.0, 1.0]]), c["claim"].update(level=2.0)),
}


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_proof_is_refused(proof: Content, name: str) -> None:
    assert proof["plant"]["dt"] == 0.1 and check_proof(proof).stable
    with pytest.raises(ProofError):
        check_proof(forged(proof, FORGED[name]))


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_a_system_without_uncertain_elements(dt: float) -> None:
    """Its gain, and stability at every factor, in either time; other dynamics are refused."""
    pole = 0.5 if dt else -0.5
    system = System([[pole]], [[1.0]], [[1.0]], [[0.0]], *PORTS, dt=dt)
    gain, margin = worst_case_gain(system), robust_stability(system, largest=3.0)
    assert gain.lower == pytest.approx(2.0) and 2.0 <= gain.upper <= 1.05 * 2.0
    assert margin.lower == 3.0 and check_proof(margin.proof).stable and check_proof(gain.proof).stable
    assert margin.proof is not None
    with pytest.raises(ProofError):
        check_proof(forged(margin.proof.content, lambda c: c["plant"].update(A=[[2.0 - pole]])))
    static = System(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[4.0]], *PORTS, dt=dt)
    assert check_proof(worst_case_gain(static).proof).level == pytest.approx(4.0, rel=0.05)


def test_the_disk_margin_of_a_discrete_integrator() -> None:
    """L = k / (z - 1): S - 1/2 = (z - 1 - k) / (2 (z - 1 + k)) is largest at z = -1: (2 + k) / (2 (2 - k))."""
    k = RealParameter("k", 0.5, 0.25, 1.0)
    D = [[0.0, 1.0], [0.0, 0.0]]
    loop = System([[1.0]], [[1.0, 0.5]], [[0.0], [1.0]], D, *PORTS, channels=("k",), elements=(k,), dt=0.1)
    found = worst_case_disk_margin(loop)
    assert found.upper == pytest.approx(2.0 * (2.0 - 1.0) / (2.0 + 1.0), rel=1e-6)
    assert found.lower <= found.upper <= 1.05 * found.lower
