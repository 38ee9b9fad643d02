"""Records that do not show the motion: held, interpolated, stuck and clipped ones, and those that only look so."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import Akima1DInterpolator, CubicSpline, PchipInterpolator
from scipy.signal import lfilter, resample

from pointing_analysis.arrays import BoolArray, FloatArray
from pointing_analysis.indices.held_rows import Hold, hold_of, samples_behind
from pointing_analysis.indices.live_rows import filled_rows, interpolated_rows, stuck_rows
from pointing_analysis.indices.saturation import saturated_rows
from pointing_analysis.read.series import series
from pointing_analysis.requirements.requirement import parse
from pointing_analysis.requirements.series_verdict import judge_series
from pointing_analysis.requirements.summary import Summary
from pointing_analysis.requirements.verdict import judge

N, DT = 60_000, 1e-3
TIME = DT * np.arange(N)
APE_AND_RPE = ("|APE|", "rms RPE(20 ms)")
RPE = "prob(rms RPE(20 ms) < 40 mas) >= 0.997 at 95 % confidence"
APE = "prob(|APE| < 1000 mas) >= 0.997 at 95 % confidence"


def white(sigma: float, rows: int = N) -> FloatArray:
    """[mas], two axes."""
    return sigma * np.random.default_rng(0).standard_normal((rows, 2))


def tone(hertz: float, size: float) -> FloatArray:
    phase = 2.0 * np.pi * hertz * TIME
    return np.column_stack([size * np.cos(phase), 0.7 * size * np.sin(phase)])


def judged(e: FloatArray) -> Summary:
    return judge_series(TIME[: len(e)], e, unit="mas", requirements=[RPE, APE], transient=0.0)


def interpolated(digits: int | None = None) -> FloatArray:
    coarse, rows = white(300.0, N // 20 + 1), np.arange(N)
    e = np.column_stack([np.interp(rows, 20.0 * np.arange(len(coarse)), axis) for axis in coarse.T])
    return e if digits is None else np.round(e, digits)


def irregular() -> FloatArray:
    lengths = np.random.default_rng(1).integers(13, 19, 4000)
    return np.repeat(white(300.0, 4000), lengths, axis=0)[:N]


@pytest.mark.parametrize(
    ("record", "rate"),
    [
        (lambda: np.repeat(white(300.0, N // 20), 20, axis=0), 50.0),
        (lambda: white(300.0)[(0.03 * np.arange(N)).astype(int)], 30.0),
        (lambda: np.round(np.repeat(white(300.0, N // 20), 20, axis=0) / 60.0) * 60.0, 50.0),
        (irregular, 1000.0 / 15.5),
        (interpolated, 50.0),
        (lambda: interpolated(2), 50.0),
    ],
    ids=["50 Hz", "30 Hz", "50 Hz quantised", "jitter", "interpolated", "interpolated, two digits"],
)
def test_a_slower_sensor_is_not_judged_within_its_period(record: Callable[[], FloatArray], rate: float) -> None:
    """A camera of 50 Hz in rows of 1 kHz: its RPE(20 ms) would be zero where the motion has 500 mas."""
    summary = judged(record())
    relative, absolute = summary.verdicts
    assert relative.status == "not judged" and "window must last for two samples" in relative.note
    assert absolute.status != "not judged" and absolute.samples == pytest.approx(rate * 60.0, rel=0.01)
    remark = next(text for text in summary.problems if "each sample is" in text)
    shown = re.search(r"a record of ([\d.]+) Hz, which shows no motion above ([\d.]+) Hz", remark)
    assert shown and [float(x) for x in shown.groups()] == pytest.approx([rate, rate / 2.0], rel=0.01)


@pytest.mark.parametrize("digits", [12, 3])
def test_a_spectrum_that_ends_early_is_said(digits: int) -> None:
    """50 Hz brought to 1 kHz by a Fourier series."""
    e = np.round(resample(white(300.0)[::20], N), digits)
    assert "above 25.2 Hz the record is near the rounding of its numbers: figures of motion below" in [
        text.replace("25.1", "25.2") for text in judged(e).problems
    ]


def changed(e: FloatArray, change: Callable[[FloatArray], Any]) -> FloatArray:
    change(e)
    return e


@pytest.mark.parametrize(
    ("record", "what", "share"),
    [
        (lambda: np.clip(white(3000.0), -600.0, 600.0), "saturated", 0.975),
        (lambda: np.clip(white(300.0), -900.0, 900.0), "saturated", 0.0054),
        (lambda: np.clip(tone(0.37, 3000.0), -600.0, 600.0), "saturated", 1.0),
        (lambda: np.clip(np.round(white(300.0) / 30.0) * 30.0, -600.0, 600.0), "saturated", 0.1),
        (lambda: (e := white(3000.0)) * np.minimum(1.0, 600.0 / np.hypot(*e.T))[:, None], "saturated", 0.98),
        (lambda: changed(white(10.0), lambda e: e.__setitem__(slice(20_000, 38_000), e[20_000])), "stuck", 0.3),
        (lambda: changed(white(10.0), lambda e: e.__setitem__((slice(0, 18_000), 1), e[0, 1])), "stuck", 0.3),
        (lambda: changed(white(10.0), lambda e: e.__setitem__(slice(42_000, None), e[42_000])), "stuck", 0.3),
        (
            lambda: changed(np.round(white(300.0), -1), lambda e: e.__setitem__(slice(20_000, 38_000), e[20_000])),
            "stuck",
            0.3,
        ),
    ],
    ids=[
        "clipped", "in the tail", "tone", "quantised", "norm", "stuck", "one axis", "to the end", "quantised and stuck",
    ],
)  # fmt: skip
def test_what_the_sensor_did_not_see_is_not_judged(record: Callable[[], FloatArray], what: str, share: float) -> None:
    verdicts = judged(record()).verdicts
    for verdict in verdicts:
        assert verdict.status == "not judged" and verdict.note.startswith(f"{what}: ")
        assert float(verdict.note.split()[1]) / 100.0 == pytest.approx(share, rel=0.1)


def test_a_few_stuck_samples_are_missing_ones() -> None:
    """Fewer than the requirement allows to exceed: they count against the verdict, as lost ones do."""
    e = changed(white(10.0), lambda e: e.__setitem__(slice(30_000, 30_051), e[30_000]))
    loose = "prob(|APE| < 1000 mas) >= 0.99 at 95 % confidence"
    (verdict,) = judge_series(TIME, e, unit="mas", requirements=loose, transient=0.0).verdicts
    assert (verdict.status, verdict.missing, verdict.samples) == ("compliant", 50.0, N - 50)


SEEN = {
    "constant": lambda: np.full((N, 2), 5.0),
    "zero": lambda: np.zeros((N, 2)),
    "one axis": lambda: np.column_stack([white(10.0)[:, 0], np.zeros(N)]),
    "quantised 1 %": lambda: np.round(white(10.0) / 10.0) * 10.0,
    "quantised 5 %": lambda: np.round(white(100.0) / 50.0) * 50.0,
    "quantised 20 %": lambda: np.round(white(300.0) / 200.0) * 200.0,
    "quantised slow tone": lambda: np.round(tone(0.1, 900.0) / 200.0) * 200.0,
    "quantised slow tone 1 %": lambda: np.round(tone(0.1, 900.0) / 10.0) * 10.0,
    "quantised slow tone with noise": lambda: np.round((tone(0.1, 900.0) + white(3.0)) / 10.0) * 10.0,
    "quantised drift": lambda: np.round(np.column_stack([15.0 * TIME, 0.0 * TIME]) / 10.0) * 10.0,
    "tone of 60.19 Hz": lambda: tone(60.19, 30.0),
    "tone of 8 samples": lambda: tone(125.0, 30.0),
    "tone of 4 samples": lambda: tone(250.0, 30.0),
    "slow tone": lambda: tone(0.01, 900.0),
    "circle": lambda: np.column_stack([np.cos(20.0 * TIME), np.sin(20.0 * TIME)]),
    "ramp": lambda: np.column_stack([10.0 * TIME, 0.0 * TIME]),
    "step response": lambda: np.column_stack([100.0 * (1.0 - np.exp(-TIME / 1.5)), 0.0 * TIME]),
    "impulse response": lambda: np.exp(-TIME / 2.0)[:, None] * tone(11.0, 500.0),
    "first order": lambda: lfilter([1.0], [1.0, -0.99], white(10.0), axis=0),
    "two digits": lambda: np.round(white(10.0), 2),
    "float32": lambda: white(10.0).astype(np.float32).astype(float),
}


@pytest.mark.parametrize("kind", SEEN)
def test_motions_that_repeat_values_by_chance_are_judged(kind: str) -> None:
    e = np.asarray(SEEN[kind]())
    assert hold_of(e) is None and not stuck_rows(e).any() and not saturated_rows(e).any()
    assert "not judged" not in {verdict.status for verdict in judged(e).verdicts}


def test_a_motion_without_noise_may_rest_at_zero() -> None:
    """A simulation of an event: before and behind it nothing moves. With noise the zeros are those of a dead sensor."""
    ringing = np.exp(-TIME / 0.5)[:, None] * tone(11.0, 500.0) * (TIME < 5.0)[:, None]
    event = np.where((TIME < 20.0)[:, None], 0.0, np.roll(ringing, 20_000, axis=0))
    assert not stuck_rows(event).any()
    dead = judged(np.where((TIME < 20.0)[:, None], 0.0, white(10.0)))
    assert [verdict.note for verdict in dead.verdicts] == ["stuck: 33.3 % of the samples"] * 2
    slew = np.cumsum(np.maximum(0.0, 1.0 - np.abs(TIME - 1.0)))  # to an angle, with a trapezoid of the velocity
    assert not stuck_rows(np.column_stack([slew, white(10.0)[:, 0]])).any()


@pytest.mark.parametrize("motion", [white(10.0)[:, 1], tone(0.37, 900.0)[:, 0], tone(7.0, 20.0)[:, 1]])
@pytest.mark.parametrize("value", [0.0, 3.0])
def test_an_axis_that_stops_is_stuck_whatever_the_other_one_does(motion: FloatArray, value: float) -> None:
    """A dead channel has zeros from some row on: a motion of any kind does not jump to rest."""
    stops = np.where(TIME < 40.15, motion, value)
    for beside in (white(10.0)[:, 0], tone(1.3, 70.0)[:, 0], np.zeros(N)):
        assert stuck_rows(np.column_stack([stops, beside])).mean() == pytest.approx(0.331, abs=1e-3)
    assert not stuck_rows(np.column_stack([np.full(N, value), motion])).any(), "constant in the whole record"


@pytest.mark.parametrize("rate", [24.0, 30.0, 45.0, 60.0, 99.0, 120.0, 150.0])
def test_samples_between_rows_keep_their_rate_and_the_length_of_the_record(rate: float) -> None:
    """A 60 Hz camera that was interpolated on 1 kHz became one of 62.5 Hz, of 60 s 93 s, and was compliant."""
    rows, time = np.arange(20_000) * 1e-3, np.arange(0.0, 20.1, 1.0 / rate)
    samples = np.random.default_rng(0).standard_normal((len(time), 2))
    record = np.column_stack([np.interp(rows, time, axis) for axis in samples.T])
    hold = hold_of(record)
    assert hold is not None and hold.rows == pytest.approx(1000.0 / rate, rel=1e-3)
    assert len(samples_behind(record, hold)) == pytest.approx(20.0 * rate, abs=2)


def test_held_samples_beside_a_smooth_motion_or_a_little_noise_are_held() -> None:
    """The error of a held measurement against a target that moves."""
    held = np.repeat(np.random.default_rng(0).standard_normal((600, 2)), 20, axis=0)
    target = np.column_stack([np.linspace(0.0, 2.0, len(held)), 0.2 * np.sin(np.linspace(0.0, 5.0, len(held)))])
    noise = 3e-5 * np.random.default_rng(1).standard_normal(held.shape)
    for record in (held - target, held + noise):
        hold = hold_of(record)
        assert hold is not None and hold.rows == pytest.approx(20.0, rel=2e-3)


@pytest.mark.parametrize("digits", [2, 6, 12])
def test_a_norm_that_is_clipped_is_saturated_whatever_the_digits_of_the_file(digits: int) -> None:
    motion = 20.0 * np.random.default_rng(0).standard_normal((20_000, 2))
    norm = np.hypot(*motion.T)
    clipped = np.round(motion * np.minimum(1.0, 20.0 / norm)[:, None], digits)
    assert saturated_rows(clipped).mean() == pytest.approx(np.mean(norm > 20.0), abs=0.01)
    circle = 20.0 * np.column_stack([np.cos(0.05 * np.arange(20_000)), np.sin(0.05 * np.arange(20_000))])
    assert not saturated_rows(np.round(circle, digits)).any(), "a motion of constant size"


@pytest.mark.parametrize("rows", [8, 50 / 3, 20])
@pytest.mark.parametrize("method", [PchipInterpolator, CubicSpline, Akima1DInterpolator])
def test_samples_behind_cubic_interpolation_are_seen(method: Any, rows: float) -> None:
    """Of white motion, whose error in short windows the interpolated record does not have."""
    times = rows * np.arange(round(8000 / rows))
    e = method(times, np.random.default_rng(4).standard_normal((len(times), 2)))(np.arange(times[-1]))
    found = hold_of(e)
    assert found is not None and found.rows == pytest.approx(rows, rel=5e-3)


def test_smooth_motions_without_noise_are_no_interpolation() -> None:
    t = 1e-3 * np.arange(8000)
    rng = np.random.default_rng(2)
    held = np.repeat(rng.standard_normal((400, 2)), 20, axis=0)
    motions = [np.column_stack([np.sin(w * t), np.cos(w * t)]) for w in (2.0, 60.0, 400.0)]
    motions.append(np.cumsum(np.cumsum(held, axis=0), axis=0))  # a mass under a force that is held for 20 ms
    motions.append(lfilter([1.0], np.poly([0.99, 0.98, 0.97]), rng.standard_normal((8000, 2)), axis=0))
    assert [hold_of(e) for e in motions] == [None] * len(motions)


@pytest.mark.parametrize("wrong", ["stuck", "saturated", "missing"])
def test_an_axis_that_was_not_seen_leaves_the_other_one_judged(wrong: str) -> None:
    e = white(10.0)
    e[:, 1] = np.clip(e[:, 1], -5.0, 5.0) if wrong == "saturated" else e[:, 1]
    e[20_000:38_000, 1] = {"stuck": e[20_000, 1], "saturated": 0.1, "missing": np.nan}[wrong]
    texts = [f"prob(|APE{axis}| < 50 mas) >= 0.99 at 95 % confidence" for axis in ("_x", "_y", "")]
    texts += [f"prob(|PRE{axis}(1 s)| < 9 mas) >= 0.9 at 90 % confidence" for axis in ("_x", "_y")]
    ape_x, ape_y, norm = (judge(parse(text), [series(TIME, e, unit="mas")], 0.0) for text in texts[:3])
    pair = [series(TIME, white(10.0)[::-1], unit="mas"), series(TIME, e, unit="mas")]
    pre_x, pre_y = (judge(parse(text), pair, 0.0) for text in texts[3:])
    assert (ape_x.status, ape_x.samples, ape_x.missing) == ("compliant", N, 0.0)
    assert pre_x.status == "compliant" and pre_x.missing == 0.0
    if wrong == "missing":
        assert ape_y.missing == norm.missing == 18_000 and pre_y.missing > 0
    else:
        assert all(verdict.note.startswith(f"{wrong}: ") for verdict in (ape_y, norm, pre_y))


@pytest.mark.parametrize("axis", [0, 1])
def test_axes_of_different_rates_have_no_common_one(axis: int) -> None:
    """Held, joined by lines or by a spline, beside noise; a triangle, a square wave and a constant are motions."""
    rows, rng = np.arange(8000), np.random.default_rng(3)
    samples = rng.standard_normal(401)
    knots = 20 * np.arange(401)
    fewer = [np.repeat(samples[:400], 20), np.interp(rows, knots, samples), CubicSpline(knots, samples)(rows)]
    motions = [np.abs(7e-3 * rows % 2 - 1), (5e-3 * rows % 1 < 0.5) * 1.0, np.full(8000, 3.0)]
    beside = rng.standard_normal(8000)
    found = [hold_of(np.column_stack([one, beside][:: 1 - 2 * axis])) for one in (*fewer, *motions)]
    assert found[3:] == [None] * 3
    for hold in found[:3]:
        assert isinstance(hold, tuple) and hold[axis] == pytest.approx(20.0, rel=0.01) and hold[1 - axis] == 1.0


def test_axes_of_different_rates_are_judged_alone() -> None:
    """Taken every 20 rows, a tone of the axis that is not held would be a constant, and its windows those of noise."""
    rng = np.random.default_rng(5)
    held, time = np.repeat(1e-9 * rng.standard_normal(3000), 20), 1e-3 * np.arange(60_000)
    live = 5e-8 * np.sin(2 * np.pi * 200.0 * time) + 1e-9 * rng.standard_normal(60_000)
    limits = [
        f"prob({index} < {limit} mas) >= 0.95 at 90 % confidence"
        for index, limit in (("|APE_y|", 5), ("|RPE_y(50 ms)|", 9), ("|RPE(50 ms)|", 9), ("|APE_x|", 1))
    ]
    limits.append("prob(rms RPE_x(20 ms) < 9 mas) >= 0.95 at 90 % confidence")
    both, alone = (np.column_stack([x, live]) for x in (held, 0.0 * held))
    summary = judge_series(time, both, unit="rad", requirements=limits, transient=0.0)
    *of_y, norm, of_x, within = summary.verdicts
    assert norm.status == "not judged" and "the axes have samples at different rates, 50 and 1000 Hz" in norm.note
    judged_alone = judge_series(time, alone, unit="rad", requirements=limits[:3], transient=0.0).verdicts
    assert [verdict.status for verdict in judged_alone] == ["not compliant"] * 3
    assert of_y == list(judged_alone[:2]), "an axis is judged as if it were alone"
    assert of_x.samples == 3000 and of_x.status == "compliant"
    assert within.status == "not judged" and "two samples of 20 ms" in within.note
    assert any(text.startswith("x: each sample is held") for text in summary.problems)
    other = np.repeat(1e-9 * rng.standard_normal(1500), 40)
    assert hold_of(np.column_stack([held, other])) == (20.0, 40.0)
    shifted = hold_of(np.column_stack([held, np.roll(held[::-1], 10)]))
    assert shifted is not None and not isinstance(shifted, tuple) and shifted.rows == pytest.approx(20.0, rel=0.01)


@pytest.mark.parametrize("row", [1, 2, 3, 10, 100])
def test_an_axis_that_is_dead_from_one_of_the_first_rows_on_is_stuck(row: int) -> None:
    e = 8.0 * np.random.default_rng(row).standard_normal((60_000, 2))
    e[row:, 1] = e[row, 1]
    assert stuck_rows(e).sum() == 60_000 - row - 1


@pytest.mark.parametrize("steps", [2, 5, 20])
def test_a_slow_drift_of_few_quanta_is_no_stuck_axis(steps: int) -> None:
    drift = np.round(np.linspace(0.0, steps, 60_000))
    noise = np.round(8.0 * np.random.default_rng(1).standard_normal(60_000))
    assert not stuck_rows(np.column_stack([drift, noise])).any()


@pytest.mark.parametrize("seed", range(6))
def test_an_axis_that_is_clipped_at_both_ends_is_so_in_the_norm(seed: int) -> None:
    """0.27 % of the samples, of which each end has half."""
    x, y = 10.0 * np.random.default_rng(seed).standard_normal((2, 60_000))
    clipped = np.column_stack([np.clip(x, -30.0, 30.0), y])
    np.testing.assert_array_equal(saturated_rows(clipped), np.abs(x) >= 30.0)


def test_a_lost_frame_that_repeats_the_one_before_is_stuck_in_both_axes() -> None:
    rng = np.random.default_rng(3)
    frames, lost = 10.0 * rng.standard_normal((6000, 2)), rng.random(6000) < 0.2
    lost[0] = False
    kept = np.maximum.accumulate(np.where(lost, 0, np.arange(6000)))
    record = np.repeat(frames[kept], 10, axis=0)
    hold = hold_of(record)
    assert isinstance(hold, Hold)
    samples = samples_behind(record, hold)
    for axis in samples.T:
        np.testing.assert_array_equal(stuck_rows(np.column_stack([axis, 0.0 * axis])), lost)


def test_samples_between_which_a_spline_runs_are_none_that_repeat() -> None:
    knots = np.random.default_rng(4).standard_normal((600, 2))
    record = CubicSpline(10.0 * np.arange(600), knots)(np.arange(5991.0))
    hold = hold_of(record)
    assert isinstance(hold, Hold)
    samples = samples_behind(record, hold)
    assert not stuck_rows(samples).any() and len(samples) == pytest.approx(600, abs=1)


def test_an_axis_with_a_value_in_each_tenth_row_has_a_tenth_of_the_rate() -> None:
    record = np.random.default_rng(5).standard_normal((5000, 2))
    record[np.arange(5000) % 10 != 0, 1] = np.nan
    assert hold_of(record) == (1.0, 10.0)
    alone = hold_of(np.column_stack([np.zeros(5000), record[:, 1]]))
    assert isinstance(alone, Hold) and alone.rows == 10.0
    assert np.isfinite(samples_behind(record[:, 1:], alone)).all()


@pytest.mark.parametrize("seed", range(20))
def test_few_repeats_and_ends_that_are_no_limits_are_judged(seed: int) -> None:
    """Short records whose rounding repeats some values, and a motion that settles at the precision of numbers."""
    rng = np.random.default_rng([9, seed])
    time, white = np.arange(300) / 500.0, rng.standard_normal((300, 2))
    tone = np.column_stack([np.sin(40.0 * time + seed), np.cos(47.0 * time)])
    digits = np.array([float(f"{value:.3g}") for value in rng.standard_normal(20_000)]).reshape(-1, 2)
    settled = np.column_stack([1.0 - np.exp(-np.arange(30_000) / 500.0), np.exp(-np.arange(30_000) / 500.0)])
    for e in (np.round(white / 0.01) * 0.01, np.round(white, 1), np.round(20.0 * tone), digits, settled):
        assert not stuck_rows(e).any() and not saturated_rows(e).any()


@pytest.mark.parametrize("step", [4.5, 10.0, 12.0])
def test_rounding_that_hides_the_motion_is_not_judged(step: float) -> None:
    """Steps of more than half of the limit."""
    rounded = np.round(white(2.0) / step) * step
    texts = [
        f"prob({index} < {limit} mas) >= 0.95 at 90 % confidence" for index in APE_AND_RPE for limit in (4, 2.5 * step)
    ]
    found = judge_series(TIME, rounded, unit="mas", requirements=texts, transient=0.0)
    for index, verdict in enumerate(found.verdicts):
        if index % 2:
            assert verdict.status == "compliant"
        else:
            assert verdict.status == "not judged" and f"steps of {step:g} mas" in verdict.note
    assert any(f"steps of {step:g} mas, larger than the motion" in text for text in found.problems)
    two_levels = judged(np.round((white(40.0) + 130.0) / 200.0) * 200.0)
    assert [verdict.status for verdict in two_levels.verdicts] == ["not judged", "compliant"]


@pytest.mark.parametrize("dies_at", [1.0, 3.0, 4.999])
def test_an_axis_that_dies_in_the_start_up_is_not_judged(dies_at: float) -> None:
    """The judged rows are constant, as those of an axis that never moves: the rows before tell them apart."""
    e = white(20.0)
    e[dies_at < TIME, 0] = e[int(1e3 * dies_at), 0]
    e[:, 1] *= 0.2
    texts = [f"prob(|APE{axis}| < 50 mas) >= 0.9 at 90 % confidence" for axis in ("_x", "", "_y")]
    found = judge_series(TIME, e, unit="mas", requirements=texts, transient=5.0)
    assert [verdict.status for verdict in found.verdicts] == ["not judged", "not judged", "compliant"]
    assert "x has the same value in all samples" in found.problems


@pytest.mark.parametrize("digits", [3, 12])
@pytest.mark.parametrize("lost", ["a gap of 2 s", "gaps of 50 rows", "every second row", "a row in two", "300 Hz"])
def test_gaps_that_were_filled_by_lines_are_missing(lost: str, digits: int) -> None:
    """As numpy.interp and fillmissing do: the rows of the motion between are not known."""
    e, rows, rng = white(10.0), np.arange(N), np.random.default_rng(7)
    kept: BoolArray = np.ones(N, bool)
    if lost == "300 Hz":
        kept = rows < 0.3 * N + 1
    elif lost == "a gap of 2 s":
        kept[20_001:22_000] = False
    elif lost == "gaps of 50 rows":
        for start in rng.integers(100, N - 100, 700):
            kept[start : start + 50] = False
    else:
        kept = rows % 2 == 0 if lost == "every second row" else rng.random(N) < 0.5
    kept[-1] |= lost != "300 Hz"
    times = np.flatnonzero(kept) * (10.0 / 3.0 if lost == "300 Hz" else 1.0)
    filled = np.column_stack([np.interp(rows, times, axis) for axis in e[kept].T])
    filled = np.round(filled, digits)
    interpolated = interpolated_rows(filled)
    even = lost in ("every second row", "300 Hz")  # brought to another rate: no row is taken for a sample
    assert interpolated.mean() == (1.0 if even else pytest.approx(1.0 - kept.mean(), rel=0.02))
    assert not interpolated_rows(np.round(e, digits)).any()
    found = judge_series(
        TIME, filled, unit="mas", requirements="prob(|APE| < 1000 mas) >= 0.99 at 95 % confidence", transient=0.0
    )
    (verdict,) = found.verdicts
    if lost == "every second row":  # lines over two rows: the samples have half of the rate
        assert verdict.status == "compliant" and (verdict.samples, verdict.missing) == (N // 2, 0.0)
        assert any("500 Hz" in text for text in found.problems)
    else:
        assert verdict.status == "not judged" and "interpolated" in verdict.note


@pytest.mark.parametrize("digits", range(3, 10))
@pytest.mark.parametrize(("unit", "size"), [("mas", 1.0), ("urad", 4.848e-3)])
def test_lines_are_seen_whatever_the_decimals_of_the_file_are(digits: int, unit: str, size: float) -> None:
    """Also where no step of the file is its last decimal alone."""
    e, filled = white(3.0), np.zeros(N, bool)
    for first in range(100, N - 1000, 333):
        e[first : first + 30] = np.linspace(e[first - 1], e[first + 30], 32)[1:-1]
        filled[first : first + 30] = True
    rounded = np.round(size * e, digits + (unit == "urad") * 2)
    assert interpolated_rows(rounded).mean() == pytest.approx(filled.mean(), rel=0.05)


@pytest.mark.parametrize("step", [0.3, 0.5, 0.75, 1.0])
@pytest.mark.parametrize("memory", [0.0, 0.5, 0.99])
@pytest.mark.parametrize("low", [-6.0, -np.inf])
def test_a_coarsely_rounded_sensor_that_saturates_is_not_compliant(step: float, memory: float, low: float) -> None:
    """More samples at the last level than those below lead to; without the ends of its range it is judged."""
    rng = np.random.default_rng(int(100 * step))
    motion = lfilter([1.0], [1.0, -memory], rng.standard_normal((4 * N, 2)), axis=0)
    motion *= 3.0 / motion.std(axis=0)
    rounded, time = step * np.round(motion / step), 1e-3 * np.arange(4 * N)
    text = "prob(|APE_x| < 6.2 mas) >= 0.97 at 90 % confidence"
    clipped = judge_series(time, np.clip(rounded, low, 6.0), unit="mas", requirements=text).verdicts[0]
    assert clipped.status in ("not judged", "not enough data") and np.mean(np.abs(motion[:, 0]) > 6.2) > 0.03
    assert not saturated_rows(rounded).any()


@pytest.mark.parametrize("step", [0.5, 2.0, 4.0])
def test_what_is_bounded_is_not_saturated(step: float) -> None:
    rng, time = np.random.default_rng(3), 1e-3 * np.arange(4 * N)
    tones = [8.0 * np.column_stack([np.sin(w * time), np.cos(w * time)]) for w in (6.28, 232.0, 1885.0)]
    motions = [rng.uniform(-8.0, 8.0, (4 * N, 2)), rng.laplace(0.0, 2.0, (4 * N, 2)), rng.standard_t(3, (4 * N, 2))]
    motions += [tone + noise * rng.standard_normal(tone.shape) for tone in tones for noise in (0.1, 0.5, 2.0)]
    for motion in motions:
        assert not saturated_rows(step * np.round(motion / step)).any()


@pytest.mark.parametrize("step", [1.0, 2.0, 3.0, 4.0])
def test_stuck_rows_of_a_coarsely_rounded_noise_are_missing(step: float) -> None:
    """Runs of 30 rows whose edges are one quantum or two, in a signal that jumps to and fro by several."""
    rounded, stuck = step * np.round(white(3.0) / step), np.zeros(N, bool)
    assert not stuck_rows(rounded).any()
    for first in range(100, N - 1000, 333):
        rounded[first : first + 30] = rounded[first - 1]
        stuck[first : first + 30] = True
    assert stuck_rows(rounded)[stuck].all() and stuck_rows(rounded).mean() < 1.2 * stuck.mean()


@pytest.mark.parametrize("lost", [50, 300, 600])
def test_a_held_record_with_missing_rows_has_its_samples(lost: int) -> None:
    """Single rows of the log are missing, each camera value is still there."""
    held, kept = np.repeat(white(3.0, N // 20), 20, axis=0), np.ones(N, bool)
    kept[np.random.default_rng(lost).choice(np.arange(20, N - 20), lost, replace=False)] = False
    text = "prob(|APE| < 20 mas) >= 0.9 at 90 % confidence"
    whole, some = (
        judge_series(t, e, unit="mas", requirements=text) for t, e in ((TIME, held), (TIME[kept], held[kept]))
    )
    first, second = whole.verdicts[0], some.verdicts[0]
    assert (second.status, second.samples, second.missing) == (first.status, first.samples, 0.0)
    assert second.effective == first.effective


@pytest.mark.parametrize("rate", [333.0, 490.0, 510.0])
def test_samples_that_are_held_for_two_rows_or_three_are_all_there(rate: float) -> None:
    held = white(3.0)[np.floor(TIME * rate + 1e-9).astype(int)]
    hold = hold_of(held)
    assert isinstance(hold, Hold) and hold.repeats.sum() == len(np.unique(held[:, 0]))


def test_motions_without_noise_are_not_interpolated() -> None:
    t = TIME
    ringing = np.exp(-t / 2.0) * np.cos(70.0 * t)
    motions = {
        "triangle": np.abs(7e-3 * np.arange(N) % 2 - 1),
        "a slew that rings": 3.0 * t + ringing,
        "an offset that rings": 100.0 + 500.0 * ringing,
        "a tone of 20 rows": np.sin(2 * np.pi * 50.0 * t),
        "a slow tone": 900.0 * np.sin(0.06 * t),
        "a force held for 20 ms": np.cumsum(np.cumsum(np.repeat(white(1.0, N // 20)[:, 0], 20))),
        "rare bursts": white(0.01)[:, 0] + np.where(np.arange(N) % 6000 < 20, white(40.0)[:, 1], 0.0),
        "slow noise": lfilter([1.0], np.poly([0.999, 0.99, 0.98]), white(1.0)[:, 0]),
    }
    shares = {name: interpolated_rows(np.column_stack([x, 0.0 * x])).mean() for name, x in motions.items()}
    assert shares == dict.fromkeys(motions, 0.0)


@pytest.mark.parametrize("rate", [240.0, 123.4, 333.0, 199.98, 250.05, 99.9, 49.9])
def test_samples_between_the_rows_are_not_judged(rate: float) -> None:
    """Between them the interpolated rows are smaller than the motion."""
    times = np.arange(0.0, 60.1, 1.0 / rate)
    e = np.column_stack([np.interp(TIME, times, axis) for axis in white(300.0, len(times)).T])
    assert {verdict.status for verdict in judged(e).verdicts} == {"not judged"}
    assert "not at its rows" in judged(e).verdicts[1].note


@pytest.mark.parametrize("method", ["lines", "cubic"])
def test_records_brought_to_another_rate_show_nothing(method: str) -> None:
    """Of 480 Hz on 1 kHz one row in twelve is on a line: of the others none is a sample, either."""
    for rate in (300.0, 360.0, 450.0, 480.0) if method == "lines" else (240.0, 250.0):
        times = np.arange(0.0, 60.1, 1.0 / rate)
        samples = white(300.0, len(times))
        spline = CubicSpline(times, samples)(TIME)
        e = np.column_stack([np.interp(TIME, times, axis) for axis in samples.T]) if method == "lines" else spline
        assert interpolated_rows(e).all(), rate
        assert {verdict.status for verdict in judged(e).verdicts} == {"not judged"}


@pytest.mark.parametrize("share", [0.001, 0.01, 0.05, 0.2])
def test_single_rows_that_were_filled_are_missing_alone(share: float) -> None:
    kept = np.random.default_rng(2).random(N) > share
    kept[[0, -1]] = True
    e = np.column_stack([np.interp(np.arange(N), np.flatnonzero(kept), axis) for axis in white(10.0)[kept].T])
    assert interpolated_rows(e).mean() == pytest.approx(share, rel=0.15)


@pytest.mark.parametrize("digits", [1, 3, 12])
@pytest.mark.parametrize("degrees", [0.1, 5.0, 20.0, 45.0])
def test_a_sensor_that_is_clipped_along_its_own_axes_is_saturated(degrees: float, digits: int) -> None:
    """Those of the line of sight are turned against them, so that no value of either comes twice."""
    turn = np.exp(1j * np.deg2rad(degrees))
    own = lfilter([1.0], [1.0, -0.5], white(28.0), axis=0)
    for limit in (30.0, 60.0):
        clipped = np.clip(own, -limit, limit) @ np.array([1.0, 1j]) * turn
        seen = np.round(np.column_stack([clipped.real, clipped.imag]), digits)
        rows = (np.abs(own) > limit).any(axis=1)
        assert saturated_rows(seen).mean() == pytest.approx(rows.mean(), abs=0.01)
    free = own @ np.array([1.0, 1j]) * turn
    assert not saturated_rows(np.round(np.column_stack([free.real, free.imag]), digits)).any()


@pytest.mark.parametrize("share", [0.002, 0.05, 0.3])
def test_rows_that_were_filled_with_a_value_are_missing(share: float) -> None:
    """One by one, all over the record, and where the motion is above the limit."""
    motion, rng = white(20.0), np.random.default_rng(3)
    for filled in (rng.random(N) < share, np.hypot(*motion.T) > np.quantile(np.hypot(*motion.T), 1.0 - share)):
        record = np.where(filled[:, None], 0.0, motion)
        assert np.array_equal(filled_rows(record), filled)
        verdict = judge_series(TIME, record, unit="mas", requirements=[APE.replace("1000", "60")]).verdicts[0]
        assert verdict.status != "compliant" and (share < 0.01 or "filled with one value" in verdict.note)
    assert not filled_rows(np.round(motion, 1)).any() and not filled_rows(np.round(tone(0.37, 900.0), 1)).any()


def low_pass(bandwidth: float, seed: int) -> FloatArray:
    """Noise (N, 2) of a bandwidth [Hz], sampled at 1 kHz."""
    from scipy.signal import butter, lfilter

    b, a = butter(2, bandwidth / 500.0)
    return np.asarray(lfilter(b, a, np.random.default_rng(seed).standard_normal((N, 2)), axis=0))


@pytest.mark.parametrize("bandwidth", [5.0, 20.0, 60.0, 150.0])
@pytest.mark.parametrize(("freezes", "rows"), [(1, 900), (1, 5000), (3, 300), (12, 100)])
def test_a_sensor_that_freezes_in_a_smooth_motion_is_stuck(bandwidth: float, freezes: int, rows: int) -> None:
    """It goes on from the last value without a jump, but not without one of the velocity, and leaves with a jump."""
    for seed in range(5):
        e = low_pass(bandwidth, seed)
        frozen = np.zeros(N, bool)
        for start in np.linspace(6000, N - 6000, freezes).astype(int):
            e[start : start + rows] = e[start]
            frozen[start + 1 : start + rows] = True
        assert stuck_rows(e).sum() == pytest.approx(frozen.sum(), rel=0.1), seed


def test_a_motion_between_positions_at_rest_is_not_stuck() -> None:
    """Slews of different lengths: an acceleration that is constant, and one that ends smoothly."""
    rng = np.random.default_rng(0)
    for profile in (lambda u: u**2 * (3.0 - 2.0 * u), lambda u: u**3 * (10.0 - 15.0 * u + 6.0 * u**2)):
        for _ in range(20):
            parts, position = list[FloatArray](), np.asarray(rng.standard_normal(2))
            for _ in range(int(rng.integers(2, 6))):
                target = np.asarray(rng.standard_normal(2))
                u = np.linspace(0.0, 1.0, int(rng.integers(50, 800)))
                parts.append(position + np.outer(profile(u), target - position))
                parts.append(np.tile(target, (int(rng.integers(10, 900)), 1)))
                position = target
            assert not stuck_rows(np.concatenate(parts)).any()
