"""The screen, the page and JSON say the same of every requirement: its own index, window, limit and verdict."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.requirement_outputs import outputs

from pointing_analysis.formatting.number_text import digits
from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.read.series import Series, series
from pointing_analysis.requirements.summary import performance_error, summarise
from pointing_analysis.requirements.verdict import Requirement, decide, index_samples, parse


def slow_and_fast(rate: float = 1000.0, seconds: float = 60.0, seed: int = 0) -> Series:
    """A slow tone of 300 mas, a drift of 30 mas/s, noise of 5 mas."""
    n = round(seconds * rate)
    t = np.arange(n) / rate
    xy = 5.0 * np.random.default_rng(seed).standard_normal((n, 2))
    xy[:, 0] += 300.0 * np.sin(2.0 * np.pi * 0.9 * t) + 30.0 * t
    return series(None, xy, unit="mas", rate=rate, name=f"run-{seed}")


LONG = (
    parse("prob(|RPE(250 ms)| < 100 mas) >= 0.997 at 95 % confidence", "long exposure"),
    parse("prob(|PDE(1 s, 10 s)| < 100 mas) >= 0.997 at 95 % confidence", "drift"),
)


def test_a_limit_judges_its_own_window(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows of 250 ms have several times the error of those of 20 ms: 100 mas is not kept, nor by the drift."""
    run = slow_and_fast()
    (table,), page, (metrics,) = outputs([run], LONG, tmp_path / "page.html", monkeypatch)
    samples = index_samples(performance_error(run, 0.0), LONG[0])
    own = decide(LONG[0], samples.values, samples.most, 60.0).quantile.value / RAD_PER_MAS
    assert own > 150.0 > 100.0 > summarise(run, requirements=()).rpe_windows_quantile
    assert metrics["window_s"] == 0.25
    assert [row[0] for row in table[:2]] == ["long exposure: |RPE(250 ms)|, 99.7 %", "drift: |PDE(1 s, 10 s)|, 99.7 %"]
    assert table[0][1:3] == [f"{digits(own)} mas", "100 mas"] and table[0][4] == "not compliant"
    assert table[1][2] == "100 mas" and table[1][4] == "not compliant"
    assert [row["Verdict"] for row in page] == ["not compliant", "not compliant"]
    beside = [row for row in table if row[0] == "RPE rms, 250 ms windows"]
    assert beside and all(row[2:] == ["", "", ""] for row in beside)  # a metric beside: no limit, no verdict
    assert not [row for row in table if "20 ms" in row[0]]


def drawn(rng: np.random.Generator) -> Requirement:
    """A requirement on any index, axis, window, probability, confidence and interpretation."""
    index = str(rng.choice(["APE", "MPE", "RPE", "PDE", "PRE"]))
    axis = str(rng.choice(["", "_x", "_y"]))
    window = str(rng.choice(["20 ms", "31.25 ms", "62.5 ms", "250 ms", "1 s", "30 s"]))
    times = {"APE": "", "PDE": f"({window}, {rng.choice(['0.5 s', '2 s'])})"}.get(index, f"({window})")
    rms = index == "RPE" and rng.random() < 0.5
    quantity = f"rms {index}{axis}{times}" if rms else f"|{index}{axis}{times}|"
    unit = str(rng.choice(["mas", "arcsec", "nrad"]))
    limit = 10.0 ** rng.uniform(0.0, 3.5) * {"mas": 1.0, "arcsec": 1e-3, "nrad": 4.848}[unit]
    p, c = rng.choice([0.5, 0.9, 0.95, 0.997]), rng.choice([60, 90, 95])
    kind = str(rng.choice(["temporal", "ensemble", "mixed"]))
    return parse(f"prob({quantity} < {limit:.4g} {unit}) >= {p:g} at {c} % confidence, {kind}", f"r{rng.integers(99)}")


def with_gaps(run: Series, rng: np.random.Generator) -> Series:
    """The run with some samples missing."""
    values = np.array(run["truth/los"].values[:, :2])
    values[rng.integers(len(values), size=3)] = np.nan
    return series(None, values, unit="rad", rate=1.0 / run["truth/los"].period, name=run.path.name)


def seen(row: dict[str, Any]) -> list[str]:
    """What the screen must say of a requirement, made from its JSON object."""
    unit = row["unit"]
    not_judged = row["status"] == "not judged"
    value = "–" if row["quantile"] is None else f"{digits(row['quantile'])} {unit}"
    why = "samples are missing" if row["missing"] != 0 else "record too short"
    bound = "–" if not_judged else f"not demonstrated: {why}"
    if row["upper_bound"] is not None:
        bound = f"{digits(row['upper_bound'])} {unit} at {100 * row['confidence']:g} %"
    note = "" if row["note"] in row["statement"] else row["note"]
    verdict = (": " if not_judged else "; ").join(filter(None, (row["statement"], note)))
    return [f"{row['name']}: {row['quantity']}", value, f"{row['limit']:g} {unit}", bound, verdict]


@pytest.mark.parametrize("seed", range(6))
def test_all_outputs_agree(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Random requirements, rates, gaps and numbers of runs: the three outputs row by row, and each on its own index."""
    rng = np.random.default_rng([28, seed])
    rate, count = float(rng.choice([64.0, 100.0, 512.0, 1000.0])), int(rng.integers(1, 4))
    runs = [slow_and_fast(rate, 8.0, 10 * seed + k) for k in range(count)]
    if rng.random() < 0.5:
        runs[0] = with_gaps(runs[0], rng)
    requirements = [drawn(rng) for _ in range(int(rng.integers(1, 7)))]
    tables, page, metrics = outputs(runs, requirements, tmp_path / "page.html", monkeypatch)
    rows = [row for one in metrics for row in one["requirements"]]
    assert [row["text"] for row in rows] == [str(r) for r in requirements] * count
    for table, one in zip(tables, metrics):
        assert table[: len(requirements)] == [seen(row) for row in one["requirements"]]
    shown = {(row.get("Run", runs[0].path.name), row["Requirement"], row["Limit"]): row for row in page}
    for run, one in zip(runs, metrics):
        for row, requirement in zip(one["requirements"], requirements):
            joint = count > 1 and requirement.across_runs
            label, value, limit, bound, verdict = seen(row)
            on_page = shown["all runs" if joint else run.path.name, label, limit]
            assert [on_page[head] for head in ("Value", "Limit", "Bound", "Verdict")] == [value, limit, bound, verdict]
    single = [r for r in requirements if not r.across_runs]
    assert len(page) == len({str(r) for r in requirements if r.across_runs and count > 1}) + (
        count * len(single) if count > 1 else len(requirements)
    )
