"""Laws of a verdict: against the binomial distribution, hand-made populations, and equality at every bound."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from pointing_analysis.indices import confidence, metrics
from pointing_analysis.indices.errors import ErrorSeries
from pointing_analysis.indices.exceedances import IndependentSamples
from pointing_analysis.read.series import Provenance, Series, make_series, series
from pointing_analysis.requirements.verdict import (
    Requirement,
    Verdict,
    decide,
    index_samples,
    judge,
    parse,
    run_samples,
)

LIMIT = 0.5
"""[rad], a number without rounding."""
STRICT = parse("prob(|APE| < 0.5 rad) >= 0.997 at 95 % confidence", "strict")
LOOSE = parse("prob(|APE| < 0.5 rad) >= 0.75 at 75 % confidence", "loose")
ORDER = {"not compliant": 0, "not enough data": 1, "compliant": 2}


def samples(count: int, above: int, value: float = LIMIT) -> np.ndarray[Any, Any]:
    """So many samples, the last ones at the limit, or at another value."""
    return np.r_[np.linspace(0.1, 0.4, count - above), np.full(above, value)]


def expected(requirement: Requirement, worst: int, best: int, count: int) -> str:
    """Status by the binomial distribution: is so small, or so large, a count unlikely at the allowed rate?"""
    allowed, doubt = 1 - requirement.probability, 1 - requirement.confidence
    if worst < count and binom.cdf(worst, count, allowed) <= doubt:
        return "compliant"
    return "not compliant" if best > 0 and binom.sf(best - 1, count, allowed) < doubt else "not enough data"


def run(values: Any, *, missing: tuple[int, ...] = (), rate: float = 1000.0, open_end: bool = False) -> Series:
    """A run with these radial errors [rad] (or both axes), NaN at some rows."""
    x = np.asarray(values, dtype=float)
    xy = x if x.ndim == 2 else np.column_stack([x, np.zeros(len(x))])
    xy = xy.copy()
    xy[list(missing)] = np.nan
    stamps = 10**9 + np.round(np.arange(len(xy)) * 1e9 / rate).astype(np.int64)
    series = make_series(stamps, xy, unit="rad", rate=rate, provenance=Provenance("run"))
    return replace(series, topic=replace(series.topic, open_end=open_end)) if open_end else series


@pytest.mark.parametrize("requirement", [STRICT, LOOSE])
@pytest.mark.parametrize("count", [1, 7, 60, 997, 998, 1580])
def test_every_count_has_the_verdict_of_the_binomial_distribution(requirement: Requirement, count: int) -> None:
    for above in range(min(count, 30) + 1):
        found = decide(requirement, samples(count, above), count, 3.0)
        assert found.status == expected(requirement, above, above, count)
        assert (found.exceeding, found.samples, found.effective) == (above / count, count, count)
        assert found.within_limit == (above / count <= 1 - requirement.probability + 1e-12)
        assert found.quantile == confidence.quantile(
            samples(count, above), requirement.probability, requirement.confidence, count
        )
        assert (found.seconds, found.note, found.missing) == (3.0, "", 0.0)
        if found.status != "not enough data":
            assert found.seconds_needed == 3.0 and found.statement == found.status


def test_a_sample_at_the_limit_is_above_it() -> None:
    below = math.nextafter(LIMIT, 0.0)
    assert decide(STRICT, samples(998, 1, below), 998, 1.0).exceeding == 0.0
    assert decide(STRICT, samples(998, 1, LIMIT), 998, 1.0).exceeding == 1 / 998


@pytest.mark.parametrize("effective", [1.0, 37.5, 400.0, 1000.0])
def test_one_more_above_never_helps_and_one_more_missing_neither(effective: float) -> None:
    ranks = [ORDER[decide(LOOSE, samples(1000, above), effective, 1.0).status] for above in range(0, 1001, 40)]
    assert ranks == sorted(ranks, reverse=True)
    assert ranks[0] == (1 if effective == 1.0 else 2) and ranks[-1] == (1 if effective == 1.0 else 0)
    for above in (0, 100, 500):
        found = [decide(LOOSE, samples(1000, above), effective, 1.0, missing).status for missing in range(0, 9000, 300)]
        for i, status in enumerate(found):  # once undecided, for ever undecided; never from one verdict to the other
            assert status in ("not enough data", found[0])
            assert i == 0 or found[i - 1] != "not enough data" or status == "not enough data"
        assert found[-1] == "not enough data"
        assert decide(LOOSE, samples(1000, above), effective, 1.0, math.inf).status != "compliant"


def test_missing_samples_count_against_either_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    """Above for compliance and below for the contrary; each count is rounded to its own safe side."""
    asked: list[tuple[str, int, int, float]] = []
    for name in ("exceedance_upper", "exceedance_lower"):
        inner = getattr(confidence, name)

        def counted(k: int, n: int, c: float, inner: Any = inner, name: str = name) -> Any:
            asked.append((name, k, n, c))
            return inner(k, n, c)

        monkeypatch.setattr(confidence, name, counted)
    cases = {
        (950, 10, 950.0, 50.0): (57, 9, 950),
        (1000, 3, 500.0, 0.0): (2, 1, 500),  # 1.5 of 500
        (1000, 4, 500.9, 0.0): (2, 2, 500),  # exactly 2
        (990, 2, 990.0, 10.0): (12, 1, 990),  # 11.88 and 1.98 of 990
        (500, 50, 100.0, 500.0): (55, 5, 100),
        (100, 10, 100.0, math.inf): (100, 10, 100),
        (10, 1, 0.3, 0.0): (1, 0, 1),
    }
    for (count, above, effective, missing), (worst, best, n) in cases.items():
        asked.clear()
        found = decide(LOOSE, samples(count, above), effective, 1.0, missing)
        assert asked[:2] == [("exceedance_upper", worst, n, 0.75), ("exceedance_lower", best, n, 0.75)]
        assert found.status == expected(LOOSE, worst, best, n)
        assert found.exceeding == above / count and found.missing == missing
        assert (found.quantile.upper < LIMIT) == (found.status == "compliant")


def test_equality_at_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """An upper bound that is just the allowed rate is compliance; a lower one that is just the rate refutes nothing."""
    allowed = 1 - LOOSE.probability
    for upper, lower, status in (
        (allowed, 0.0, "compliant"),
        (math.nextafter(allowed, 1.0), 0.0, "not enough data"),
        (1.0, allowed, "not enough data"),
        (1.0, math.nextafter(allowed, 1.0), "not compliant"),
    ):
        monkeypatch.setattr(confidence, "exceedance_upper", lambda k, n, c, x=upper: x)
        monkeypatch.setattr(confidence, "exceedance_lower", lambda k, n, c, x=lower: x)
        assert decide(LOOSE, samples(10, 1), 10, 1.0).status == status


def test_the_length_that_would_decide() -> None:
    """Seconds for each independent sample, times the samples needed at the rate that counts."""
    found = decide(STRICT, samples(500, 0), 250.0, 40.0)
    assert found.seconds_needed == pytest.approx(998 * 40.0 / 250.0)
    assert found.statement == "within limit; not yet demonstrated at 95 % confidence: needs 160 s"
    missing = decide(STRICT, samples(499, 0), 499.0, 40.0, 1.0)
    needed = confidence.samples_to_decide(0.997, 0.95, 1 / 500)
    assert missing.seconds_needed == pytest.approx(needed * 40.0 / 499.0) and needed > 998
    gap = decide(LOOSE, samples(100, 10), 100.0, 40.0, 30.0)
    assert math.isinf(gap.seconds_needed)  # 8 to 31 % are above the limit, of any length
    unknown = decide(STRICT, samples(500, 1), 500.0, 40.0, math.inf)
    assert unknown.seconds_needed == pytest.approx(confidence.samples_to_decide(0.997, 0.95, 1 / 500) * 40.0 / 500.0)
    above = decide(LOOSE, samples(10, 3), 10.0, 2.0)
    needs = f"needs {math.ceil(above.seconds_needed)} s"
    confidence_text = f"{100 * LOOSE.confidence:g} % confidence"
    assert above.status == "not enough data"
    assert above.statement == f"above limit; not yet demonstrated at {confidence_text}: {needs}"


MISSING = "samples are missing and count against the verdict"
CUT_OFF = "the recording is truncated: the missing part is not known"
OPEN = "not yet demonstrated at 75 % confidence: needs 3 s"
NEVER = "not demonstrated by a run of any length"


def verdict(**changes: Any) -> Verdict:
    nothing = confidence.Quantile(0.75, 0.75, 0.1, 0.1, math.inf, 1.0)
    return replace(Verdict(LOOSE, "not enough data", 0.0, nothing, 100, 100.0, 1.0, 2.5), **changes)


@pytest.mark.parametrize(
    ("changes", "keeps", "statement"),
    [
        ({"exceeding": 0.25}, True, f"within limit; {OPEN}"),
        ({"exceeding": 0.26}, False, f"above limit; {OPEN}"),
        ({"exceeding": 0.25, "seconds_needed": math.inf}, True, f"within limit; {NEVER}"),
        ({"exceeding": 0.26, "seconds_needed": math.inf}, False, f"above limit; {NEVER}"),
        ({"exceeding": 0.2, "missing": 6.0}, True, f"within limit; {OPEN}"),
        ({"exceeding": 0.2, "missing": 20.0}, False, f"not enough data: 20 of 120 {MISSING}"),
        ({"exceeding": 0.0, "missing": 33.0}, True, f"within limit; {OPEN}"),
        ({"exceeding": 0.0, "missing": 34.0}, False, f"not enough data: 34 of 134 {MISSING}"),
        ({"missing": math.inf}, False, f"not enough data: {CUT_OFF}"),
        ({"status": "compliant"}, True, "compliant"),
        ({"status": "not compliant", "exceeding": 1.0}, False, "not compliant"),
    ],
)
def test_words_of_a_verdict(changes: dict[str, Any], keeps: bool, statement: str) -> None:
    found = verdict(**changes)
    assert (found.within_limit, found.statement) == (keeps, statement)


def test_temporal_counts_the_worst_run() -> None:
    """Every run must comply: one that does not, or that is too short, is the verdict; order does not matter."""
    rng = np.random.default_rng(0)
    good, bad = run(rng.uniform(0.0, 0.4, 400)), run(rng.uniform(0.3, 0.9, 400))
    short, longer = run(rng.uniform(0.0, 0.4, 3)), run(rng.uniform(0.0, 0.4, 4))
    for runs, status, count in (
        ([good], "compliant", 400),
        ([good, short], "not enough data", 3),
        ([bad, good, short], "not compliant", 400),
        ([short, bad], "not compliant", 400),
        ([good, good], "compliant", 400),
        ([longer, good], "not enough data", 4),
    ):
        for order in (runs, runs[::-1]):
            found = judge(LOOSE, order, 0.0)
            assert (found.status, found.samples, found.seconds) == (status, count, count / 1000)


def test_a_worse_verdict_counts_before_a_larger_share() -> None:
    """A long run refuted at 35 % beside a short one with 50 %; a short one at 0 % beside a compliant at 10 %."""
    rng = np.random.default_rng(8)
    refuted, shorter = run(np.where(rng.random(800) < 0.35, 0.6, 0.1)), run([0.1, 0.9])
    assert judge(LOOSE, [shorter, refuted], 0.0).status == "not compliant"
    assert judge(LOOSE, [shorter], 0.0).exceeding > judge(LOOSE, [refuted], 0.0).exceeding
    compliant, short = run(np.where(rng.random(800) < 0.1, 0.6, 0.1)), run([0.1, 0.2])
    assert judge(LOOSE, [compliant], 0.0).status == "compliant"
    assert judge(LOOSE, [compliant, short], 0.0).status == "not enough data"
    assert judge(LOOSE, [shorter, compliant], 0.0).status == "not enough data"


def test_ensemble_takes_the_worst_instant_of_each_run() -> None:
    requirement = replace(LOOSE, interpretation="ensemble")
    runs = [run(np.r_[0.05, worst, 0.0]) for worst in (0.1, 0.2, LIMIT, 0.7)]
    found = judge(requirement, runs, 0.0)
    assert (found.samples, found.effective, found.exceeding, found.missing) == (4, 4.0, 0.5, 0.0)
    assert found.seconds == pytest.approx(0.012) and found.status == expected(requirement, 2, 2, 4)
    many = [run(np.r_[0.1, 0.1, 0.01 * i]) for i in range(12)]
    assert judge(requirement, many, 0.0).status == expected(requirement, 0, 0, 12) == "compliant"


def test_ensemble_runs_with_missing_samples_are_missing_unless_above() -> None:
    """What is not there may be above: a run with a gap is known only where the rest of it is above already."""
    requirement = replace(LOOSE, interpretation="ensemble")
    whole, gap, at = run([0.1, 0.2, 0.1]), run([0.1, 0.2, 0.1], missing=(1,)), run([0.1, LIMIT, 0.1], missing=(0,))
    found = judge(requirement, [whole, gap, at], 0.0)
    assert (found.samples, found.missing, found.exceeding) == (2, 1.0, 0.5)
    assert found.note.startswith("1 of 3 samples")
    assert judge(requirement, [whole, at, at], 0.0).missing == 0.0
    none = judge(requirement, [gap, gap], 0.0)
    assert none.status == "not judged" and "every run has missing samples" in none.note
    assert math.isnan(none.exceeding) and none.samples == 0 and math.isinf(none.quantile.upper)


def test_mixed_takes_all_samples_together() -> None:
    requirement, rng = replace(LOOSE, interpretation="mixed"), np.random.default_rng(2)
    values = [rng.uniform(0.0, 0.7, 300), rng.uniform(0.0, 0.7, 700)]
    runs = [run(values[0]), run(values[1], missing=(5, 6))]
    found = judge(requirement, runs, 0.0)
    there = np.concatenate([values[0], np.delete(values[1], [5, 6])])
    assert (found.samples, found.missing, found.seconds) == (998, 2.0, 1.0)
    assert found.exceeding == np.mean(there >= LIMIT)
    assert found.effective == pytest.approx(998**2 / (300**2 + 698**2))


def test_runs_are_at_most_one_sample_each() -> None:
    """What differs between runs is seen once in each of them, however long they are."""
    requirement, rng = replace(LOOSE, interpretation="mixed"), np.random.default_rng(4)
    good, bad = [run(rng.uniform(0.0, 0.4, 400)) for _ in range(9)], run(rng.uniform(0.6, 0.9, 400))
    found = judge(requirement, [*good, bad], 0.0)
    assert found.exceeding == 0.1 and found.effective == pytest.approx(10.0)
    assert found.status == expected(requirement, 1, 1, 10)
    assert judge(requirement, good, 0.0).effective == pytest.approx(9.0)


@pytest.mark.further
def test_many_runs_are_refuted_by_chance_no_more_often_than_one() -> None:
    """Forty runs at exactly the allowed share: each alone is refuted in 5 %, which must not become one of them."""
    requirement = parse("prob(|APE| < 0.5 rad) >= 0.75 at 95 % confidence")
    refuted = 0
    for seed in range(30):
        rng = np.random.default_rng([9, seed])
        runs = [run(np.where(rng.random(100) < 0.25, 0.6, 0.1)) for _ in range(20)]
        refuted += judge(requirement, runs, 0.0).status == "not compliant"
    assert refuted <= binom.isf(1e-3, 30, 0.05)


@pytest.mark.parametrize("interpretation", ["ensemble", "mixed"])
def test_several_runs_are_needed(interpretation: str) -> None:
    found = judge(replace(LOOSE, interpretation=interpretation), [run(samples(30, 0))], 0.0)
    assert found.status == "not judged" and found.note == f"{interpretation} requirements need several runs, got 1"
    pre = judge(parse("prob(|PRE(10 ms)| < 0.5 rad) >= 0.9 at 90 % confidence"), [run(samples(30, 0))], 0.0)
    assert pre.note == "PRE requirements need several runs, got 1"
    assert (pre.samples, pre.effective, pre.seconds, pre.quantile.effective) == (0, 0.0, 0.0, 0.0)
    assert all(math.isnan(x) for x in (pre.exceeding, pre.seconds_needed, pre.quantile.value, pre.quantile.lower))
    assert (pre.quantile.probability, pre.quantile.confidence, pre.missing) == (0.9, 0.9, 0.0)


def test_reproducibility_of_recordings_of_different_rates() -> None:
    """Each of 30 windows of a second beside each of 30, whatever the rates; a drift of 1 mas/s differs by 29 s."""
    drifts = [np.repeat(np.arange(30.0 * rate)[:, None] / rate, 2, axis=1) for rate in (512, 1000)]
    runs = [series(None, drift, unit="mas", rate=float(len(drift) // 30)) for drift in drifts]
    verdict = judge(parse("prob(|PRE_x(1 s)| < 29.01 mas) >= 0.9 at 60 % confidence"), runs, 0.0)
    assert (verdict.samples, verdict.missing, verdict.exceeding) == (900, 0.0, 0.0)


def wave(count: int = 400) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(5)
    return np.asarray(0.1 * rng.standard_normal((count, 2)) + 0.05)


def of(text: str, values: Any, missing: int = 0, open_end: bool = False) -> tuple[Any, float, float]:
    """Samples that are there, the most that are independent, and the missing ones."""
    requirement = parse(f"prob({text} < 0.5 rad) >= 0.9 at 90 % confidence")
    series = ErrorSeries(np.asarray(values), 1e-3, 0.0, missing, open_end)
    judged = run_samples(series, requirement)
    return judged.values, index_samples(series, requirement).most, judged.missing


def test_samples_of_each_index_are_those_of_its_metric() -> None:
    e, dt = wave(), 1e-3
    window = metrics.windows(e, dt, 0.02)
    cases: dict[str, tuple[Any, float]] = {
        "|APE|": (np.hypot(*e.T), math.inf),
        "|AKE_y|": (np.abs(e[:, 1]), math.inf),
        "|APE_x|": (np.abs(e[:, 0]), math.inf),
        "|MPE(20 ms)|": (np.hypot(*window.mean.T), math.inf),
        "|MKE(20 ms)|": (np.hypot(*window.mean.T), math.inf),
        "|RPE(20 ms)|": (np.hypot(*metrics.rpe_instant(e, dt, 0.02).T), 20.0),
        "|RKE_x(20 ms)|": (np.abs(metrics.rpe_instant(e, dt, 0.02)[:, 0]), 20.0),
        "rms RPE(20 ms)": (np.sqrt(window.variance.sum(axis=1)), math.inf),
        "rms RKE_y(20 ms)": (np.sqrt(window.variance[:, 1]), math.inf),
        "|PDE(20 ms, 60 ms)|": (np.hypot(*metrics.pde(e, dt, 0.02, 0.06).T), math.inf),
    }
    for text, (values, cap) in cases.items():
        found, independent, missing = of(text, e)
        assert found == pytest.approx(values), text
        assert (independent, missing) == (cap, 0.0), text
        assert of(text, e, open_end=True)[2] == math.inf


@pytest.mark.parametrize(
    ("text", "lost"),
    [("|APE|", 2), ("|MPE(20 ms)|", 1), ("|RPE(20 ms)|", 20), ("rms RPE(20 ms)", 1), ("|PDE(20 ms, 60 ms)|", 2)],
)
def test_a_missing_sample_takes_its_window_with_it(text: str, lost: int) -> None:
    e = wave()
    e[[205, 206]] = np.nan
    values, _, missing = of(text, e, missing=2)
    assert missing == lost and len(values) + lost == len(of(text, wave())[0]) and np.isfinite(values).all()


@pytest.mark.parametrize("seconds", [10, 11, 12, 14])
def test_the_seconds_needed_are_those_of_whole_windows(seconds: int) -> None:
    """Of 5 s each, whatever is left behind the last one; the start-up comes in addition."""
    requirement = parse("prob(|MPE(5 s)| < 0.5 rad) >= 0.95 at 90 % confidence")
    found = judge(requirement, [run(0.01 * wave(1000 * seconds))])
    assert found.seconds_needed == 45 * 5.0 == 5.0 * confidence.samples_needed(0.95, 0.9)
    assert found.statement.endswith("needs 225 s after 5 s of start-up")


def test_no_more_than_one_instant_of_a_window_is_independent() -> None:
    requirement = parse("prob(|RPE(20 ms)| < 0.5 rad) >= 0.9 at 90 % confidence")
    found = judge(requirement, [run(wave())], 0.0)
    assert found.samples == 400 and found.effective == 20.0


def test_reproducibility_is_of_each_pair_of_runs() -> None:
    """Every window of the one with every window of the other; a pair weighs as much as the shorter of its runs."""
    requirement = parse("prob(|PRE(20 ms)| < 0.5 rad) >= 0.9 at 90 % confidence")
    a, b, far = wave(400), wave(800)[400:700], wave(200) + 0.6
    found = judge(requirement, [run(a), run(b)], 0.0)
    assert (found.samples, found.missing) == (20 * 15, 0.0) and found.seconds == pytest.approx(0.7)
    means = [metrics.radial(metrics.mpe(e, 1e-3, 0.02)) for e in (a, b)]
    assert found.effective == min(IndependentSamples.of(mean).most for mean in means)
    difference = metrics.pre(metrics.mpe(a, 1e-3, 0.02), metrics.mpe(b, 1e-3, 0.02))
    assert found.quantile.value == confidence.quantile(np.hypot(*difference.T), 0.9, 0.9, 1.0).value
    worst = judge(requirement, [run(a), run(b), run(far)], 0.0)
    assert worst.exceeding > 0.9 and worst.samples in (20 * 10, 15 * 10)
    together = judge(replace(requirement, interpretation="mixed"), [run(a), run(b), run(far)], 0.0)
    assert together.samples == 20 * 15 + 20 * 10 + 15 * 10  # each pair once, no run with itself
    gap = judge(requirement, [run(a, missing=(3,)), run(b)], 0.0)
    assert (gap.samples, gap.missing) == (19 * 15, 15.0)
    for ends in ((True, False), (False, True)):
        cut = judge(requirement, [run(e, open_end=end) for e, end in zip((a, b), ends)], 0.0)
        assert math.isinf(cut.missing)
    holed = judge(requirement, [run(a, missing=tuple(range(0, 400, 10))), run(b)], 0.0)
    assert (holed.status, holed.note) == ("not judged", "no complete window of |PRE(20 ms)| in each run")


def test_what_cannot_be_formed_is_not_judged() -> None:
    long = parse("prob(|RPE(2 s)| < 0.5 rad) >= 0.9 at 90 % confidence")
    found = judge(long, [run(wave())], 0.0)
    assert found.status == "not judged" and "at least as long as the window" in found.note
    holes = wave()
    blank = series(None, np.where(np.arange(400)[:, None] % 20 == 3, np.nan, holes), unit="rad", rate=1000.0)
    none = judge(parse("prob(rms RPE(20 ms) < 0.5 rad) >= 0.9 at 90 % confidence"), [blank], 0.0)
    assert none.status == "not judged" and "no complete window of rms RPE(20 ms)" in none.note
    knowledge = judge(parse("prob(|AKE| < 0.5 rad) >= 0.9 at 90 % confidence"), [run(wave())], 0.0)
    assert knowledge.status == "not judged"  # no estimate there


def test_an_ensemble_needs_runs_not_seconds() -> None:
    """Each run is one sample, however long: of two runs of 225 s it said that it needs 880 s."""
    asked = parse("prob(|APE| < 60 mas) >= 0.9 at 90 % confidence, ensemble")
    rng = np.random.default_rng(3)
    t = np.arange(10_000) / 1000.0
    for count, status in ((2, "not enough data"), (22, "compliant")):
        runs = [series(t, rng.normal(0.0, 8.0, (10_000, 2)), unit="mas") for _ in range(count)]
        verdict = judge(asked, runs, 0.0)
        assert verdict.status == status
        if count == 2:
            assert verdict.statement.endswith("needs 22 runs")


def test_a_record_that_was_not_enough_needs_more_than_it_has() -> None:
    """Also where only the largest values, none of them above the limit, come in clusters."""
    rng, notes = np.random.default_rng(4), list[str]()
    for _ in range(40):
        values = 0.1 * rng.random(20_000)
        for start in rng.integers(0, 19_000, 4):
            values[start : start + 400] = 0.3 + 0.1 * rng.random(400)
        found = judge(parse("prob(|APE| < 0.5 rad) >= 0.9 at 95 % confidence"), [run(values)], 0.0)
        if found.status == "not enough data":
            assert found.exceeding == 0.0 and found.seconds_needed > found.seconds
            notes.append(found.note)
    assert {note.partition(",")[0] for note in notes if note} == {"the largest values come in clusters"}
