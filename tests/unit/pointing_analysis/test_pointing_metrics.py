"""Pointing indices of signals whose indices are known on paper."""

from __future__ import annotations

import numpy as np
import pytest

from pointing_analysis.indices import metrics, weights
from pointing_analysis.indices.errors import performance_error
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.read.topic import BagError, make_topic
from pointing_analysis.requirements.summary import summarise
from pointing_analysis.spectra import spectra

DT, WINDOW = 1e-3, 0.02
ARCSEC = np.pi / 648_000
MAS = ARCSEC / 1000


def tone(frequency: float, amplitude: float = 1.0, n: int = 200_000) -> np.ndarray:
    t = DT * np.arange(n)
    return np.column_stack([amplitude * np.sin(2 * np.pi * frequency * t + 0.3), np.zeros(n)])


@pytest.mark.parametrize("frequency", [1.3, 7.7, 10.1, 25.3, 42.3, 101.7, 333.1])
def test_tone_has_the_exact_discrete_weight(frequency: float) -> None:
    e = tone(frequency)
    expected = weights.rpe_discrete(2 * np.pi * frequency, 20, DT) / np.sqrt(2)
    assert metrics.rpe_rms(e, DT, WINDOW)[0] == pytest.approx(expected, rel=5e-3)
    assert metrics.rpe_rms(e, DT, WINDOW)[1] == 0


@pytest.mark.parametrize("frequency", [1.3, 10.1, 42.3])
def test_mean_and_rpe_share_the_power_of_a_tone(frequency: float) -> None:
    e = tone(frequency)
    w = metrics.windows(e, DT, WINDOW)
    total = np.square(w.mean[:, 0]).mean() + w.variance[:, 0].mean()
    assert total == pytest.approx(np.square(e[:, 0]).mean(), rel=1e-9)


def test_white_noise_keeps_the_share_one_minus_one_over_n() -> None:
    e = np.random.default_rng(0).standard_normal((400_000, 2)) * 3.0
    assert metrics.rpe_rms(e, DT, WINDOW) == pytest.approx(3.0 * np.sqrt(1 - 1 / 20), rel=5e-3)


def test_circular_motion_has_no_rpe_in_the_norm_and_all_of_it_in_the_vector(tmp_path) -> None:
    """The trap: whoever takes the norm first reports zero jitter for a smeared picture."""
    t = DT * np.arange(5000)
    circle = 100 * MAS * np.column_stack([np.cos(2 * np.pi * 50 * t), np.sin(2 * np.pi * 50 * t)])
    wrong = metrics.radial(circle)
    assert np.ptp(wrong) < 1e-12 * MAS * 100
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": circle}))
    figures = summarise(run)
    assert figures.rpe_rms == pytest.approx(100.0, rel=5e-3)
    assert figures.rpe_p997 == pytest.approx(100.0, rel=5e-3)
    assert figures.ape_max == pytest.approx(0.1, rel=5e-3)


def test_tone_and_noise_through_a_bag(tmp_path) -> None:
    rng = np.random.default_rng(3)
    n = 100_000
    e = tone(33.3, 50 * MAS, n) + 20 * MAS * rng.standard_normal((n, 2)) + 2 * ARCSEC
    figures = summarise(Run.open(write_bag(tmp_path / "bag", {"truth/los": e})), transient=0.0)
    white = 20 * np.sqrt(1 - 1 / 20)
    line = 50 / np.sqrt(2) * weights.rpe_discrete(2 * np.pi * 33.3, 20, DT)
    assert figures.rpe_axis == pytest.approx((np.hypot(white, line), white), rel=5e-3)
    assert figures.rpe_rms == pytest.approx(np.sqrt(2 * white**2 + line**2), rel=5e-3)
    assert figures.windows == 5000


def test_instant_estimator_positions() -> None:
    e = np.random.default_rng(1).standard_normal((1000, 2))
    for position, at in (("centred", 10), ("end", 19)):
        got = metrics.rpe_instant(e, DT, WINDOW, position)
        expected = np.array([e[k + at] - e[k : k + 20].mean(axis=0) for k in range(981)])
        assert np.allclose(got, expected, atol=1e-12)
    every = metrics.rpe_instant(e, DT, WINDOW)
    assert metrics.rms(every) == pytest.approx(metrics.rpe_rms(e, DT, WINDOW), rel=1e-12)


def test_end_of_window_sees_slow_motion_larger_by_root_three() -> None:
    """At the end of the window slow motion is about N/2 samples from its mean, over the window N/sqrt(12) rms."""
    e = tone(0.2, n=100_000)
    end = metrics.rms(metrics.rpe_instant(e, DT, WINDOW, "end"))[0]
    spread = metrics.rms(metrics.rpe_instant(e, DT, WINDOW, "all"))[0]
    exact = (20 - 1) / 2 / np.sqrt((20**2 - 1) / 12)
    assert end / spread == pytest.approx(exact, rel=5e-3)
    assert exact == pytest.approx(np.sqrt(3), rel=0.06)


def test_centre_of_the_window_hides_slow_motion(tmp_path) -> None:
    """A slow circle: fixed to the centre of the window the largest error would lie below the rms; ours does not."""
    t = DT * np.arange(20_000)
    circle = MAS * 150 * np.column_stack([np.sin(88 * t), np.cos(88 * t)])
    rms = np.hypot(*metrics.rpe_rms(circle, DT, WINDOW))
    centred = metrics.radial(metrics.rpe_instant(circle, DT, WINDOW, "centred")).max()
    assert centred < 0.3 * rms
    figures = summarise(Run.open(write_bag(tmp_path / "bag", {"truth/los": circle})))
    assert figures.rpe_rms == pytest.approx(150 * weights.rpe_discrete(88.0, 20, DT), rel=5e-3)
    # At the ends of the exposure the circle is farthest from its mean: about sqrt(3) of the rms for slow motion.
    assert 1.4 < figures.rpe_p997 / figures.rpe_rms < np.sqrt(3)


def test_windows_with_missing_samples_are_skipped_and_counted() -> None:
    e = np.random.default_rng(1).standard_normal((1000, 2))
    holed = e.copy()
    holed[[105, 106, 130]] = np.nan
    w, full = metrics.windows(holed, DT, WINDOW), metrics.windows(e, DT, WINDOW)
    assert (w.skipped, len(w.mean)) == (2, 48)
    keep = [i for i in range(50) if i not in (5, 6)]
    assert np.array_equal(w.mean, full.mean[keep])
    assert np.array_equal(w.start, 20 * np.array(keep))
    instant, complete = (metrics.rpe_instant(x, DT, WINDOW, "centred") for x in (holed, e))
    touched = np.zeros(len(instant), bool)
    for hole in (105, 106, 130):
        touched[hole - 19 : hole + 1] = True
    assert np.array_equal(np.isnan(instant[:, 0]), touched)
    assert np.allclose(instant[~touched], complete[~touched], atol=1e-12)


def test_offset_does_not_cost_the_jitter_its_digits() -> None:
    jitter = 1e-9 * np.random.default_rng(0).standard_normal((2000, 2))
    shifted = metrics.rpe_rms(jitter + 1.0, DT, WINDOW)
    assert shifted == pytest.approx(metrics.rpe_rms(jitter, DT, WINDOW), rel=1e-5)
    for position in ("all", "centred"):
        instant = metrics.rpe_instant(jitter + 1.0, DT, WINDOW, position)
        assert np.allclose(instant, metrics.rpe_instant(jitter, DT, WINDOW, position), atol=1e-14)


def test_drift_of_a_steady_motion_is_rate_times_separation() -> None:
    e = np.column_stack([2.0 * DT * np.arange(5000), np.zeros(5000)])
    assert metrics.pde(e, DT, 0.02, 1.0) == pytest.approx(
        np.tile([2.0, 0.0], (200, 1))[: len(metrics.pde(e, DT, 0.02, 1.0))]
    )


@pytest.mark.parametrize("frequency", [0.3, 2.2, 9.1])
def test_drift_of_a_tone(frequency: float) -> None:
    drift = metrics.rms(metrics.pde(tone(frequency), DT, 0.02, 0.1))[0]
    window_mean, difference = np.sinc(frequency * 0.02), 2 * abs(np.sin(np.pi * frequency * 0.1))
    expected = window_mean * difference / np.sqrt(2)
    assert drift == pytest.approx(expected, rel=5e-3)


def test_reproducibility_of_two_observations() -> None:
    rng = np.random.default_rng(0)
    a, b = 0.1 * rng.standard_normal((4000, 2)), 0.1 * rng.standard_normal((4000, 2)) + [3.0, -1.0]
    assert metrics.pre(a, b, DT, 0.2).mean(axis=0) == pytest.approx([3.0, -1.0], abs=0.02)
    assert metrics.pre(a, b, DT, 0.2).shape == (400, 2)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda e: metrics.windows(e, DT, 2.0), "at least as long as the window"),
        (lambda e: metrics.windows(e, DT, 0.0019), "two samples"),
        (lambda e: metrics.windows(e, DT, 0.0), "two samples"),
        (lambda e: metrics.windows(e, 0.0, 0.02), "two samples"),
        (lambda e: metrics.windows(e[:, 0], DT, 0.02), r"shape \(n, 2\)"),
        (lambda e: metrics.rpe_instant(e, DT, 0.02, "start"), "position"),
        (lambda e: metrics.pde(e, DT, 0.02, 2.0), r"window \+ separation"),
    ],
)
def test_bad_input(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call(np.zeros((1000, 2)))


def test_transient_is_dropped_explicitly(tmp_path) -> None:
    los = np.zeros((3000, 2))
    los[:500] = 1.0
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": los}, parameters={"transient_s": 0.5}))
    assert np.all(performance_error(run).values == 0)
    assert performance_error(run).start == 0.5
    assert performance_error(run, transient=0.0).values[0, 0] == 1.0
    with pytest.raises(ValueError, match="longer than its start-up transient"):
        performance_error(run, transient=3.0)
    with pytest.raises(ValueError, match="transient must be zero or more"):
        performance_error(run, transient=-1.0)


class Rig(dict):
    """A recording of a device that has no true line of sight."""

    path, parameters = "rig", {"device": "my:Rig", "transient_s": 0.0}


def test_frames_of_a_device_that_are_off_phase_stand_at_the_nearest_time_of_the_grid() -> None:
    stamp = 10**18 + 20_000_000 * np.arange(150)
    stamp[[40, 80, 81]] += [7_000_000, -6_000_000, 5_000_000]
    rows = np.delete(np.arange(150), [20, 21])
    values = np.column_stack([np.arange(150.0), np.zeros(150)])
    columns = ("x", "y")
    camera = make_topic("camera/los", "Vector3Stamped", "rad", columns, stamp[rows], values[rows], stamp[rows])
    found = performance_error(Rig({"camera/los": camera}))
    assert (found.dt, found.missing, len(found.values)) == (0.02, 2, 150 - round(found.start / 0.02))
    kept = found.values[np.isfinite(found.values[:, 0]), 0]
    assert np.array_equal(kept, values[rows][rows * 0.02 >= found.start - 1e-9, 0])
    with pytest.raises(BagError, match="stamps must be on a grid of 20 ms, got 5 intervals off it"):
        performance_error(Rig({"truth/los": camera}))


@pytest.mark.parametrize(("seconds", "dropped"), [(60, 5.0), (10, 5.0), (7, 3.5), (2, 1.0)])
def test_default_transient_is_the_settling_of_the_observer_where_the_run_is_long_enough(
    tmp_path, seconds, dropped
) -> None:
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": np.ones((1000 * seconds, 2))}))
    found = summarise(run)
    assert found.transient == dropped
    assert any("start-up" in p for p in found.problems) == (dropped < 5.0)
    assert not any("start-up" in p for p in summarise(run, transient=0.5).problems)


@pytest.mark.parametrize("hertz", [3.0, 14.0, 60.0])
def test_the_quantile_in_the_table_never_hides_a_tone(tmp_path, hertz) -> None:
    """A tone's 99.7 % quantile lies above its rms; with t at the centre of its window it would not."""
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": tone(hertz, 1e-6, 20_000)}))
    found = summarise(run)
    weight = weights.rpe_discrete(2 * np.pi * hertz, 20, DT)
    e = performance_error(run).values
    assert found.rpe_rms * MAS == pytest.approx(np.hypot(*metrics.rms(e)) * weight, rel=1e-2)
    assert found.rpe_p997 > found.rpe_rms
    centred = metrics.radial(metrics.rpe_instant(e, DT, 0.02, "centred"))
    if hertz < 5:
        assert np.quantile(centred, 0.997) < 0.4 * found.rpe_rms * MAS


def test_spectrum_keeps_the_power_and_shows_the_tone() -> None:
    e = tone(50.0, 2.0, 40_000) + 0.1 * np.random.default_rng(0).standard_normal((40_000, 2))
    s = spectra.psd(e, DT, segment=2.0)
    assert s.cumulative_rms()[-1] == pytest.approx(np.hypot(*metrics.rms(e)), rel=5e-3)
    assert s.frequency[s.density[:, 0].argmax()] == pytest.approx(50.0)
    below = s.cumulative_rms()[s.frequency < 45][-1]
    assert below < 0.1
    weighted = s.cumulative_rms(weights.rpe_discrete(2 * np.pi * s.frequency, 20, DT))[-1]
    assert weighted == pytest.approx(np.hypot(*metrics.rpe_rms(e, DT, WINDOW)), rel=5e-3)


def test_offset_stays_in_the_spectrum() -> None:
    s = spectra.psd(np.full((10_000, 2), 3.0), DT, segment=1.0)
    assert s.cumulative_rms()[-1] == pytest.approx(3.0 * np.sqrt(2), rel=1e-9)


@pytest.mark.parametrize("n", [64, 65])
def test_spectrum_of_even_and_odd_segments(n: int) -> None:
    e = np.random.default_rng(n).standard_normal((n * 400, 2))
    assert spectra.psd(e, DT, segment=n * DT).cumulative_rms()[-1] == pytest.approx(np.sqrt(2), rel=0.01)


def test_spectrum_skips_segments_with_holes() -> None:
    e = np.random.default_rng(0).standard_normal((10_000, 2))
    e[5000] = np.nan
    s = spectra.psd(e, DT, segment=1.0)
    assert (s.segments, s.skipped) == (17, 2)
    with pytest.raises(ValueError, match=r"segment of 0\.9 s without missing samples"):
        spectra.psd(e[4500:5400], DT, segment=1.0)
    with pytest.raises(ValueError, match="8 samples"):
        spectra.psd(e[:5], DT)


def test_lines_give_amplitude_and_share_of_the_rpe() -> None:
    t = DT * np.arange(20_000)
    x = 3 * np.sin(88 * t + 1) + 2 * np.cos(210 * t) + 0.5
    y = 1.5 * np.cos(88 * t)
    e = np.column_stack([x, y]) + 0.01 * np.random.default_rng(0).standard_normal((20_000, 2))
    found = {round(line.omega): line for line in spectra.lines(e, DT, [88, 210, 400, 1e5, 0.01], WINDOW)}
    assert set(found) == {88, 210, 400}
    assert found[88].amplitude == pytest.approx([3, 1.5], rel=2e-3)
    assert found[210].amplitude == pytest.approx([2, 0], abs=2e-3)
    expected = np.hypot(3, 1.5) / np.sqrt(2) * weights.rpe_discrete(88.0, 20, DT)
    assert found[88].rpe == pytest.approx(expected, rel=2e-3)
    total = np.sqrt(sum(line.rpe**2 for line in found.values()))
    assert total == pytest.approx(np.hypot(*metrics.rpe_rms(e, DT, WINDOW)), rel=5e-3)


def test_lines_that_cannot_be_told_apart_are_fitted_as_one() -> None:
    e = tone(20.0, n=1000)
    found = spectra.lines(e, DT, 2 * np.pi * np.array([20.0, 20.3]), WINDOW)
    assert [line.merged for line in found] == [2]
    assert len(spectra.lines(tone(20.0, n=10_000), DT, 2 * np.pi * np.array([20.0, 20.3]), WINDOW)) == 2
