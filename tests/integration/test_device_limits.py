"""The table of docs/your_spacecraft.md on the limits of devices is that of runs with the present controllers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from los_testbed.cli.app import main

from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise
from titop_plant.simulation import device_limits

PAGE = Path(__file__).parents[2] / "docs" / "your_spacecraft.md"
NO_QUANTISATION = {"acceleration_step": 0.0, "camera_step": 0.0, "gauge_step": 0.0}
NO_RATES = {"mirror_rate": float("inf"), "force_rate": float("inf"), "stroke": float("inf")}
LIMITS: dict[str, dict[str, float] | None] = {
    "linear": None,
    "`nonlinear=true`": {},
    "anti-alias filters only": {**NO_QUANTISATION, **NO_RATES},
    "rates and stroke only": {**NO_QUANTISATION, "cut_off": 0.0},
    "quantisation only": {**NO_RATES, "cut_off": 0.0},
}


def rows() -> list[tuple[str, str, float, float, str]]:
    found = re.findall(
        r"^\| `([\w+]+)`, (.*?) \| (.*?) arcsec \| (.*?) mas \| (.*?) \|$", PAGE.read_text("utf-8"), re.M
    )
    return [(loop, kind, float(ape), float(rpe), limit.strip("*")) for loop, kind, ape, rpe, limit in found]


def test_the_table_has_all_kinds() -> None:
    assert {kind for _, kind, *_ in rows()} == set(LIMITS)
    assert {loop for loop, *_ in rows()} == {"fsm", "fsm+pma"}


@pytest.mark.slow
@pytest.mark.parametrize("row", rows(), ids=lambda row: f"{row[0]}-{row[1]}")
def test_a_row_of_the_table(row: tuple[Any, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    loop, kind, ape, rpe, limit = row
    options = ["run", "--mode", "inprocess", "--duration", "30", "--loop", loop, "--no-report"]
    changed = LIMITS[kind]
    if changed is not None:
        limits = device_limits.DeviceLimits(**changed)
        monkeypatch.setattr(device_limits, "DeviceLimits", lambda: limits)
        options += ["--set", "nonlinear=true"]
    assert main([*options, "--output", str(tmp_path / "bag")]) == 0
    found = summarise(Run.open(tmp_path / "bag"))
    assert found.ape_p997 == pytest.approx(ape, rel=0.02)
    assert found.rpe_windows_p997 == pytest.approx(rpe, rel=0.02)
    kept = re.fullmatch(r"met|exceeded", limit).group()
    strictest = min((row for row in found.rows if "RPE" in row.quantity), key=lambda row: row.limit)
    assert (strictest.value < strictest.limit) == (kept == "met")
