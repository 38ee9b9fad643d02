"""Indices against their definitions written out and signals known on paper; spectral weights, spectra, lines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.slow_cases import slow

from pointing_analysis.indices import metrics, weights, window_rows
from pointing_analysis.indices.errors import RAD_PER_MAS, performance_error
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.indices.weights import rpe_discrete, rpe_exact
from pointing_analysis.read.run import Run
from pointing_analysis.read.series import series as recorded
from pointing_analysis.read.topic import BagError, make_topic
from pointing_analysis.requirements.summary import summarise
from pointing_analysis.spectra import spectra
from titop_plant.telescope.weights import relative_error_weight, rpe_weight

DT = 1e-3


@pytest.fixture(params=[metrics.PART, 60, 7])
def series(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Error with two missing samples; parts of the whole, of some windows, of less than one."""
    monkeypatch.setattr(metrics, "PART", request.param)
    e = np.random.default_rng(3).standard_normal((137, 2))
    e[[45, 90]] = np.nan
    return e


def by_hand(e: Any, n: int) -> list[tuple[int, Any]]:
    """Disjoint windows of n samples that are whole, with their first sample."""
    found = [(i, e[i : i + n]) for i in range(0, len(e) - n + 1, n)]
    return [(i, part) for i, part in found if np.isfinite(part).all()]


@pytest.mark.parametrize("n", [2, 10, 20, 137])
def test_windows(series: Any, n: int) -> None:
    found, parts = metrics.windows(series, DT, n * DT), by_hand(series, n)
    assert (found.samples, found.skipped) == (n, 137 // n - len(parts))
    assert found.start.tolist() == [i for i, _ in parts]
    if not parts:
        assert found.mean.shape == (0, 2) and np.isnan(found.rpe_rms).all() and found.rpe_rms.shape == (2,)
        return
    mean, variance = (np.array([f(part, axis=0) for _, part in parts]) for f in (np.mean, np.var))
    assert np.allclose(found.mean, mean, atol=1e-13) and np.allclose(found.variance, variance, atol=1e-13)
    assert np.allclose(found.rpe_rms, np.sqrt(variance.mean(axis=0)))
    assert np.array_equal(metrics.mpe(series, DT, n * DT), found.mean)
    assert np.array_equal(metrics.rpe_rms(series, DT, n * DT), found.rpe_rms)


@pytest.mark.parametrize("n", [2, 10, 20])
def test_instants_of_the_rpe(series: Any, n: int) -> None:
    found = metrics.rpe_instant(series, DT, n * DT)
    assert found.shape == (137 // n * n, 2)
    for i in range(137 // n):
        part = series[i * n : (i + 1) * n]
        assert np.allclose(found[i * n : (i + 1) * n], part - part.mean(axis=0), equal_nan=True, atol=1e-13)
    for position, at in (("centred", n // 2), ("end", n - 1)):
        sliding = metrics.rpe_instant(series, DT, n * DT, position)  # type: ignore[arg-type]
        expected = [series[k + at] - series[k : k + n].mean(axis=0) for k in range(137 - n + 1)]
        assert np.allclose(sliding, expected, equal_nan=True, atol=1e-12)
    with pytest.raises(ValueError, match="position must be 'all', 'centred' or 'end', got 'start'"):
        metrics.rpe_instant(series, DT, n * DT, "start")  # type: ignore[arg-type]


def test_nothing_but_missing_samples() -> None:
    blank = np.full((30, 2), np.nan)
    assert np.isnan(metrics.rpe_instant(blank, DT, 0.01, "end")).all()
    assert metrics.windows(blank, DT, 0.01).skipped == 3


def test_a_sliding_mean_keeps_its_digits_beside_a_large_offset() -> None:
    e = 1e-9 * np.random.default_rng(1).standard_normal((300, 2))
    near, far = (metrics.rpe_instant(x, DT, 0.02, "end") for x in (e, e + 1.0))
    assert np.allclose(near, far, atol=1e-15)


@pytest.mark.parametrize(("n", "lag"), [(2, 2), (10, 25), (20, 117), (5, 3)])
def test_drift(series: Any, n: int, lag: int) -> None:
    pairs = [(series[i : i + n], series[i + lag : i + lag + n]) for i in range(0, 137 - n - lag + 1, n)]
    expected = np.array([b.mean(axis=0) - a.mean(axis=0) for a, b in pairs])
    assert np.allclose(metrics.pde(series, DT, n * DT, lag * DT), expected, atol=1e-12, equal_nan=True)


def test_drift_of_a_run_that_just_fits() -> None:
    e = np.arange(60.0).reshape(30, 2)
    assert metrics.pde(e, DT, 0.01, 0.02).tolist() == [[40.0, 40.0]]
    with pytest.raises(ValueError, match=r"window \+ separation = 0.031 s or more, got 0.03 s"):
        metrics.pde(e, DT, 0.01, 0.021)


def test_reproducibility() -> None:
    rng = np.random.default_rng(4)
    a, b = rng.standard_normal((100, 2)), rng.standard_normal((60, 2))
    first, second = ([x[i : i + 10].mean(axis=0) for i in range(0, len(x), 10)] for x in (a, b))
    expected = [y - x for x in first for y in second]
    means = [metrics.mpe(e, DT, 0.01) for e in (a, b)]
    assert np.allclose(metrics.pre(means[0], means[1]), expected)
    few = metrics.pre(means[0], means[1], max_windows=3)
    assert np.allclose(few, [second[j] - first[i] for i in (0, 4, 9) for j in (0, 2, 5)])
    assert metrics.pre(metrics.mpe(np.full((100, 2), np.nan), DT, 0.01), means[1]).shape == (0, 2)


@pytest.mark.parametrize(
    ("dt", "whole", "others"),
    [
        (DT, [0.02, 0.002, 0.0200009, 0.0199991], [0.001, 0.0, -0.02, 0.0200011, 0.0199989, np.inf, np.nan]),
        *[(1 / 512, [], [0.02]), (0.0, [], [0.02]), (-DT, [], [0.02, -0.02])],
        *[(1.0, [2.0], []), (0.5, [1.5], []), (0.125, [0.25], [])],
    ],
)
def test_a_window_is_a_whole_number_of_samples(dt: float, whole: list[float], others: list[float]) -> None:
    for window in whole:
        assert metrics.is_whole(window, dt) is True and metrics.window_samples(window, dt) == round(window / dt)
    for window in others:
        assert metrics.is_whole(window, dt) is False
        with pytest.raises(ValueError, match="window must be a whole number"):
            metrics.window_samples(window, dt)


@pytest.mark.parametrize("rate", [3000, 6000, 7000, 12_000, 44_100, 48_000, 96_000])
@pytest.mark.parametrize("window", [0.02, 0.1, 0.5, 1.0, 10.0])
def test_a_period_of_whole_nanoseconds_is_that_of_its_rate(rate: int, window: float) -> None:
    """The window in the samples of the true rate, and no window half a sample longer."""
    dt = round(1e9 / rate) / 1e9
    assert metrics.is_whole(window, dt)
    assert metrics.window_samples(window, dt) == pytest.approx(window * rate, abs=0.5 + 0.5e-9 * window * rate**2)
    if window * rate**2 * 0.5e-9 < 0.2:
        assert not metrics.is_whole(window + 0.5 / rate, dt)


TIMES = 25
"""Windows of 20 ms at 512 Hz have 256 samples of a record in which each sample stands 25 times."""


@pytest.fixture(params=[metrics.PART, 60])
def both(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A record at 512 Hz with two missing samples, the same with each sample 25 times, and their periods."""
    monkeypatch.setattr(window_rows, "PART", request.param)
    e = np.random.default_rng(4).standard_normal((300, 2)) + 1e3
    e[[45, 190]] = np.nan
    return e, np.repeat(e, TIMES, axis=0), 1 / 512, 1 / 512 / TIMES


def test_windows_that_are_no_whole_number_of_samples(both: Any) -> None:
    """Each sample stands for its period: the same as of a record with 25 samples in each period."""
    e, fine, dt, fine_dt = both
    found, expected = metrics.windows(e, dt, 0.02), metrics.windows(fine, fine_dt, 0.02)
    assert found.samples == pytest.approx(10.24, abs=1e-12) and expected.samples == 256
    assert found.skipped == expected.skipped == 2 and len(found.mean) == 27
    assert np.allclose(found.mean, expected.mean, rtol=1e-14) and np.allclose(found.variance, expected.variance)
    assert found.start.tolist() == (expected.start // TIMES).tolist()
    drifts = metrics.pde(e, dt, 0.02, 0.05), metrics.pde(fine, fine_dt, 0.02, 0.05)
    assert np.allclose(*drifts, atol=1e-10, equal_nan=True)
    assert np.array_equal(metrics.mpe(e, dt, 0.02), found.mean)


def test_instants_of_windows_that_are_no_whole_number_of_samples(both: Any) -> None:
    """A sample belongs to the window that holds the middle of its period; sliding windows are by the definition."""
    e, fine, dt, fine_dt = both
    found, middle = metrics.rpe_instant(e, dt, 0.02), metrics.rpe_instant(fine, fine_dt, 0.02)[TIMES // 2 :: TIMES]
    assert len(found) == len(middle) == 297  # 29 windows of 10.24 samples
    assert np.allclose(found, middle, atol=1e-10, equal_nan=True)
    end = metrics.rpe_instant(e, dt, 0.02, "end")
    expected = [e[k] - fine[TIMES * (k + 1) - 256 : TIMES * (k + 1)].mean(axis=0) for k in range(10, 300)]
    assert np.allclose(end, expected, atol=1e-9, equal_nan=True)
    finer = np.repeat(fine, 2, axis=0)
    centred = metrics.rpe_instant(e, dt, 0.02, "centred")
    around = [(2 * TIMES * k + TIMES - 256, 2 * TIMES * k + TIMES + 256) for k in range(300)]
    expected = [e[k] - finer[a:b].mean(axis=0) for k, (a, b) in enumerate(around) if a >= 0 and b <= len(finer)]
    assert len(centred) == len(expected) and np.allclose(centred, expected, atol=1e-9, equal_nan=True)


@pytest.mark.parametrize("rate", [512, 3000, 777.7, *map(slow, (1024, 2048, 25_600, 48_000, 51_200))])
def test_a_rate_alone_gives_sample_numbers_and_an_rpe(rate: float) -> None:
    """Stamps of a rounded period were moved to the grid of the rate, and samples left out, without a loss told."""
    n, hertz = round(6 * rate), 33.3
    t = np.arange(n) / rate
    run = recorded(None, 1e-6 * np.c_[np.sin(2 * np.pi * hertz * t), np.zeros(n)], unit="rad", rate=rate)
    assert not run.problems and len(run.topic) == n and run.topic.integrity.irregular == 0
    assert run.topic.period * rate == pytest.approx(1, abs=1e-12)
    error = performance_error(run, 0.0)
    assert len(error.values) == n and not error.missing
    found = summarise(run, transient=0.0)
    weight = rpe_discrete(2 * np.pi * hertz, metrics.samples_in(0.02, 1 / rate), 1 / rate)
    amplitude = 1e-6 * weight / np.sqrt(2) / RAD_PER_MAS
    assert found.rpe_rms == pytest.approx(amplitude, rel=2e-3)
    assert found.problems == ("y has the same value in all samples",)
    assert weight == pytest.approx(rpe_exact(2 * np.pi * hertz, 0.02), rel=2e-3)


@pytest.mark.parametrize("rate", [3000, 25_600, 48_000])
def test_times_at_such_rates_are_not_moved(rate: int) -> None:
    t = np.round(np.arange(5 * rate) / rate, 9)
    for given in (None, float(rate)):
        run = recorded(t, np.ones((t.size, 2)), unit="mas", rate=given)
        assert not run.problems and len(run.topic) == t.size and not run.topic.integrity.missing
        assert 1 / run.topic.period == pytest.approx(rate, rel=1e-12)


def test_shapes_and_lengths_that_are_refused() -> None:
    for shape in ((30,), (30, 3), (2, 30, 2), (30, 1)):
        with pytest.raises(ValueError, match=r"error must have the shape \(n, 2\), got"):
            metrics.radial(np.zeros(shape))
    assert metrics.windows(np.zeros((20, 2)), DT, 0.02).samples == 20
    with pytest.raises(ValueError, match=r"as long as the window of 0\.02 s, got 0\.019 s"):
        metrics.windows(np.zeros((19, 2)), DT, 0.02)


def test_radial_and_rms() -> None:
    e = np.array([[3.0, 4.0], [np.nan, 1.0], [-6.0, 8.0], [0.0, np.nan]])
    assert metrics.radial(e)[[0, 2]].tolist() == [5.0, 10.0] and np.isnan(metrics.radial(e)[[1, 3]]).all()
    assert metrics.rms(e) == pytest.approx([np.sqrt(45 / 3), np.sqrt(81 / 3)])


WINDOW = 0.02


@pytest.mark.parametrize(("hertz", "exact"), [(1, 0.036266), (10, 0.353355), (25, 0.771178), (50, 1.0), (100, 1.0)])
def test_values_for_twenty_milliseconds(hertz: float, exact: float) -> None:
    assert weights.rpe_exact(2 * np.pi * hertz, WINDOW) == pytest.approx(exact, abs=6e-7)


def test_the_rational_weight_of_the_synthesis_is_no_upper_bound() -> None:
    """Its system and its magnitude agree, and the exact weight is up to 4.5 % larger, near 42 Hz."""
    omega = 2 * np.pi * np.arange(1.0, 100.0, 0.25)
    rational = rpe_weight(omega, WINDOW)
    system = relative_error_weight(WINDOW, 1).nominal()
    np.testing.assert_allclose([abs(complex(system(1j * w))) for w in omega], rational, rtol=1e-12)
    ratio = weights.rpe_exact(omega, WINDOW) / rational
    assert ratio.max() == pytest.approx(1.045, abs=5e-4)
    assert omega[ratio.argmax()] / (2 * np.pi) == pytest.approx(42, abs=1)


def test_mean_and_rpe_weights_are_complementary_and_keep_their_digits_at_low_frequency() -> None:
    omega, low = np.geomspace(1e-6, 1e5, 400), np.geomspace(1e-9, 0.2, 50)
    total = np.sinc(omega * WINDOW / (2 * np.pi)) ** 2 + weights.rpe_exact(omega, WINDOW) ** 2
    assert np.allclose(total, 1, atol=1e-12)
    assert np.allclose(weights.rpe_exact(low, WINDOW), low * WINDOW / np.sqrt(12), rtol=1e-6)


def test_discrete_weight_tends_to_the_continuous_one() -> None:
    omega = np.geomspace(1, 1000, 50)
    coarse = np.abs(weights.rpe_discrete(omega, 20, 1e-3) - weights.rpe_exact(omega, WINDOW)).max()
    fine = np.abs(weights.rpe_discrete(omega, 2000, 1e-5) - weights.rpe_exact(omega, WINDOW)).max()
    assert fine < 1e-3 * coarse
    assert weights.rpe_discrete(0.0, 20, 1e-3) == 0


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


def test_circular_motion_has_no_rpe_in_the_norm_and_all_of_it_in_the_vector(tmp_path) -> None:
    """The trap: whoever takes the norm first reports zero jitter for a smeared picture."""
    t = DT * np.arange(5000)
    circle = 100 * MAS * np.column_stack([np.cos(2 * np.pi * 50 * t), np.sin(2 * np.pi * 50 * t)])
    wrong = metrics.radial(circle)
    assert np.ptp(wrong) < 1e-12 * MAS * 100
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": circle}))
    figures = summarise(run)
    assert figures.rpe_rms == pytest.approx(100.0, rel=5e-3)
    assert figures.rpe_quantile == pytest.approx(100.0, rel=5e-3)
    assert figures.ape_max == pytest.approx(0.1, rel=5e-3)


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

    def shown(self, name):
        return name


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
    with pytest.raises(BagError, match=r"stamps must be on a grid of 20 ms \(50 Hz\), got 5 intervals off it"):
        performance_error(Rig({"truth/los": camera}))


@pytest.mark.parametrize("hertz", [slow(3.0), 14.0, slow(60.0)])
def test_the_quantile_in_the_table_never_hides_a_tone(tmp_path, hertz) -> None:
    """A tone's 99.7 % quantile lies above its rms; with t at the centre of its window it would not."""
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": tone(hertz, 1e-6, 20_000)}))
    found = summarise(run)
    weight = weights.rpe_discrete(2 * np.pi * hertz, 20, DT)
    e = performance_error(run).values
    assert found.rpe_rms * MAS == pytest.approx(np.hypot(*metrics.rms(e)) * weight, rel=1e-2)
    assert found.rpe_quantile > found.rpe_rms
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
