"""Pictures of goals show the limit that was asked for and the result of the loop, for every kind of goal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

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
    Sensitivity,
    StepTracking,
    Tracking,
    TuningRequirement,
    plot_goals,
)

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


def lag(rate: float = 1.0) -> System:
    ports = [("w", 1), ("u", 1)], [("x", 1), ("v", 1), ("y", 1)]
    return System([[-rate]], [[1, 1]], [[1], [1], [1]], np.zeros((3, 2)), *ports, f"lag {rate:g}")


def test_gains_have_their_limit_and_their_result() -> None:
    figure = plot_goals(lag(), [goal for goal, _, _ in GAINS], K, omega=OMEGA)
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
    bars, step, closed, own = plot_goals([lag(), lag(2.0)], OTHERS, dynamic).axes
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
    model = System([[0.9]], [[0.1, 0.1]], [[1]] * 3, np.zeros((3, 2)), lag().inputs, lag().outputs, dt=dt)
    figure = plot_goals(model, [Sensitivity("u"), *OTHERS[:3]], replace(K, dt=dt))
    w, gains = (np.asarray(data) for data in figure.axes[0].lines[0].get_data())
    assert w[-1] == pytest.approx(np.pi / dt)
    assert gains == pytest.approx(np.abs((np.exp(0.1j * w) - 0.9) / (np.exp(0.1j * w) - 0.6)), rel=1e-9)
    assert np.asarray(figure.axes[2].lines[0].get_ydata())[:3] == pytest.approx([0.0, 0.1, 0.16])
    assert np.asarray(figure.axes[3].collections[-1].get_offsets())[0, 0] == pytest.approx(np.log(0.6) / dt)


def test_the_picture_shows_the_value_where_it_is_taken() -> None:
    """A leaking integrator in a weight: the value is far below the poles of the loop."""
    axes = plot_goals(lag(), [MinLoopGain("u", 10.0)], K).axes[0]
    result, limit = (np.asarray(line.get_ydata()) for line in axes.lines)
    assert (result / limit).max() == pytest.approx(float(axes.get_title().split(": ")[1]), rel=0.02)
