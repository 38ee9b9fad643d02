"""Verdicts of a campaign on hand-made populations of members."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign.campaign_verdict import CampaignVerdict, model_verdicts, not_judged, refused, verdicts
from los_testbed.campaign.meanings import RequirementColumns

from pointing_analysis.indices.confidence import exceedance_lower, exceedance_upper, samples_needed
from pointing_analysis.requirements.requirement import Requirement, parse

APE = parse("prob(|APE| < 2 arcsec) >= 0.75 at 75 % confidence", "A")
RPE = parse("prob(rms RPE(20 ms) < 50 mas) >= 0.997 at 95 % confidence", "R", ["fsm+pma"])


def columns(largest: Any, own: Any, share: Any, effective: Any) -> dict[str, Any]:
    return population(APE, largest, own, share, effective)


def by_kind(found: list[CampaignVerdict]) -> dict[str, CampaignVerdict]:
    return {v.interpretation: v for v in found}


def test_each_interpretation_has_its_own_samples() -> None:
    """Worst instants 1, 2 (the limit), 3; quantiles 1, 1.5, 1.9; shares 0, 0.1, 0.4 of 10, 30, 0.5 samples."""
    found = by_kind(verdicts(columns([1, 2, 3], [1, 1.5, 1.9], [0, 0.1, 0.4], [10, 30, 0.5]), ["ok"] * 3, "fsm", [APE]))
    ensemble, temporal, mixed = (found[kind] for kind in ("ensemble", "temporal", "mixed"))
    assert (ensemble.exceeding, ensemble.samples, ensemble.limit, ensemble.unit) == (2 / 3, 3, 2.0, "arcsec")
    assert ensemble.value == 3.0  # what 75 % of the worst instants keep: of three, the largest
    # 30 samples with a tenth above show a share below 25 % at 75 %; 0.4 of one sample shows nothing
    assert (temporal.status, temporal.value, temporal.exceeding, temporal.samples) == ("not enough data", 1.9, 0.0, 3)
    assert (temporal.needed, temporal.undecided) == (samples_needed(0.75, 0.75, 0), 1)
    assert (mixed.samples, mixed.exceeding) == (3, 1 / 3)  # a sixth of three members, rounded up
    assert mixed.value == pytest.approx((1 + 1.5 + 1.9) / 3)
    for v, k, n in ((ensemble, 2, 3), (temporal, 1, 3), (mixed, 1, 3)):
        low = 0 if v is temporal else k  # who is not proven to keep a limit is not proven to break it
        assert (v.lower, v.upper) == (exceedance_lower(low, n, 0.75), exceedance_upper(k, n, 0.75))
        assert v.text == str(APE) and v.requirement == "A"
    assert ensemble.needed == samples_needed(0.75, 0.75, 2) and mixed.needed == samples_needed(0.75, 0.75, 1)


def test_a_campaign_of_runs_without_a_verdict_has_none() -> None:
    """Fifty runs of 30 windows each, none above the limit: 998 would show one of them; and 998 members all of them."""
    requirement = parse("prob(rms RPE(20 ms) < 50 mas) >= 0.997 at 95 % confidence")

    def temporal(members: int, windows: float, random: bool = True, share: float = 0.0) -> CampaignVerdict:
        own = [np.full(members, x) for x in (30.0, 20.0, share, windows)]
        given = population(requirement, *own)
        return by_kind(verdicts(given, ["ok"] * members, "fsm", [requirement], random))["temporal"]

    short = temporal(50, 30.0)
    assert (short.status, short.undecided, short.lower, short.upper) == ("not enough data", 50, 0.0, 1.0)
    few = temporal(50, 1000.0)
    assert (few.status, few.undecided, few.needed) == ("not enough data", 0, 998)
    assert few.upper == exceedance_upper(0, 50, 0.95) > 0.05
    assert temporal(998, 1000.0).status == "compliant" and temporal(997, 1000.0).status == "not enough data"
    listed = temporal(50, 1000.0, random=False)
    assert listed.status == "compliant" and math.isnan(listed.upper) and listed.as_dict()["upper"] is None
    assert temporal(50, 900.0, random=False).status == "not enough data"
    assert temporal(50, 1000.0, share=0.02).status == "not compliant"
    assert len(verdicts(population(requirement, [1], [1], [0], [9]), ["ok"], "fsm", [requirement], False)) == 1


def test_members_at_the_allowed_share_are_refuted_in_one_of_twenty_campaigns() -> None:
    """Not in one of twenty members."""
    requirement = parse("prob(|APE| < 2 arcsec) >= 0.9 at 95 % confidence")
    rng, refuted = np.random.default_rng(8), 0
    for _ in range(100):
        share = rng.binomial(500, 0.1, 40) / 500
        given = population(requirement, np.full(40, 3.0), np.full(40, 1.0), share, np.full(40, 500.0))
        found = by_kind(verdicts(given, ["ok"] * 40, "fsm", [requirement]))
        refuted += found["temporal"].status == "not compliant"
    assert refuted <= 12


def test_members_weigh_as_one_sample_each() -> None:
    """Mixed: one telescope in ten exceeds all the time. Of twenty none does in 12 % of the campaigns."""
    requirement = parse("prob(|APE| < 2 arcsec) >= 0.9 at 95 % confidence")
    for bad, members in ((1, 40), (0, 20), (0, 28)):
        share = np.r_[np.ones(bad), np.zeros(members - bad)]
        given = population(requirement, np.ones(members), np.ones(members), share, np.full(members, 1e6))
        found = by_kind(verdicts(given, ["ok"] * members, "fsm", [requirement]))["mixed"]
        assert found.samples == members and found.status == "not enough data"
    given = population(requirement, *np.ones((2, 29)), np.zeros(29), np.full(29, 1e6))
    assert by_kind(verdicts(given, ["ok"] * 29, "fsm", [requirement]))["mixed"].status == "compliant"


def test_whole_counts_are_not_rounded_up() -> None:
    """A pooled share that is a whole number of samples but for rounding is that number."""
    found = by_kind(verdicts(columns([1] * 10, [1] * 10, [0.1] * 10, [10] * 10), ["ok"] * 10, "fsm", [APE]))
    assert (found["mixed"].samples, found["mixed"].exceeding) == (10, 1 / 10)
    more = by_kind(verdicts(columns([1] * 11, [1] * 11, [0.1] * 11, [10] * 11), ["ok"] * 11, "fsm", [APE]))
    assert (more["mixed"].samples, more["mixed"].exceeding) == (11, 2 / 11)


@pytest.mark.parametrize("count", [4, 5, 20])
def test_status_is_that_of_the_bounds(count: int) -> None:
    for above in range(count + 1):
        largest = [3.0] * above + [1.0] * (count - above)
        found = by_kind(verdicts(columns(largest, [1] * count, [0] * count, [1] * count), ["ok"] * count, "fsm", [APE]))
        upper, lower = exceedance_upper(above, count, 0.75), exceedance_lower(above, count, 0.75)
        status = "compliant" if upper <= 0.25 else "not compliant" if lower > 0.25 else "not enough data"
        assert found["ensemble"].status == status


def test_lost_members_are_above_and_failed_ones_left_out() -> None:
    status = ["ok", "unstable", "failed", "diverged", "crashed"]
    found = by_kind(verdicts(columns([1] * 5, [1] * 5, [0] * 5, [4, 9, 9, 9, 9]), status, "fsm", [APE]))
    assert (found["ensemble"].samples, found["ensemble"].exceeding) == (3, 2 / 3)
    assert found["temporal"].status == "not compliant" and math.isinf(found["temporal"].value)
    assert (found["mixed"].samples, found["mixed"].exceeding) == (3, 2 / 3)
    assert found["temporal"].as_dict()["value"] is None and found["temporal"].as_dict()["limit"] == 2.0
    assert verdicts(columns([1], [1], [0], [1]), ["failed"], "fsm", [APE]) == []
    assert model_verdicts(np.ones(1), ["failed"], "fsm+pma", [RPE]) == []


def test_the_model_judges_windows_of_its_probability() -> None:
    found = model_verdicts(np.array([10.0, 49.9, 70.0]), ["ok", "ok", "failed"], "fsm+pma", [APE, RPE])
    assert [(v.requirement, v.status, v.value, v.samples, v.limit, v.unit) for v in found] == [
        ("R", "not enough data", 49.9, 2, 50.0, "mas")
    ]
    assert model_verdicts(np.full(998, 10.0), ["ok"] * 998, "fsm+pma", [RPE])[0].status == "compliant"
    assert model_verdicts(np.array([10.0]), ["ok"], "fsm+pma", [RPE], random=False)[0].status == "compliant"
    (above,) = model_verdicts(np.array([10.0, 50.0, 5.0]), ["ok", "ok", "diverged"], "fsm+pma", [RPE])
    assert above.status == "not compliant" and above.exceeding == 2 / 3 and math.isinf(above.value)
    assert model_verdicts(np.ones(2), ["ok"] * 2, "fsm", [RPE]) == []
    others = [
        parse(f"prob({quantity} < 50 mas) >= 0.997 at 95 % confidence")
        for quantity in ("rms RPE_x(20 ms)", "rms RPE(50 ms)", "|RPE(20 ms)|", "rms RKE(20 ms)")
    ]
    assert [v.requirement for v in model_verdicts(np.ones(1), ["ok"], "fsm+pma", [RPE, *others])] == ["R"]
    assert list(not_judged([RPE, *others], "fsm+pma", "model")) == others


def population(requirement: Requirement, worst: Any, own: Any, share: Any, effective: Any) -> dict[str, Any]:
    columns = RequirementColumns.of(requirement)
    given = {columns.worst: worst, columns.quantile: own, columns.share: share, columns.effective: effective}
    given[columns.unseen] = np.zeros(len(np.asarray(share)))
    return {name: np.asarray(values, dtype=float) for name, values in given.items()}


def test_a_lower_limit_is_judged_as_an_upper_one_of_the_complement() -> None:
    """Same statuses, counts and bounds in all interpretations; values mirrored; diverged members are beyond both."""
    below = parse("prob(Strehl(20 ms) > 0.25) >= 0.9 at 95 % confidence")
    above = parse("prob(ellipticity(20 ms) < 0.75) >= 0.9 at 95 % confidence")
    rng = np.random.default_rng(3)
    seen = set()
    for scatter in (0.2, 0.65, 0.72, 1.0):
        for count in (3, 60):
            own = scatter * rng.uniform(0.5, 1.0, count)
            worst = np.minimum(1.0, own + 0.1 * rng.uniform(0.0, 1.0, count))
            share = np.where(worst >= 0.75, rng.uniform(0.0, 0.2, count), 0.0)
            effective = rng.uniform(1.0, 500.0, count)
            for status in (["ok"] * count, ["diverged", *["ok"] * (count - 2), "failed"]):
                low = verdicts(population(below, 1 - worst, 1 - own, share, effective), status, "fsm", [below])
                high = verdicts(population(above, worst, own, share, effective), status, "fsm", [above])
                assert [v.interpretation for v in low] == ["ensemble", "temporal", "mixed"]
                for a, b in zip(low, high):
                    same = ("interpretation", "status", "exceeding", "lower", "upper", "samples", "needed")
                    assert [getattr(a, name) for name in same] == [getattr(b, name) for name in same]
                    assert a.value == pytest.approx(1 - b.value) and a.limit == 1 - b.limit
                    assert a.lower_limit and not b.lower_limit and a.unit == ""
                    seen.add(a.status)
    assert seen == {"compliant", "not compliant", "not enough data"}


@pytest.mark.parametrize("text", ["Strehl(20 ms) > 0.25", "|APE_x| < 1 arcsec"])
def test_a_worse_member_never_helps(text: str) -> None:
    """Whichever of its metrics gets worse: the exceedance of no interpretation falls, and no value improves."""
    r = parse(f"prob({text}) >= 0.9 at 80 % confidence")
    rng = np.random.default_rng(5)
    sign = -1.0 if r.lower else 1.0
    for _ in range(200):
        size, worse = int(rng.integers(1, 12)), rng.uniform(0.0, 1.0)
        worst, own = rng.uniform(0.0, 1.5, size), rng.uniform(0.0, 1.5, size)
        given = [worst, own, rng.uniform(0.0, 0.3, size), np.full(size, 40.0)]
        which, member = int(rng.integers(0, 3)), int(rng.integers(0, size))
        changed = [values.copy() for values in given]
        changed[which][member] += 0.7 * worse if which == 2 else sign * worse
        before, after = (verdicts(population(r, *values), ["ok"] * size, "fsm", [r]) for values in (given, changed))
        for a, b in zip(before, after):
            assert sign * b.value >= sign * a.value
            assert b.exceeding >= a.exceeding and b.upper >= a.upper and b.lower >= a.lower


@pytest.mark.parametrize("text", ["Strehl(20 ms) > 0.25", "|APE_x| < 1 arcsec"])
def test_a_metric_that_is_not_known_does_not_comply(text: str) -> None:
    r = parse(f"prob({text}) >= 0.9 at 80 % confidence")
    good = 0.9
    columns = population(r, [good, np.nan], [good, np.nan], [0.0, np.nan], [9, np.nan])
    found = verdicts(columns, ["ok"] * 2, "fsm", [r])
    assert [v.exceeding for v in found] == [0.5, 0.5, 0.5] and found[1].status == "not enough data"
    assert [v.exceeding for v in verdicts({}, ["ok"] * 2, "fsm", [r])] == [1.0, 1.0, 1.0]


def test_what_runs_cannot_be_judged_by_is_said_of_their_stage() -> None:
    """With the reason, from the windows that fit a run of so many ticks."""
    refusals = refused([APE, RPE], 19, None)
    assert refusals == {RPE: "the run must be at least as long as the window of 0.02 s, got 0.019 s"}
    assert refused([APE, RPE], 20, None) == {}
    assert not_judged([APE, RPE], "fsm+pma", "time", refusals) == refusals
    assert not_judged([APE, RPE], "fsm", "time", refusals) == {}
    assert RPE not in not_judged([APE, RPE], "fsm+pma", "model", refusals)


@pytest.mark.parametrize(("text", "limit", "kept"), [("|APE| < 2 arcsec", 2.0, 0.0), ("Strehl(20 ms) > 0.9", 0.9, 1.0)])
def test_a_member_at_its_limit_is_beyond_it(text: str, limit: float, kept: float) -> None:
    r = parse(f"prob({text}) >= 0.75 at 75 % confidence")
    for own in (limit, math.nextafter(limit, kept)):
        ensemble, temporal, _ = verdicts(
            population(r, [kept, own], [kept, own], [0, 0], [9, 9]), ["ok"] * 2, "fsm", [r]
        )
        assert ensemble.exceeding == temporal.exceeding == (own == limit) / 2
    lost = verdicts(population(r, [kept], [kept], [0.0], [9.0]), ["diverged"], "fsm", [r])
    assert [math.isinf(v.value) and v.as_dict()["value"] is None for v in lost] == [True] * 3


def test_no_more_samples_are_above_than_there_are() -> None:
    """All of 7 samples, and the bounds are numbers."""
    mixed = by_kind(verdicts(columns([3] * 7, [3] * 7, [1.0] * 7, [7.9] * 7), ["ok"] * 7, "fsm", [APE]))["mixed"]
    assert (mixed.samples, mixed.exceeding, mixed.upper) == (7, 1.0, 1.0)
    assert mixed.lower == exceedance_lower(7, 7, 0.75) and mixed.status == "not compliant"
