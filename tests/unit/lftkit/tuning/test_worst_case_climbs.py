"""Climbs, limits and runners-up of the worst-case search."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from support.tuned_plants import STATIC, lag, tuned_plant
from support.worst_case_plants import GAIN, ONLY_POINTS, OPEN, Recorder, bump, first_order, mode, modes

from lftkit.systems.system import System
from lftkit.tuning.options import TuningOptions
from lftkit.tuning.requirements import ClosedLoopPoles, H2Gain, HinfGain
from lftkit.tuning.robust.robust import RobustOptions, tune_robust
from lftkit.tuning.robust.worst_case import WorstCaseOptions, worst_case


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


def test_every_requirement_is_infinite_where_the_loop_is_unstable_and_none_has_runners_up() -> None:
    """The stable points have their peak at another frequency than 0, which is given for an unstable one."""
    needs = [GAIN, ClosedLoopPoles(min_decay=0.1)]
    found = worst_case(lambda p: mode(1.0, 0.05 - 0.1 * p["a"]), {"a": (0.0, 1.0)}, OPEN, needs)
    assert [f.value for f in found] == [np.inf, np.inf] and [f.others for f in found] == [(), ()]
    assert [f.omega for f in found] == [0.0, 0.0]


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
