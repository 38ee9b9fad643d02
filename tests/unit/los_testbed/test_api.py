"""The Python interface gives what the command line gives, from the same settings."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.api import analyse, campaign, run
from support.command_line import call_command

from lftkit.systems.sampled.sampled_system import SampledSystem
from pointing_analysis.indices.errors import performance_error
from titop_plant.interface import DT, K_PMA_INPUTS, K_PMA_OUTPUTS

SMALL = Path(__file__).parents[3] / "examples" / "spacecraft" / "small_telescope.toml"


def test_a_run_and_its_analysis_are_those_of_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings = {
        "duration": 1.04,
        "loop": "isolator",
        "scenario": "imbalance",
        "seed": 5,
        "wheel_speed": (300, 310, 320, 330),
    }
    result = run(tmp_path / "api", **settings)  # type: ignore[arg-type]
    words = ["--duration", "1.04", "--loop", "isolator", "--scenario", "imbalance", "--seed", "5"]
    words += ["--wheel-speed", "300", "310", "320", "330", "--mode", "inprocess"]
    code, out, err = call_command(capsys, "run", *words, "--no-report", "--json", "--output", str(tmp_path / "command"))
    assert code == 0, err
    same = {**json.loads(out.splitlines()[-1]), "bag": str(tmp_path / "api")}
    assert json.loads(json.dumps(result.values)) == same
    again = analyse(tmp_path / "command")
    assert again.verdict == result.verdict and again.requirements == result.requirements
    assert f"{result.summary.rows[0].limit_text}" in result._repr_html_()


class WorkError(Exception):
    """What is checked before the work is over."""


@pytest.mark.parametrize("by", ["api", "command"])
def test_a_campaign_says_of_its_controllers_what_its_command_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    """For another telescope than theirs, and with nothing for the proof-mass actuators to do."""

    def work(*arguments: Any) -> None:
        raise WorkError

    still = SampledSystem([], [], [], np.zeros((6, 6)), K_PMA_INPUTS, K_PMA_OUTPUTS, DT)
    (tmp_path / "k_pma.json").write_text(still.to_json())
    (tmp_path / "mine.toml").write_text("base = 'reference'\n[isolator]\nmass = 1.6\n")
    monkeypatch.setattr("los_testbed.campaign.execution.check_cluster", work)
    files = {"parameters": str(tmp_path / "mine.toml"), "k_pma": str(tmp_path / "k_pma.json")}
    if by == "api":
        with pytest.raises(WorkError):
            campaign(tmp_path / "rows", samples=2, **files)
        said = capsys.readouterr().err
    else:
        words = [f"--{name.replace('_', '-')}={file}" for name, file in files.items()]
        _, _, said = call_command(capsys, "campaign", "--samples=2", f"--output={tmp_path / 'rows'}", *words)
    lines = [line for line in said.splitlines() if line.startswith("warning: ")]
    assert len(lines) == 2 and " was designed for parameters_hash" in lines[0]
    assert lines[1] == "warning: in the stage fsm+pma nothing drives the proof-mass actuators"


@pytest.mark.further
@pytest.mark.usefixtures("without_pictures")
def test_values_of_a_result_are_tables_and_arrays(tmp_path: Path) -> None:
    pandas, xarray = pytest.importorskip("pandas"), pytest.importorskip("xarray")
    result = run(tmp_path / "bag", duration=1.04, loop="isolator", scenario="design", report=True)
    table, data = result.to_pandas(), result.to_xarray()
    assert isinstance(table, pandas.DataFrame) and list(table["verdict"]) == [r["status"] for r in result.requirements]
    assert isinstance(data, xarray.Dataset)
    error = performance_error(result.recording, 0.0)
    np.testing.assert_array_equal(data["los_error"].values, error.values)
    assert float(data["time"][1] - data["time"][0]) == pytest.approx(1e-3) and data["los_error"].attrs["units"] == "rad"
    assert (tmp_path / "bag" / "report.html").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("happened", "code"),
    [
        ({"interrupted": True}, 130),
        ({"bag": None, "interrupted": True}, 130),
        ({"failures": ["estimator: ended"]}, None),
    ],
)
def test_what_the_nodes_report_is_raised_or_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, happened: dict[str, Any], code: int | None
) -> None:
    """The bag is the one that they wrote: a plant that was started again begins another one."""
    from los_testbed.run import runner
    from los_testbed.run.results import Results, RunError

    settings = {"duration": 1.04, "loop": "isolator", "scenario": "none"}
    run(tmp_path / "other", **settings)  # type: ignore[arg-type]
    results = Results(**{"bag": tmp_path / "other", **happened})
    monkeypatch.setattr(runner.Runner, "run", lambda self: results)
    if code is None:
        found = run(tmp_path / "bag", mode="lockstep", **settings)  # type: ignore[arg-type]
        assert found.path == tmp_path / "other" and found.remarks[0] == "estimator: ended"
        return
    with pytest.raises(RunError) as raised:
        run(tmp_path / "bag", mode="lockstep", **settings)  # type: ignore[arg-type]
    assert raised.value.code == code


def test_rows_of_a_campaign_are_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a cluster within this process."""
    distributed = pytest.importorskip("distributed")
    within = partial(distributed.Client, processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None)
    monkeypatch.setattr("los_testbed.campaign.execution.cluster", lambda *_: within())
    pandas = pytest.importorskip("pandas")
    given = {"samples": 3, "workers": 1, "loop": "isolator", "duration": 1.04, "parameters": SMALL}
    found = campaign(tmp_path / "rows", **given)  # type: ignore[arg-type]
    table = found.to_pandas()
    assert isinstance(table, pandas.DataFrame) and list(table["status"]) == ["ok"] * 3
    assert table["rpe_rms_mas"].max() == pytest.approx(found.summary["metrics"]["rpe_rms_mas"]["q1"], rel=1e-5)
    with pytest.raises(ValueError, match="output must be a new folder"):
        campaign(tmp_path / "rows", **given)  # type: ignore[arg-type]
    assert campaign(tmp_path / "rows", resume=True, **given).summary["rows_hash"] == found.summary["rows_hash"]  # type: ignore[arg-type]
