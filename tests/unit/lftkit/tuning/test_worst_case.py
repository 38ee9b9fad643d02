"""Worst parameters: known answers, hidden peaks, bands, instability, runners-up, and the outer loop."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from support.tuned_plants import STATIC, lag, tuned_plant
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
    modes,
)

from lftkit.systems.system import System
from lftkit.tuning import HinfGain, TuningOptions, WorstCaseOptions, tune, worst_case
from lftkit.tuning.requirements import ClosedLoopPoles, H2Gain
from lftkit.tuning.robust.robust import RobustOptions, tune_robust


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


@pytest.mark.parametrize("n", [1, 2, 3, 7, 8])
def test_middle_comes_first_then_corners_then_samples(n: int) -> None:
    """Every corner once up to seven parameters, 128 random ones beyond."""
    points, count = asked_points(n, 0, 40), min(2**n, 128)
    corners, samples = points[1 : 1 + count], points[1 + count :]
    assert len(samples) == 40 and points[0].tolist() == [3.5] * n
    assert all(set(column) == {2.0, 5.0} for column in corners.T)
    assert len(np.unique(corners, axis=0)) == count if n <= 7 else len(np.unique(corners, axis=0)) > 64
    assert (samples > 2.0).all() and (samples < 5.0).all() and len(np.unique(samples, axis=0)) == 40
    assert (samples.min(axis=0) < 3.0).all() and (samples.max(axis=0) > 4.0).all()


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


def test_box_of_width_zero_gives_its_only_point() -> None:
    (found,) = worst_case(lambda p: first_order(p["a"]), {"a": (0.7, 0.7)}, OPEN, [GAIN])
    assert found.value == found.sampled == pytest.approx(0.7, rel=1e-9) and found.parameters == {"a": 0.7}


def test_gain_of_zero_is_a_value_as_others_are() -> None:
    with np.errstate(all="raise"):
        (found,) = worst_case(lambda p: first_order(0.0), {"a": (0.0, 1.0)}, OPEN, [GAIN])
    assert found.value == 0.0 and np.isfinite(found.omega)


def test_loop_delay_is_zero_unless_given_and_counts() -> None:
    """1 / s with the gain 1: ``|1 / (jw + exp(-jw T))|`` is at most 1 at frequency 0 without a delay, larger with."""
    unity = System.static([[-1.0]], [("y", 1)], [("u", 1)])
    w = np.linspace(1e-3, 3.0, 30_001)

    def build(p: Mapping[str, float]) -> System:
        return first_order(1.0 - 0.5 * (p["a"] - 0.2) ** 2, 0.0)

    for delay, expected in ((None, 1.0), (0.9, np.abs(1.0 / (1j * w + np.exp(-0.9j * w))).max())):
        given = {} if delay is None else {"loop_delay": delay}
        (found,) = worst_case(build, {"a": (-1.0, 1.0)}, unity, [GAIN], **given)
        assert found.value == pytest.approx(expected, rel=1e-4)
        assert found.parameters["a"] == pytest.approx(0.2, abs=0.01)
    assert expected > 1.5


def test_controller_with_states_is_climbed_with_its_response_at_the_peak() -> None:
    """Integral feedback k / s of a gain: ``g s / (s^2 + s + k)`` has the peak g at sqrt(k)."""
    integrator = System([[0.0]], [[1.0]], [[-4.0]], [[0.0]], [("y", 1)], [("u", 1)])
    options = WorstCaseOptions(samples=0, climbs=1, iterations=30)
    box = {"a": (-1.0, 1.0), "b": (-0.5, 0.4)}
    (found,) = worst_case(lambda p: first_order(bump(p)), box, integrator, [GAIN], options=options)
    assert found.value == pytest.approx(1.0, rel=1e-5) and found.omega == pytest.approx(2.0, rel=1e-2)
    assert found.parameters["b"] == pytest.approx(-0.2, abs=5e-3)


@pytest.mark.parametrize("need", [GAIN, H2Gain("w", "z"), ClosedLoopPoles(min_decay=0.1)])
def test_search_stops_at_the_first_unstable_point_without_a_climb(need) -> None:
    """Poles 0.5 (a) - 0.6: the middle and the first corner are stable, the second corner is not."""
    build = Recorder(lambda p: first_order(1.0, 0.6 - p["a"]))
    (found,) = worst_case(build, {"a": (0.0, 1.0)}, OPEN, [need])
    assert found.value == found.sampled == np.inf
    assert found.parameters == {"a": 1.0} and found.others == ()
    assert found.evaluations == 3 and [p["a"] for p in build.asked] == [0.5, 0.0, 1.0]


def test_climb_that_meets_an_unstable_loop_ends_there() -> None:
    """Pole at 0.04 - (a - 0.3)^2: the middle and the corners are stable, 0.1 < a < 0.5 is not."""
    build = Recorder(lambda p: first_order(1.0, (p["a"] - 0.3) ** 2 - 0.04))
    options = WorstCaseOptions(samples=0, climbs=3, iterations=50)
    (found,) = worst_case(build, {"a": (-1.0, 1.0)}, OPEN, [GAIN], options=options)
    assert found.value == np.inf and 0.1 <= found.parameters["a"] <= 0.5
    assert build.asked[-1] == found.parameters
    assert np.isfinite(found.sampled)


def test_runners_up_are_the_worst_of_two_other_peaks_in_order() -> None:
    """Four modes of peaks 4, 3, 2 and 1, a decade apart: the fourth peak is one too many."""
    names = ("p0", "p1", "p2", "p3")
    box = dict.fromkeys(names, (0.05, 1.0))

    def build(p: Mapping[str, float]) -> System:
        return modes([g * p[n] for g, n in zip((4.0, 3.0, 2.0, 1.0), names)])

    (found,) = worst_case(build, box, OPEN, [GAIN], options=ONLY_POINTS)
    assert found.value == pytest.approx(4.0, rel=0.05) and found.omega == pytest.approx(1.0, rel=0.01)
    assert len(found.others) == 2
    assert [value for value, _ in found.others] == pytest.approx([3.0, 2.0], rel=0.05)
    (_, second), (_, third) = found.others
    assert (second["p0"], second["p1"]) == pytest.approx((0.05, 1.0))
    assert (third["p0"], third["p1"], third["p2"]) == pytest.approx((0.05, 0.05, 1.0))


def test_plant_with_a_pole_at_the_frequency_of_the_peak_is_climbed() -> None:
    """The gain of the closed loop g / (s + 1) of an integrator is largest at its pole, where the plant has none."""
    unity = System.static([[-1.0]], [("y", 1)], [("u", 1)])
    options = WorstCaseOptions(samples=0, climbs=1, iterations=30)
    box = {"a": (-1.0, 1.0), "b": (-0.5, 0.4)}
    (found,) = worst_case(lambda p: first_order(bump(p), 0.0), box, unity, [GAIN], options=options)
    assert found.omega == 0.0
    assert found.value == pytest.approx(1.0, rel=1e-6) and found.sampled < 0.95


def test_outer_loop_adds_the_worst_models_until_none_is_worse() -> None:
    """u = -k y, pole in [-1, -0.5]: the effort k / (k - pole) <= 0.9 binds at the pole -0.5, where k = 4.5."""
    needs = [HinfGain("w", "effort", bound=0.9, hard=True, name="effort"), HinfGain("w", "z")]
    result = tune_robust(
        lambda p: lag(p["pole"]),
        {"pole": (-1.0, -0.5)},
        needs,
        STATIC,
        initial=[[-2.0]],
        options=RobustOptions(TuningOptions(starts=0), WorstCaseOptions(samples=2, climbs=1, iterations=5)),
    )
    assert result.status == "converged"
    assert -result.controller.D.item() == pytest.approx(4.5, rel=2e-3)
    assert result.soft == pytest.approx(0.2, rel=1e-3)
    assert {round(a["pole"], 6) for a in result.active} >= {-0.75, -0.5}
    assert len(result.rounds) >= 2
    assert all(w.value <= max(1.0, result.soft) * 1.01 for w in result.worst)


@pytest.mark.further
def test_outer_loop_does_not_call_converged_what_the_tuner_does_not() -> None:
    """Pole in [-1, 1]: the effort k / (k - 1) falls to its infimum 1 as k grows, and never reaches it."""
    needs = [HinfGain("w", "z", bound=0.25, hard=True), HinfGain("w", "effort", name="effort")]
    result = tune_robust(
        lambda p: lag(p["pole"]),
        {"pole": (-1.0, 1.0)},
        needs,
        STATIC,
        initial=[[-2.0]],
        options=RobustOptions(TuningOptions(starts=0), WorstCaseOptions(samples=2, climbs=1, iterations=5)),
    )
    assert -result.controller.D.item() >= 5.0 * (1 - 1e-4), "the gain 1 / (k - 1) <= 1/4 asks for k >= 5"
    assert 1.0 < result.soft < 1.25
    assert result.status != "converged"


def test_outer_loop_recovers_when_a_worst_model_is_unstable() -> None:
    """Integral feedback of a resonance: the nominal design uses the collocated phase that a sign change takes away."""

    def build(p: Mapping[str, float]) -> System:
        return tuned_plant([[0, 1], [-1, -0.05]], [[0, 0], [1, 1]], [[1.0, 0.0], [p["mix"], 1.0]])

    box = {"mix": (-2.0, 2.0)}
    options = RobustOptions(TuningOptions(starts=1), WorstCaseOptions(samples=2, climbs=1))
    result = tune_robust(build, box, [HinfGain("w", "z")], STATIC, active=[{"mix": 2.0}], options=options)
    assert result.rounds[0].worst_soft > 2 * result.rounds[0].soft, "the nominal design is worse or unstable elsewhere"
    assert result.status == "converged"
    assert all(np.isfinite(w.value) for w in result.worst)
    assert result.worst[0].value <= result.soft * 1.01


BAND = (2.0, 10.0)


def test_the_tuner_lowers_the_gain_in_the_band_and_certifies_it() -> None:
    """With u = k y the gain is 1 / (s + 1 - k) and the command's -k / (s + 1 - k), held at 0.8 from 2 rad/s on."""
    goals = [HinfGain("w", "z", band=BAND), HinfGain("w", "effort", bound=0.8, hard=True, band=(2.0, np.inf))]
    result = tune([lag()], goals, STATIC, initial=[[-0.5]], options=TuningOptions(starts=0))
    # k^2 = 0.64 (4 + (1 - k)^2): the positive root of 0.36 q^2 - 1.28 q - 3.2 with q = -k
    q = (1.28 + np.sqrt(1.28**2 + 4 * 0.36 * 3.2)) / 0.72
    assert result.status == "converged" and -result.x[0] == pytest.approx(q, rel=2e-3)
    assert result.soft == pytest.approx(1.0 / np.hypot(2.0, 1.0 + q), rel=2e-3)
    assert result.certificate is not None and result.peak_frequencies[0, 0] == 2.0
    assert result.certificate.upper[0, 0] < 1.0 / (1.0 + q), "the gain at frequency zero is larger, and does not count"


def test_the_worst_case_is_that_of_the_band() -> None:
    """A resonance that the parameter moves through the band: worst where it is inside, not where it is highest."""

    def build(p: dict[str, float]) -> System:
        k = p["k"]
        return tuned_plant([[0, 1], [-k, -0.02 * k]], [[0, 0], [1, 1]], [[1, 0], [1, 0]])

    none = System.static([[0.0]], [("y", 1)], [("u", 1)])
    options = WorstCaseOptions(samples=60, climbs=3, iterations=30)
    (found,) = worst_case(build, {"k": (0.5, 30.0)}, none, [HinfGain("w", "z", band=BAND)], options=options)
    (whole,) = worst_case(build, {"k": (0.5, 30.0)}, none, [HinfGain("w", "z")], options=options)
    assert whole.parameters["k"] == pytest.approx(0.5) and whole.omega < 1.0
    k, w = np.meshgrid(np.linspace(3.9, 4.5, 601), np.linspace(2.0, 2.2, 41))
    scan = float((1.0 / np.abs(k - w * w + 0.02j * k * w)).max())
    assert found.value == pytest.approx(scan, rel=2e-2) and 2.0 <= found.omega <= 2.1
