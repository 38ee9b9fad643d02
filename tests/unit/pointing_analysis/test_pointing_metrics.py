"""Pointing indices of signals whose indices are known on paper."""

from __future__ import annotations

import numpy as np
import pytest
from support.slow_cases import slow

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
    with pytest.raises(BagError, match="stamps must be on a grid of 20 ms, got 5 intervals off it"):
        performance_error(Rig({"truth/los": camera}))


@pytest.mark.parametrize("hertz", [slow(3.0), 14.0, slow(60.0)])
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
