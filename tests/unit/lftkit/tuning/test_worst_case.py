"""Worst parameters: known answers, hidden peaks, instability, and the outer loop."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
import pytest
from support.worst_case_plants import (
    GAIN,
    ONLY_POINTS,
    OPEN,
    Recorder,
    asked_points,
    bump,
    first_order,
    mode,
    mode_peak,
    oscillator,
)

from lftkit.systems.system import System
from lftkit.tuning.requirements import ClosedLoopPoles, H2Gain, HinfGain
from lftkit.tuning.robust.worst_case import WorstCaseOptions, worst_case


def test_interior_worst_case_is_found_by_the_climb() -> None:
    """Against a dense scan of the square."""
    box = {"a": (-1.0, 1.0), "b": (-1.0, 1.0)}
    options = WorstCaseOptions(samples=15, climbs=3)
    found = worst_case(oscillator, box, OPEN, [HinfGain("w", "z"), H2Gain("w", "z")], options=options)
    w = np.linspace(0.6, 1.9, 2601)
    scan = 0.0
    for a in np.linspace(-1, 1, 41):
        for b in np.linspace(-1, 1, 41):
            modes = [(1.0 + 0.3 * a), (1.5 + 0.3 * b)]
            scan = max(scan, np.abs(sum(1 / (m * m - w * w + 0.04j * m * w) for m in modes)).max())
    assert found[0].value >= scan * (1 - 1e-3)
    assert found[0].value >= found[0].sampled
    model = oscillator(found[0].parameters)
    at_peak = model.C[:1] @ np.linalg.solve(1j * found[0].omega * np.eye(4) - model.A, model.B[:, :1])
    assert abs(at_peak.item()) == pytest.approx(found[0].value, rel=1e-6)
    assert found[1].value > 0 and set(found[1].parameters) == {"a", "b"}


def test_poles_over_the_box() -> None:
    options = WorstCaseOptions(samples=10, climbs=2)
    needs = [ClosedLoopPoles(max_frequency=1.0)]
    found = worst_case(oscillator, {"a": (-1.0, 1.0), "b": (-1.0, 1.0)}, OPEN, needs, options=options)
    assert found[0].value == pytest.approx(1.8, rel=1e-6) and found[0].parameters["b"] == pytest.approx(1.0)


def test_runner_up_beside_a_peak_at_infinite_frequency() -> None:
    """A direct path whose gain is reached at infinity, beside a resonance: no warning, both are reported."""

    def build(p: Mapping[str, float]) -> System:
        A = [[0.0, 1.0], [-1.0, -0.1]]
        D = [[p["through"], 0.0], [0.0, 0.0]]
        return System(
            A, [[0, 0], [0.1 * p["mode"], 0]], [[1, 0], [0, 0]], D, [("w", 1), ("u", 1)], [("z", 1), ("y", 1)]
        )

    none = System.static([[0.0]], [("y", 1)], [("u", 1)])
    box = {"through": (0.0, 2.0), "mode": (0.0, 1.5)}
    with np.errstate(all="raise"):
        (found,) = worst_case(build, box, none, [HinfGain("w", "z")], options=WorstCaseOptions(samples=4, climbs=0))
    assert found.value > 2.0 and np.isfinite(found.value)


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_middle_comes_first_then_every_corner_once_up_to_seven_parameters(n: int) -> None:
    points = asked_points(n, 0, 40)
    assert len(points) == 1 + 2**n + 40
    assert points[0].tolist() == [3.5] * n
    corners = points[1 : 1 + 2**n]
    assert {tuple(c) for c in corners} == set(itertools.product((2.0, 5.0), repeat=n))
    samples = points[1 + 2**n :]
    assert (samples > 2.0).all() and (samples < 5.0).all() and len(np.unique(samples, axis=0)) == 40
    assert (samples.min(axis=0) < 3.0).all() and (samples.max(axis=0) > 4.0).all()


def test_128_random_corners_are_taken_beyond_seven_parameters() -> None:
    n = 8
    points = asked_points(n, 0, 5)
    assert len(points) == 1 + 128 + 5
    corners = points[1:129]
    assert all(set(column) == {2.0, 5.0} for column in corners.T)
    assert len(np.unique(corners, axis=0)) > 64
    assert ((points[129:] > 2.0) & (points[129:] < 5.0)).all()


@pytest.mark.further
@pytest.mark.parametrize("n", [3, 8])
def test_points_depend_on_the_seed_only(n: int) -> None:
    first, again, other = (asked_points(n, seed, 8) for seed in (4, 4, 5))
    np.testing.assert_array_equal(first, again)
    assert not np.isin(first[-8:], other[-8:]).any()
    assert (first[:-8] == other[:-8]).all() == (n <= 7)


def test_worst_damping_and_frequency_of_a_mode_are_those_of_the_closed_form() -> None:
    build = Recorder(lambda p: mode(2.0, p["damping"]))
    needs = [HinfGain("w", "z", bound=4.0), ClosedLoopPoles(min_damping=0.1), H2Gain("w", "z", bound=0.5)]
    found = worst_case(build, {"damping": (0.05, 0.3)}, OPEN, needs, options=ONLY_POINTS)
    peak, omega = mode_peak(2.0, 0.05)
    assert found[0].value == pytest.approx(peak / 4.0, rel=1e-6)
    assert found[0].omega == pytest.approx(omega, rel=1e-3)
    assert found[1].value == pytest.approx(2.0 - 0.05 / 0.1, rel=1e-9)
    assert found[2].value == pytest.approx(np.sqrt(1.0 / (4.0 * 0.05 * 2.0**3)) / 0.5, rel=1e-9)
    for case, need in zip(found, needs):
        assert case.parameters == {"damping": pytest.approx(0.05, rel=1e-14)}
        assert (case.requirement, case.sampled, case.evaluations) == (need.name, case.value, 3)
    assert [p["damping"] for p in build.asked] == pytest.approx([0.175, 0.05, 0.3], rel=1e-12)


def test_climb_reaches_the_largest_gain_between_the_samples() -> None:
    """All three kinds: a gain whose peak stays, one whose peak moves, an H2 norm and a decay."""
    box = {"a": (-1.0, 1.0), "b": (-0.5, 0.4)}
    options = WorstCaseOptions(samples=0, climbs=1, iterations=30)

    def build(p: Mapping[str, float]) -> System:
        return first_order(bump(p))

    gain_case, h2_case = worst_case(build, box, OPEN, [GAIN, H2Gain("w", "z")], options=options)
    assert gain_case.value == pytest.approx(1.0, rel=1e-6) and gain_case.omega == 0.0
    assert h2_case.value == pytest.approx(np.sqrt(0.5), rel=1e-6)
    for case in (gain_case, h2_case):
        assert case.sampled == pytest.approx(case.value * bump({"a": 0.0, "b": -0.05}), rel=1e-6)
        assert case.parameters["a"] == pytest.approx(0.3, abs=2e-3)
        assert case.parameters["b"] == pytest.approx(-0.2, abs=2e-3)

    def slow(p: Mapping[str, float]) -> System:
        return first_order(1.0, 2.0 - bump(p))

    (decay,) = worst_case(slow, box, OPEN, [ClosedLoopPoles(min_decay=2.0)], options=options)
    assert decay.value == pytest.approx(1.5, rel=1e-6) and decay.value > decay.sampled
    assert decay.parameters["a"] == pytest.approx(0.3, abs=2e-3)


def test_climb_follows_a_peak_that_moves() -> None:
    """Frequency 1 + a / 2 and damping 0.05 + (a - 0.4)^2: the worst a, of the closed form, is not the least damped."""
    scan = np.linspace(-1.0, 1.0, 200_001)
    peaks = mode_peak(1.0 + 0.5 * scan, 0.05 + 0.3 * (scan - 0.4) ** 2)[0]
    a = scan[peaks.argmax()]
    options = WorstCaseOptions(samples=0, climbs=1, iterations=30)
    build = Recorder(lambda p: mode(1.0 + 0.5 * p["a"], 0.05 + 0.3 * (p["a"] - 0.4) ** 2))
    (found,) = worst_case(build, {"a": (-1.0, 1.0)}, OPEN, [GAIN], options=options)
    assert abs(a - 0.4) > 0.02, "the closed form is meant to have its worst case elsewhere"
    assert found.parameters["a"] == pytest.approx(a, abs=2e-3)
    assert found.value == pytest.approx(peaks.max(), rel=1e-5) and found.value > 1.1 * found.sampled
    omega = mode_peak(1.0 + 0.5 * a, 0.05 + 0.3 * (a - 0.4) ** 2)[1]
    assert found.omega == pytest.approx(omega, rel=2e-3)
    assert (np.abs(build.table()) <= 1.0).all()
