"""Requirements are read as written, and no verdict is given that the data do not carry."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.slow_cases import slow

from lftkit.errors import InputError
from pointing_analysis.indices.synthetic import write_bag
from pointing_analysis.read.run import Run
from pointing_analysis.requirements import verdict as requirements
from pointing_analysis.requirements.summary import summarise
from pointing_analysis.requirements.verdict import judge, parse
from titop_plant.telescope.load import load_telescope

MAS = np.pi / 648_000_000
OF_TELESCOPE = load_telescope().to_mapping()["requirement"]


@pytest.fixture
def noise_run(tmp_path):
    """Runs of white noise; the 99.7 % quantile of its radial RPE in 20 ms is about 3.41 sqrt(0.95) sigma."""

    def make(sigma_mas: float = 10.0, seconds: float = 30.0, seed: int = 0, **parameters) -> Run:
        los = sigma_mas * MAS * np.random.default_rng(seed).standard_normal((round(1000 * seconds), 2))
        folder = tmp_path / f"{sigma_mas}-{seconds}-{seed}-{len(parameters)}"
        return Run.open(write_bag(folder, {"truth/los": los}, parameters={"transient_s": 0, **parameters}))

    return make


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("RPE below 40 mas", "requirement must read like"),
        ("prob(|XPE(20 ms)| < 40 mas) >= 0.997 at 95 % confidence", "index must be one of APE.*got 'XPE'"),
        ("prob(|APE| < 40 parsec) >= 0.997 at 95 % confidence", "unit must be one of"),
        ("prob(|APE| < 40 mas) >= 0.997 at 95 % confidence, hopeful", "interpretation must be one of"),
    ],
)
def test_text_that_cannot_be_understood(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse(text)


RPE = "prob(|RPE(20 ms)| < {limit} mas) >= 0.997 at 95 % confidence"


def test_compliant_not_compliant_and_not_enough(noise_run) -> None:
    run = noise_run(10.0, 30.0)
    quantile = 10 * math.sqrt(0.95) * 3.40856
    good = judge(parse(RPE.format(limit=60)), [run])
    assert good.status == "compliant"
    assert good.quantile.value / MAS == pytest.approx(quantile, rel=0.03)
    assert good.quantile.lower < good.quantile.value < good.quantile.upper < 60 * MAS
    assert judge(parse(RPE.format(limit=20)), [run]).status == "not compliant"
    assert judge(parse(RPE.format(limit=34)), [run]).status == "not enough data"


def test_too_short_a_run_is_never_compliant_and_says_how_long_it_takes(noise_run) -> None:
    """998 independent exposures of 20 ms are 19.96 s, however small the error."""
    verdict = judge(parse(RPE.format(limit=1000)), [noise_run(1.0, 10.0)])
    assert (verdict.status, verdict.exceeding) == ("not enough data", 0.0)
    assert verdict.effective == 500
    assert verdict.seconds_needed == pytest.approx(19.96)
    assert judge(parse(RPE.format(limit=1000)), [noise_run(1.0, 19.9)]).status == "not enough data"
    assert judge(parse(RPE.format(limit=1000)), [noise_run(1.0, 19.98)]).status == "compliant"


@pytest.mark.further
@pytest.mark.parametrize("pole", [slow(0.0), 0.9])
def test_wrong_verdicts_are_as_rare_as_the_confidence_says(pole: float) -> None:
    """At the very limit either verdict is wrong: each may be given in 5 % of the runs, correlated or not."""
    from scipy.signal import lfilter

    from pointing_analysis.indices.confidence import effective_number

    p, n, runs = 0.98, 5000, 400
    limit = math.sqrt(-2 * math.log(1 - p))
    requirement = parse(f"prob(|APE| < {limit} rad) >= {p} at 95 % confidence")
    rng = np.random.default_rng(11)
    white = rng.standard_normal((runs, 2, n + 200))
    e = lfilter([math.sqrt(1 - pole**2)], [1, -pole], white, axis=2)[:, :, 200:]
    norms = np.hypot(e[:, 0], e[:, 1])
    found = [requirements.decide(requirement, r, effective_number(r), 5.0).status for r in norms]
    # 5 % of 400 are 20; 30 are more than two standard deviations above.
    assert found.count("compliant") <= 30
    assert found.count("not compliant") <= 30
    assert found.count("compliant") + found.count("not compliant") > 0


@pytest.mark.further
def test_a_recording_without_requirements_has_metrics_and_no_verdict(noise_run) -> None:
    """Nobody's limits are taken for those of another; damaged ones are named."""
    found = summarise(noise_run(2.0, 25.0, loop="fsm"))
    assert found.verdicts == () and not found.requirements_known and found.ape_p997 > 0
    assert found.as_dict()["requirements"] == [] and not found.as_dict()["requirements_known"]
    for damaged in ("APE", [{"name": "no text"}], [{"text": "APE below 1"}], [{"text": 3}], ["prob"]):
        wrong = summarise(noise_run(2.0, 25.0, 1 + len(str(damaged)), requirements=damaged))
        assert wrong.verdicts == () and any("requirements of the recording cannot be read" in p for p in wrong.problems)
    given = [parse("prob(|APE| < 1 arcsec) >= 0.9 at 90 % confidence")]
    assert len(summarise(noise_run(2.0, 25.0, 99), requirements=given).verdicts) == 1
    none_applies = summarise(noise_run(2.0, 25.0, 77, loop="isolator", requirements=OF_TELESCOPE[2:]))
    assert none_applies.verdicts == () and none_applies.requirements_known


@pytest.mark.parametrize("n", [0, 1, 15])
def test_runs_too_short_for_anything(tmp_path, n: int) -> None:
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": np.zeros((n, 2))}))
    with pytest.raises(ValueError, match=r"at least two samples|longer than its start-up transient"):
        summarise(run)


def test_shorter_than_a_window_gives_the_ape_alone(tmp_path) -> None:
    run = Run.open(
        write_bag(tmp_path / "bag", {"truth/los": np.full((15, 2), MAS)}, parameters={"requirements": OF_TELESCOPE})
    )
    s = summarise(run, transient=0.0)
    assert s.ape_max == pytest.approx(math.sqrt(2) * 1e-3)
    assert math.isnan(s.rpe_rms)
    assert {v.status for v in s.verdicts} == {"not enough data", "not judged"}
    assert s.as_dict()["rpe_mas"] == dict.fromkeys(("rms", "p997", "windows_p997"))


def test_nan_in_the_truth_is_no_zero(tmp_path) -> None:
    los = MAS * np.random.default_rng(0).standard_normal((3000, 2))
    los[1500:1510] = np.nan
    run = Run.open(write_bag(tmp_path / "bag", {"truth/los": los}))
    s = summarise(run)
    assert s.windows_skipped == 1
    assert any("10 messages with NaN" in p for p in s.problems)
    blank = Run.open(write_bag(tmp_path / "blank", {"truth/los": np.full((3000, 2), np.nan)}))
    with pytest.raises(ValueError, match="must have finite samples"):
        summarise(blank)


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.95, 0.997])
def test_the_quantile_is_below_the_limit_exactly_where_the_limit_is_kept(probability: float) -> None:
    """Two of 500 windows above 40 mas are more than 0.3 %: no quantile of 38 mas may stand beside that verdict."""
    rng = np.random.default_rng(0)
    for size in (*range(1, 40), 500, 1000, 1999):
        values = rng.exponential(20 * MAS, size)
        for rank in {0, size // 2, size - 1, max(size - 2, 0), int(probability * size) % size}:
            limit = np.sort(values)[rank] * (1 + 1e-9) / MAS
            asked = parse(f"prob(rms RPE(20 ms) < {limit:.12g} mas) >= {probability} at 95 % confidence")
            verdict = requirements.decide(asked, values, float(size), 1.0)
            assert verdict.within_limit == (verdict.quantile.value < asked.limit), (size, rank)
