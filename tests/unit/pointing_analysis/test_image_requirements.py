"""Requirements on the image of a star: their text, and verdicts with the same statistics as on pointing errors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from lftkit.errors import InputError
from pointing_analysis.image.motion_blur import exposures, worst_transfer
from pointing_analysis.image.optics import NONE_KNOWN, with_optics
from pointing_analysis.image.quality import figures
from pointing_analysis.indices.errors import ErrorSeries
from pointing_analysis.read.series import Series, series
from pointing_analysis.requirements.requirement import entries, from_entries, parse
from pointing_analysis.requirements.rows import BRIEF, RequirementRow, overall, requirement_table
from pointing_analysis.requirements.verdict import Verdict, decide, index_samples, judge
from pointing_analysis.units import RAD_PER_MAS

TABLE = {"aperture_diameter": 1.5, "obscuration": 0.3, "wavelength": 550e-9, "pixel_mas": 38.0}
TAIL = ">= 0.997 at 95 % confidence"


def run_of(los_mas: Any, optics: Any = TABLE, name: str = "bench") -> Any:
    found = series(None, los_mas, unit="mas", rate=1000.0, name=name)
    return found if optics is None else with_optics(found, optics)


def noise(samples: int, sigma: float = 3.0, seed: int = 0) -> Any:
    return sigma * np.random.default_rng(seed).standard_normal((samples, 2))


def judged(text: str, *runs: Series) -> Verdict:
    return judge(parse(text), runs, 0.0)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("prob(MTF(20 ms, Nyquist) > 0.90) >= 0.997 at 95 % confidence", "MTF(20 ms, Nyquist)"),
        ("prob( mtf ( 20 ms , 0.5 nyquist ) >= .9 ) >= 99.7 % at 95 % confidence", "MTF(20 ms, 0.5 Nyquist)"),
        ("prob(MTF(1 s, 8 cycles/arcsec) > 1e-3) >= 0.5 at 95 % confidence, mixed", "MTF(1 s, 8 cycles/arcsec)"),
        ("prob(Strehl(20 ms) > 0.8) >= 0.997 at 95 % confidence", "Strehl(20 ms)"),
        ("prob(EE80(20 ms) < 140 mas) >= 0.997 at 95 % confidence, ensemble", "EE80(20 ms)"),
        ("prob(ee50(20 ms) < 0.3 urad) >= 0.997 at 95 % confidence", "EE50(20 ms)"),
        ("prob(ELLIPTICITY(20 ms) < 0.02) >= 0.997 at 95 % confidence", "ellipticity(20 ms)"),
    ],
)
def test_text_form(text: str, shown: str) -> None:
    r = parse(text)
    assert r.quantity == shown and r.of_image and r.lower == (">" in text.split(")")[1])
    assert parse(str(r)) == r and parse(r.exact_text, r.name) == r
    assert from_entries(entries([r]), "list") == (r,)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("prob(MTF(20 ms, Nyquist) < 0.9) ", r"MTF must have a lower limit \(>\), got '<'"),
        ("prob(EE80(20 ms) > 90 mas) ", r"EE80 must have an upper limit \(<\), got '>'"),
        ("prob(|RPE(20 ms)| > 90 mas) ", r"RPE must have an upper limit \(<\), got '>'"),
        ("prob(MTF(20 ms, Nyquist) > 0.9 mas) ", "MTF must have a limit without a unit, got mas"),
        ("prob(EE80(20 ms) < 90) ", "EE80 must have a limit in one of mas, .*, got none"),
        ("prob(MTF(20 ms) > 0.9) ", "MTF must have a spatial frequency, as in"),
        ("prob(MTF(20 ms, 8 cycles/pixel) > 0.9) ", "unit of a spatial frequency must be one of mas, .*, got 'pixel'"),
        ("prob(MTF(Nyquist) > 0.9) ", r"MTF\(...\) must have 1 time, got 0"),
        ("prob(Strehl(20 ms, 1 s) > 0.9) ", r"Strehl\(...\) must have 1 time, got 2"),
        ("prob(|Strehl(20 ms)| > 0.9) ", "Strehl must be given without"),
        ("prob(MTF(20 ms, Nyquist) > 1.0) ", r"limit of MTF must be below 1, got 1\.0"),
        ("prob(MTF(20 ms, Nyquist) > 0) ", "limit must be positive, got 0"),
        ("prob(EE85(20 ms) < 40 mas) ", "index must be one of APE.*got 'EE85'"),
    ],
)
def test_text_that_cannot_be_understood(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as raised:
        parse(text + TAIL)
    assert "\n" not in str(raised.value)


def test_samples_are_those_of_the_exposures() -> None:
    """Each index of every exposure, those with a missing sample counted."""
    los = np.cumsum(noise(2001, 2.0), axis=0)
    run = run_of(los)
    from pointing_analysis.image.optics import optics_of

    optics = optics_of(run)
    error = ErrorSeries(los * RAD_PER_MAS, 1e-3, 0.0, 0)
    paths = exposures(error.values, 1e-3, 0.02)
    assert optics is not None and len(paths) == 100
    star = figures(paths, optics, ("strehl", "ee50", "ee80", "ellipticity"))
    expected = {
        "MTF(20 ms, 0.7 Nyquist) > 0.5": worst_transfer(paths, 0.7 * optics.nyquist)[0],
        "MTF(20 ms, 5 cycles/arcsec) > 0.5": worst_transfer(paths, 5 / (1000 * RAD_PER_MAS))[0],
        "Strehl(20 ms) > 0.5": star["strehl"],
        "EE50(20 ms) < 50 mas": star["ee50"],
        "EE80(20 ms) < 50 mas": star["ee80"],
        "ellipticity(20 ms) < 0.5": star["ellipticity"],
    }
    for text, values in expected.items():
        found, cap, missing = index_samples(error, parse(f"prob({text}) {TAIL}"), optics)
        assert np.array_equal(found, values) and math.isinf(cap) and missing == 0.0
    holes = los.copy()
    holes[[45, 100]] = np.nan  # the second is the end of one exposure and the start of the next
    gaps = ErrorSeries(holes * RAD_PER_MAS, 1e-3, 0.0, 2)
    found, _, missing = index_samples(gaps, parse(f"prob(Strehl(20 ms) > 0.5) {TAIL}"), optics)
    assert missing == 3.0 and np.allclose(found, np.delete(star["strehl"], [2, 4, 5]))
    with pytest.raises(ValueError, match=r"no optics are known for this recording \(give --optics FILE\)"):
        index_samples(error, parse(f"prob(Strehl(20 ms) > 0.5) {TAIL}"))


def test_a_lower_limit_is_judged_as_an_upper_one_of_the_negative() -> None:
    """Same counts, same status, bounds mirrored."""
    values = np.random.default_rng(1).uniform(0.2, 1.0, 2000)
    below = parse("prob(Strehl(20 ms) > 0.25) >= 0.9 at 95 % confidence")
    above = parse("prob(ellipticity(20 ms) < 0.75) >= 0.9 at 95 % confidence")
    for effective in (20.0, 500.0, 2000.0):
        for missing in (0.0, 5.0, math.inf):
            low = decide(below, values, effective, 10.0, missing)
            high = decide(above, 1.0 - values, effective, 10.0, missing)
            assert (low.status, low.exceeding, low.within_limit, low.note) == (
                high.status,
                high.exceeding,
                high.within_limit,
                high.note,
            )
            assert low.seconds_needed == high.seconds_needed
            assert low.quantile.value == pytest.approx(1.0 - high.quantile.value)
            assert low.quantile.lower == pytest.approx(1.0 - high.quantile.upper)
            assert low.quantile.upper == pytest.approx(1.0 - high.quantile.lower)
    assert decide(below, np.full(100, 0.25), 100.0, 1.0).exceeding == 1.0, "the limit itself is not above it"


def test_verdicts_in_the_table() -> None:
    run = run_of(noise(25_001))
    good = judged(f"prob(MTF(20 ms, Nyquist) > 0.90) {TAIL}", run)
    bad = judged(f"prob(MTF(20 ms, Nyquist) > 0.97) {TAIL}", run)
    assert (good.status, bad.status) == ("compliant", "not compliant")
    assert good.samples == 1250 and good.quantile.lower < good.quantile.value < 0.97
    row = RequirementRow.of(good)
    assert row.quantity == "MTF(20 ms, Nyquist), 99.7 %"
    assert row.value_text == f"{good.quantile.value:.3g}" and row.limit_text == "above 0.9"
    assert row.bound_text == f"above {good.quantile.lower:.3g} at 95 %"
    assert row.margin_text.startswith("+0.0") and row.relative_margin > 0.0
    assert RequirementRow.of(bad).relative_margin < 0.0 and overall([good, bad]) == "not compliant"
    assert row.as_dict()["lower_bound"] == pytest.approx(good.quantile.lower, rel=1e-5)
    assert "upper_bound" not in row.as_dict()
    short = judged(f"prob(Strehl(20 ms) > 0.9) {TAIL}", run_of(noise(5001)))
    assert short.statement.startswith("within limit; not yet demonstrated at 95 % confidence: needs 2")
    assert math.isinf(short.quantile.lower)
    assert (
        RequirementRow.of(short).bound_text == "not demonstrated: record too short"
        and RequirementRow.of(short).as_dict()["lower_bound"] is None
    )
    worse = judged("prob(Strehl(20 ms) > 0.993) >= 0.5 at 99.9999 % confidence", run_of(noise(401, 4.0)))
    assert "below limit" in worse.statement or worse.status == "not compliant"


@pytest.mark.further
def test_missing_samples_count_against_the_verdict() -> None:
    los = noise(25_001)
    whole = judged(f"prob(EE80(20 ms) < 140 mas) {TAIL}", run_of(los))
    assert whole.status == "compliant" and whole.missing == 0
    los[7000:7400] = np.nan
    holes = judged(f"prob(EE80(20 ms) < 140 mas) {TAIL}", run_of(los))
    assert holes.status == "not enough data" and holes.missing == 21 and math.isinf(holes.quantile.upper)
    low = judged(f"prob(Strehl(20 ms) > 0.5) {TAIL}", run_of(los))
    assert low.status == "not enough data" and low.quantile.lower == -math.inf
    assert "21 of 1250 samples are missing" in low.note


@pytest.mark.parametrize(
    ("run", "reason"),
    [
        (run_of(noise(500), None), NONE_KNOWN),
        (run_of(noise(15)), "the run must last for one exposure of 0.02 s and a sample, got 15 samples of 0.001 s"),
        (run_of(noise(500), {**TABLE, "pixel_mas": -1.0}), r"optics.pixel_mas must be above 0 mas, got -1.0"),
        (run_of(noise(500), "large"), "optics must be a table, got str"),
    ],
)
def test_what_cannot_be_judged_says_why(run: Any, reason: str) -> None:
    found = judged(f"prob(MTF(20 ms, Nyquist) > 0.9) {TAIL}", run)
    assert found.status == "not judged" and reason in found.note
    (row,) = requirement_table([RequirementRow.of(found)]).only(*BRIEF).rows
    assert row[1:] == ("–", "above 0.9", "–", f"not judged: {found.note}")
