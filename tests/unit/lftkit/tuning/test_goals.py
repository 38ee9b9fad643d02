"""Goals for loops and their pictures against closed forms; weights of any linear form."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import signal
from support.tuned_plants import STATIC, first_order

from lftkit import s
from lftkit.systems.connection.filters import transfer
from lftkit.systems.system import System
from lftkit.tuning import (
    ClosedLoopPoles,
    ConicSector,
    ControllerPoles,
    Goal,
    H2Gain,
    HinfGain,
    LoopShape,
    Margins,
    MaxLoopGain,
    MinLoopGain,
    Overshoot,
    Passivity,
    RobustOptions,
    Sensitivity,
    StepTracking,
    Tracking,
    TuningOptions,
    TuningRequirement,
    WorstCaseOptions,
    certify,
    gain,
    plot_goals,
    tune,
    tune_robust,
    worst_case,
)
from lftkit.tuning.goals import resolved
from lftkit.tuning.structures.structures import controller


def plant(numerator: Any, denominator: Any) -> System:
    """Reference r, command u -> output z, error e = r - z, the controller's measurement."""
    G = transfer(numerator, denominator)
    assert not G.D.any()
    B = np.hstack([np.zeros_like(G.B), G.B])
    C = np.vstack([G.C, -G.C])
    D = np.array([[0.0, 0.0], [1.0, 0.0]])
    return System(G.A, B, C, D, [("r", 1), ("u", 1)], [("z", 1), ("e", 1)])


def feedback(k: float) -> System:
    return System.static([[k]], [("e", 1)], [("u", 1)])


def value(goal: Goal, model: System, controller: System) -> float:
    (ready,), needs = resolved([model], [goal])
    certificate = certify([ready], controller, needs, rtol=1e-9)
    assert certificate.stable
    return float(certificate.values.item())


INTEGRATOR = plant([1.0], [1.0, 0.0])
LAW = gain([("e", 1)], [("u", 1)])


@pytest.mark.parametrize("at", ["u", "e"])
@pytest.mark.parametrize("crossover", [0.5, 3.0])
def test_loop_shape_is_one_for_the_integrator_of_its_crossover(at: str, crossover: float) -> None:
    """L = k / s with k = crossover: |S|^2 (k/w)^2 + |T|^2 (w/k)^2 = 1 at every frequency."""
    assert value(LoopShape(at, crossover), INTEGRATOR, feedback(crossover)) == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize(("goal", "k"), [(MinLoopGain, 0.5), (MaxLoopGain, 2.0)])
def test_loop_gain_that_is_half_or_twice_what_is_asked_has_the_value_two(goal: Any, k: float) -> None:
    """L = k / s with a crossover of 1: (1/s) S = 1 / (s + k), largest 1 / k; s T = k s / (s + k), largest k."""
    assert value(goal("u", crossover=1.0), INTEGRATOR, feedback(k)) == pytest.approx(2.0, rel=1e-3)
    assert value(goal("u", crossover=1.0), INTEGRATOR, feedback(1.0 / k)) == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize("at", ["u", "e"])
def test_disk_margin_of_the_published_loop(at: str) -> None:
    """25 / (s^3 + 10 s^2 + 10 s + 10): size 0.4581, gains 0.6273 to 1.5942, phases 25.8017 deg at 1.9474 rad/s."""
    model = plant([25.0], [1.0, 10.0, 10.0, 10.0])
    for goal in (Margins(at, gain_margin=1.5942), Margins(at, phase_margin=25.8017)):
        assert value(goal, model, feedback(1.0)) == pytest.approx(1.0, rel=1e-4)
        assert goal.size == pytest.approx(0.4581, abs=1e-4)


def test_sensitivities_of_a_lag() -> None:
    """L = k / (s + 1): S has 1 at high frequency, T = k / (s + 1 + k)."""
    model = plant([1.0], [1.0, 1.0])
    assert value(Sensitivity("u"), model, feedback(3.0)) == pytest.approx(1.0)
    assert value(Sensitivity("u", bound=0.5, complementary=True), model, feedback(3.0)) == pytest.approx(0.75 / 0.5)
    low = transfer([1.0], [1.0, 1.0])  # S / (s + 1) = 1 / (s + 4)
    assert value(Sensitivity("e", weight=low), model, feedback(3.0)) == pytest.approx(0.25)


def test_loops_of_two_commands_are_looked_at_together() -> None:
    """Two integrators with gains 2 and 5, one goal: the worse of them."""
    B = np.hstack([np.zeros((2, 1)), np.eye(2)])
    model = System(
        np.zeros((2, 2)), B, np.eye(2), np.zeros((2, 3)), [("w", 1), ("a", 1), ("b", 1)], [("x", 1), ("y", 1)]
    )
    K = System.static(np.diag([-2.0, -5.0]), [("x", 1), ("y", 1)], [("a", 1), ("b", 1)])
    assert value(MinLoopGain(("a", "b"), crossover=4.0), model, K) == pytest.approx(2.0, rel=1e-3)
    assert value(MaxLoopGain(("x", "y"), crossover=4.0), model, K) == pytest.approx(1.25, rel=1e-3)


@pytest.mark.parametrize("tau", [0.5, 2.0])
def test_tracking_of_a_lag_that_is_as_fast_as_asked(tau: float) -> None:
    """T = 1 / (tau s + 1): error tau s / (tau s + 1), the profile with w = 1 / tau but for its error at 0."""
    goal = Tracking("r", "z", response_time=2.0 * tau, dc_error=1e-6)
    assert value(goal, INTEGRATOR, feedback(1.0 / tau)) == pytest.approx(1.0, abs=1e-5)
    assert value(goal, INTEGRATOR, feedback(0.5 / tau)) == pytest.approx(2.0, abs=1e-5)


@pytest.mark.parametrize(("model", "own"), [(1.0, 1.0), (1.0, 3.0), (2.0, 0.7)])
def test_step_of_a_lag_against_that_of_another(model: float, own: float) -> None:
    """Steps 1 - exp(-t / a) and 1 - exp(-t / b) differ by the root of a/2 + b/2 - 2 a b / (a + b) in the H2 norm."""
    goal = StepTracking("r", "z", time_constant=model, relative_gap=0.1)
    distance = np.sqrt(0.5 * own + 0.5 * model - 2.0 * own * model / (own + model))
    expected = distance / (0.1 * np.sqrt(0.5 * model))
    assert value(goal, INTEGRATOR, feedback(1.0 / own)) == pytest.approx(expected, rel=5e-3, abs=1e-6)


def test_the_model_of_a_step_is_no_pole_of_the_loop() -> None:
    """A decay that is faster than the reference model can be asked for beside it; two references have two steps."""
    goals = [StepTracking("r", "z", time_constant=2.0), ClosedLoopPoles(min_decay=1.0)]
    models, needs = resolved([INTEGRATOR], goals)
    found = certify(models, feedback(1.5), needs)
    assert found.abscissae[0] == pytest.approx(-1.5) and found.values[1, 0] == pytest.approx(0.5)
    C, D = np.vstack([np.eye(2), -np.eye(2)]), np.zeros((4, 4))
    D[2:, :2] = np.eye(2)
    B = np.hstack([np.zeros((2, 2)), np.eye(2)])
    two = System(np.zeros((2, 2)), B, C, D, [("r", 2), ("u", 2)], [("z", 2), ("e", 2)])
    K = System.static(np.diag([3.0, 1.5]), [("e", 2)], [("u", 2)])
    models, needs = resolved([two], goals[:1])
    each = [value(goals[0], INTEGRATOR, feedback(k)) for k in (3.0, 1.5)]
    assert certify(models, K, needs).values[0, 0] == pytest.approx(np.sqrt(0.5 * np.sum(np.square(each))), rel=1e-9)


def test_overshoot_is_that_of_a_second_order_system() -> None:
    """1 / (s^2 + 2 z s + 1) with z = 0.4 overshoots by exp(-pi z / sqrt(1 - z^2)) = 25.38 %."""
    z = 0.4
    model = plant([1.0], [1.0, 2.0 * z, 0.0])
    percent = 100.0 * np.exp(-np.pi * z / np.sqrt(1.0 - z * z))
    assert value(Overshoot("r", "z", percent=percent), model, feedback(1.0)) == pytest.approx(1.0, rel=1e-6)


@pytest.mark.further
def test_goals_are_tuned_beside_requirements() -> None:
    """Fastest tracking with |T| <= 1 and a sensitivity of at most 1.2 in spite of a lag of 0.1 s in the loop."""
    model = plant([10.0], [1.0, 10.0, 0.0])
    goals = [
        Tracking("r", "z", response_time=0.1, name="tracking"),
        Sensitivity("u", bound=1.2, hard=True),
        ClosedLoopPoles(min_damping=0.5),
    ]
    result = tune([model], goals, LAW, initial=[[1.0]], options=TuningOptions(starts=0))
    assert result.status == "converged"
    assert result.requirement_names == ("tracking", "Sensitivity u", "ClosedLoopPoles")
    k = float(result.x[0])
    w = np.geomspace(1e-2, 1e3, 20001)
    S = 1.0 / (1.0 + k * 10.0 / ((1j * w) ** 2 + 10.0j * w))
    assert np.abs(S).max() == pytest.approx(1.2, rel=1e-3)
    assert result.certificate is not None and result.hard <= 1.0 + 1e-6


def test_goals_hold_over_a_box_of_parameters() -> None:
    """The sensitivity of g / (s (s + 2)) grows with g; the first law is enough for the nominal gain alone."""
    goals = [Sensitivity("u", bound=1.3, hard=True)]
    search, box = WorstCaseOptions(samples=0, climbs=0), {"gain": (0.5, 2.0)}
    options = RobustOptions(TuningOptions(starts=0), search)

    def build(values: Any) -> System:
        return plant([values["gain"]], [1.0, 2.0, 0.0])

    result = tune_robust(build, box, goals, LAW, initial=[[1.5]], options=options)
    for law, held in ((feedback(1.5), False), (result.controller, True)):
        (worst,) = worst_case(build, box, law, goals, options=search)
        assert (worst.value <= 1.0 + 1e-6) == held and worst.parameters["gain"] == pytest.approx(2.0)


FED = first_order(-1.0)


@pytest.mark.parametrize(
    ("weight", "same"),
    [
        (1 / (s + 1), transfer([1.0], [1.0, 1.0])),
        (signal.TransferFunction([1.0], [1.0, 1.0]), transfer([1.0], [1.0, 1.0])),
        (2.0, System.static([[2.0]], [("in", 1)], [("out", 1)])),
        ([[2.0]], System.static([[2.0]], [("in", 1)], [("out", 1)])),
        (np.array([[2]]), System.static([[2.0]], [("in", 1)], [("out", 1)])),
    ],
)
def test_what_is_a_linear_system_is_a_weight(weight: Any, same: System) -> None:
    K = controller(STATIC, [-1.0])
    for side in ("weight_in", "weight_out"):
        given, made = (HinfGain("w", "z", **{side: w}) for w in (weight, same))
        assert isinstance(getattr(given, side), System)
        assert certify([FED], K, [given]).values == certify([FED], K, [made]).values
    assert isinstance(Sensitivity("u", weight=weight).weight, System)


OMEGA = np.geomspace(0.01, 100.0, 21)
K = System.static([[-3.0]], [("y", 1)], [("u", 1)], "K")
UNEQUAL = System.static(np.diag([3.0, 1.0]), [("in", 2)], [("out", 2)])
LAG = System([[-2.0]], [[1.0]], [[2.0]], [[0.0]], [("in", 1)], [("out", 1)])
# closed loop from w to x and v = x: 1 / (s + 4); S = (s + 1) / (s + 4)
GAINS: list[tuple[TuningRequirement | Goal, float, object]] = [
    (Sensitivity("u", bound=2.0), 1.0, lambda w: 2.0 + 0.0 * w),
    (Margins("u", gain_margin=3.0), 0.5, lambda w: 1.0 + 0.0 * w),
    (MinLoopGain("u", 0.3), 1.0, lambda w: np.abs(1j * w + 3e-5) / 0.3),
    (MaxLoopGain("u", 30.0), 0.03, lambda w: 30.0 / w * np.abs(1.0 + 1j * w / 3e5)),
    (LoopShape("u", 3.0), 1.05, lambda w: 1.0 + 0.0 * w),
    (HinfGain("w", "x", bound=0.3, band=(0.1, 3.0), name="band"), 0.01, lambda w: 0.3 + 0.0 * w),
    (HinfGain("w", "x", weight_in=LAG, name="one weight"), 0.01, lambda w: np.abs(1j * w + 2.0) / 2.0),
    (HinfGain("w", ("x", "v"), weight_out=UNEQUAL, name="weighted"), 0.0316, lambda w: 1.0 + 0.0 * w),
    (Passivity("w", "v", input_index=-0.05, hard=True), 0.9, lambda w: 1.0 + 0.0 * w),
    (ConicSector("w", "x", low=-1.0, high=2.0), 1.0 / 3.0, lambda w: 1.0 + 0.0 * w),
    (Overshoot("w", "x", percent=20.0), 0.01, lambda w: Overshoot("w", "x", percent=20.0).peak_gain + 0.0 * w),
    (Tracking("w", "x", response_time=2.0), 1.0, lambda w: np.abs((1j * w + 1e-3) / (1j * w + 1.0))),
]
"""Goal, its result at 100 rad/s (to 6 %), its limit."""
OTHERS: list[TuningRequirement | Goal] = [
    H2Gain("w", "x", bound=0.5),
    StepTracking("w", "x", time_constant=0.5),
    ClosedLoopPoles(min_decay=0.5, min_damping=0.4, max_frequency=20.0),
    ControllerPoles(min_decay=1.0),
]


def two_outputs(rate: float = 1.0) -> System:
    ports = [("w", 1), ("u", 1)], [("x", 1), ("v", 1), ("y", 1)]
    return System([[-rate]], [[1, 1]], [[1], [1], [1]], np.zeros((3, 2)), *ports, f"lag {rate:g}")


def test_gains_have_their_limit_and_their_result() -> None:
    figure = plot_goals(two_outputs(), [goal for goal, _, _ in GAINS], K, omega=OMEGA)
    assert len(figure.axes) == len(GAINS)
    for axes, (goal, last, limit) in zip(figure.axes, GAINS):
        result, drawn = (np.asarray(line.get_ydata()) for line in axes.lines)
        assert result[-1] == pytest.approx(last, rel=0.06), goal
        assert drawn == pytest.approx(limit(OMEGA), rel=1e-9), goal  # type: ignore[operator]
    sensitivity = np.asarray(figure.axes[0].lines[0].get_ydata())
    assert sensitivity == pytest.approx(np.abs((1j * OMEGA + 1.0) / (1j * OMEGA + 4.0)), rel=1e-9)
    assert figure.axes[0].get_title() == "Sensitivity u: 0.5"
    assert figure.axes[8].get_title().startswith("Passivity w -> v (hard): ")


def test_variances_steps_and_poles_are_those_of_the_models() -> None:
    dynamic = System([[-5.0]], [[1.0]], [[0.0]], [[-3.0]], [("y", 1)], [("u", 1)], "K")
    bars, step, closed, own = plot_goals([two_outputs(), two_outputs(2.0)], OTHERS, dynamic).axes
    heights = [bar.get_height() for bar in bars.patches if bar.get_width() < 1.0]  # type: ignore[attr-defined]
    assert heights == pytest.approx([np.sqrt(1.0 / 8.0), np.sqrt(1.0 / 10.0)], rel=1e-9)
    time, first = (np.asarray(data) for data in step.lines[0].get_data())
    assert first == pytest.approx((1.0 - np.exp(-4.0 * time)) / 4.0, abs=1e-9)
    assert np.asarray(step.lines[-1].get_ydata()) == pytest.approx(1.0 - np.exp(-2.0 * time), abs=1e-12)
    points = np.asarray(closed.collections[-1].get_offsets())
    assert sorted(points[:, 0]) == pytest.approx([-5, -5, -5, -4], abs=1e-9)  # not the reference model's
    decay, up, _, circle = (np.array(line.get_data()) for line in closed.lines[1:])
    assert np.all(decay[0] == -0.5) and up[1] / up[0] == pytest.approx(-np.sqrt(1.0 - 0.16) / 0.4)
    assert np.hypot(*circle) == pytest.approx(20.0)
    assert np.asarray(own.collections[-1].get_offsets())[:, 0].tolist() == [-5.0]


def test_goals_of_samples_are_drawn_up_to_half_of_their_frequency() -> None:
    dt = 0.1
    model = System(
        [[0.9]], [[0.1, 0.1]], [[1]] * 3, np.zeros((3, 2)), two_outputs().inputs, two_outputs().outputs, dt=dt
    )
    figure = plot_goals(model, [Sensitivity("u"), *OTHERS[:3]], replace(K, dt=dt))
    w, gains = (np.asarray(data) for data in figure.axes[0].lines[0].get_data())
    assert w[-1] == pytest.approx(np.pi / dt)
    assert gains == pytest.approx(np.abs((np.exp(0.1j * w) - 0.9) / (np.exp(0.1j * w) - 0.6)), rel=1e-9)
    assert np.asarray(figure.axes[2].lines[0].get_ydata())[:3] == pytest.approx([0.0, 0.1, 0.16])
    assert np.asarray(figure.axes[3].collections[-1].get_offsets())[0, 0] == pytest.approx(np.log(0.6) / dt)


def test_the_picture_shows_the_value_where_it_is_taken() -> None:
    """A leaking integrator in a weight: the value is far below the poles of the loop."""
    axes = plot_goals(two_outputs(), [MinLoopGain("u", 10.0)], K).axes[0]
    result, limit = (np.asarray(line.get_ydata()) for line in axes.lines)
    assert (result / limit).max() == pytest.approx(float(axes.get_title().split(": ")[1]), rel=0.02)
