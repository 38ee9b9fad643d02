"""Bounds of random uncertain systems against a dense search that shares no code with them; bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.uncertain_examples import aligned_modes, tangent_crossing

from lftkit import Port, RealParameter, System, real, s
from lftkit.proofs import BoundOptions, check_proof, robust_stability, worst_case_gain

LONG = BoundOptions(wall_limit=3600.0)


def random_system(seed: int) -> System:
    """Two to four states, one to three parameters of which some are repeated, one or two inputs and outputs."""
    rng = np.random.default_rng(seed)
    n, count = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    channels = [f"p{i}" for i in range(count)]
    channels += [channels[int(rng.integers(count))]] if rng.random() < 0.4 else []
    q, m, p = len(channels), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.1, 0.6)) * np.eye(n)
    D = rng.normal(size=(q + p, q + m)) * rng.choice([0.0, 0.3], size=(q + p, q + m))
    D[:q, :q] *= 0.3
    parameters = tuple(
        RealParameter(f"p{i}", 1.0, 1.0 - rng.uniform(0.02, 0.5), 1.0 + rng.uniform(0.02, 0.5)) for i in range(count)
    )
    B, C = 0.6 * rng.normal(size=(n, q + m)), 0.6 * rng.normal(size=(q + p, n))
    return System(A, B, C, D, (Port("u", m),), (Port("y", p),), channels=tuple(channels), elements=parameters)


def dense_search(system: System, seed: int, members: int) -> float:
    """Largest gain over random members, corners and 120 frequencies with those of the poles; infinite if unstable."""
    rng, largest = np.random.default_rng(seed), 0.0
    ends = np.array([(p.lower, p.upper) for p in system.parameters])
    shares = [*rng.random((members, len(ends))), *rng.integers(0, 2, (16, len(ends))).astype(float)]
    for share in shares:
        values = dict(zip((p.name for p in system.parameters), ends[:, 0] + share * (ends[:, 1] - ends[:, 0])))
        model = system.at(values)
        poles = np.linalg.eigvals(model.A)
        if poles.real.max() >= 0.0:
            return np.inf
        omega = np.concatenate([[0.0], np.geomspace(1e-2, 1e2, 120), np.abs(poles), np.abs(poles.imag), [1e9]])
        resolvent = np.linalg.inv(1j * omega[:, None, None] * np.eye(model.order) - model.A)
        largest = max(largest, float(np.linalg.norm(model.C @ resolvent @ model.B + model.D, 2, axis=(1, 2)).max()))
    return largest


def check_system(seed: int, members: int) -> None:
    system = random_system(seed)
    bounds = worst_case_gain(system, options=LONG)
    found = dense_search(system, seed + 10**6, members)
    if bounds.status == "unstable":
        member = system.at(bounds.point)
        assert np.linalg.eigvals(member.A).real.max() >= 0.0
        return
    assert bounds.status == "closed" and bounds.uncovered == ()
    assert found <= bounds.upper * (1.0 + 1e-9), "upper below a gain that was found"
    assert bounds.lower <= bounds.upper <= 1.05 * bounds.lower
    reached = system.at(bounds.point)
    response = reached.C @ np.linalg.inv(1j * min(bounds.frequency, 1e12) * np.eye(reached.order) - reached.A)
    assert np.linalg.norm(response @ reached.B + reached.D, 2) == pytest.approx(bounds.lower, rel=1e-6)
    assert bounds.proof is not None and check_proof(bounds.proof.content).stable


@pytest.mark.parametrize("seed", range(4))
def test_bounds_of_random_systems(seed: int) -> None:
    check_system(seed, 60)


@pytest.mark.slow
@pytest.mark.timeout(2000)
@pytest.mark.parametrize("first", range(1000, 2000, 50))
def test_bounds_of_a_thousand_random_systems(first: int) -> None:
    for seed in range(first, first + 50):
        check_system(seed, 200)


@pytest.mark.further
def test_a_narrow_interval_with_the_largest_loss_is_not_bisected_for_ever() -> None:
    """Three parameters keep the cells of this system open; the loss of one of them stays the largest."""
    bounds = worst_case_gain(random_system(1232), options=replace(LONG, max_tests=200))
    assert bounds.status == "closed" and bounds.upper <= 1.05 * bounds.lower


def test_an_unstable_member_is_named_at_once() -> None:
    system = (1 / (s + 1 - real("p", 0.0, -0.5, 1.5))).system("u", "y")
    bounds = worst_case_gain(system)
    assert bounds.status == "unstable" and bounds.upper == np.inf and bounds.proof is None
    assert bounds.point["p"] >= 1.0
    inside = worst_case_gain(system, {"p": (-0.5, 0.5)})
    assert inside.lower <= 2.0 <= inside.upper <= 2.1


def test_a_singular_interconnection_is_no_stable_member() -> None:
    """``z = w + x``: at p = 1 the loop of the LFT is singular."""
    p = RealParameter("p", 0.0, -1.0, 1.0)
    system = System([[-1.0]], [[1.0]], [[1.0]], [[1.0]], (), (), channels=("p",), elements=(p,))
    bounds = robust_stability(system, options=LONG)  # x' = -x + p / (1 - p) x: unstable beyond p = 1/2
    assert bounds.upper == pytest.approx(0.5, rel=1e-6) and 0.0 < bounds.lower < 0.5
    still = System([[-1.0]], [[0.0]], [[0.0]], [[1.0]], (), (), channels=("p",), elements=(p,))
    assert robust_stability(still, options=LONG).upper == pytest.approx(1.0, rel=1e-6)


def test_without_time_the_bounds_stay_honest() -> None:
    system = aligned_modes(2, damping=0.02)
    for tests in (0, 1, 2, 3):
        bounds = worst_case_gain(system, options=replace(LONG, max_tests=tests))
        assert bounds.lower <= 50.0 * (1 + 1e-9) and bounds.upper >= 50.0
        assert (bounds.proof is None) == (bounds.upper == np.inf)
        assert bool(bounds.uncovered) == (bounds.proof is None)
    late = worst_case_gain(system, options=BoundOptions(wall_limit=1e-9))
    assert late.upper == np.inf and late.status == "out_of_time" and late.uncovered
    stability = robust_stability(tangent_crossing(0.0), options=BoundOptions(wall_limit=1e-9))
    assert stability.lower == 0.0 and stability.proof is None


def test_a_level_is_proven_or_a_member_exceeds_it() -> None:
    system = aligned_modes(1, damping=0.02)
    proven = worst_case_gain(system, level=26.0, options=LONG)
    assert proven.upper == 26.0 and proven.proof is not None
    exceeded = worst_case_gain(system, level=24.0, options=LONG)
    assert exceeded.status == "violated" and exceeded.lower > 24.0 and exceeded.proof is None


def test_a_band_bounds_the_gain_there_only() -> None:
    """The gain of the modes far above resonance is 1 / omega; stability is not claimed."""
    bounds = worst_case_gain(aligned_modes(1, damping=0.02), band=(100.0, np.inf), options=LONG)
    assert bounds.lower <= 0.0100026 and 0.01 <= bounds.upper <= 1.05 * bounds.lower
    assert bounds.proof is not None and not check_proof(bounds.proof.content).stable


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"band": (2.0, 1.0)}, "band must be"),
        ({"band": (-1.0, 1.0)}, "band must be"),
        ({"level": -1.0}, "level"),
        ({"box": {"k9": (1.0, 2.0)}}, "parameter must be one of"),
        ({"box": {"k0": (2.0, 1.0)}}, "lower <= upper"),
        ({"box": {"k0": (0.1, 2.0)}}, "must be in"),
        ({"inputs": ["torque"]}, "port must be one of"),
    ],
)
def test_bad_input_is_a_line(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        worst_case_gain(aligned_modes(1, damping=0.02), **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("field", "value"), [("gap", 0.0), ("wall_limit", 0.0), ("max_tests", -1), ("method", "faces")]
)
def test_bad_options_are_a_line(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"^{field} must be .*, got {value!r}$"):
        BoundOptions(**{field: value})  # type: ignore[arg-type]
