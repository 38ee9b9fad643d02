"""Files that version 0.1 wrote are read as it read them, and its options are there or name what takes their place.

``fixtures/files_of_0_1`` was written by the program of commit c2c48f9e, the last of 0.1.0:

==========================  ==========================================================================================
``k_fsm.json, k_pma.json``  shipped there as ``k_fsm_implemented_nominal.json`` and ``k_pma_implemented_nominal.json``
``telescope.toml``          limits in ``[weights]``, as files had them before ``[[requirement]]``
``whole_telescope.toml``    ``reference.toml`` of that version, which users copy and change
``run.yaml``                parameters of a run, ``config/run.yaml`` of the ROS package
``bag``, ``run.json``       ``run --mode inprocess --duration 0.1 --k-fsm k_fsm.json --k-pma k_pma.json --parameters
                            telescope.toml --seed 3 --output bag --no-report --json``, and its JSON
``campaign``                ``campaign --samples 2 --duration 0.2 --workers 1 --k-fsm k_fsm.json --k-pma k_pma.json
                            --output campaign``, without its page
``designs``                 ``design all --nominal --effort short --time-limit 150 --workers 1 --parameters
                            telescope.toml --output designs``
``options.json``            options of each command
==========================  ==========================================================================================
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign.dataset import Campaign, ResultFolder, read_manifest
from los_testbed.campaign.member import MemberEvaluator
from los_testbed.cli.command_group import ENTRIES, loaded
from los_testbed.cli.designs.folders import designs_in
from los_testbed.config.run_config import RunConfig
from los_testbed.config.run_settings import of_designs
from los_testbed.parts.run_parts import RunParts
from support.command_line import CommandLine

from los_design.search.worst_points import load_worst_points
from pointing_analysis.read.run import Run
from titop_plant.telescope.load import load_telescope

pytestmark = pytest.mark.usefixtures("without_pictures")

OLDER = Path(__file__).parents[1] / "fixtures" / "files_of_0_1"
TOLD: dict[str, Any] = json.loads((OLDER / "run.json").read_text("utf-8"))
"""What 0.1 said of its run, six digits of each figure."""
ARCSEC, MAS = np.pi / 180 / 3600, np.pi / 180 / 3600e3
OWN_HASH = "acae87c1dd00"
"""``parameters_hash`` of ``telescope.toml`` in 0.1; it stands in the bag and in the designs."""
RUN = ["--mode=inprocess", "--no-report", "--json", "--output=new"]
SUCCESSORS = {
    ("analyse", "--report"): "now --output",
    ("report", "--start"): "now --from",
    ("report", "--stop"): "now --to",
    ("stages", "--keep"): "now --keep-all",
    ("design k-fsm", "--starts"): "an option of design k-pma",
    ("design certify", "--wall-limit"): "now --time-limit",
    ("design certify", "folder"): "now --designs FOLDER",
    ("design verify", "folder"): "now --designs FOLDER",
}
"""Options that a command has no more, and what the message about each one names."""


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> CommandLine:
    """The command line in a folder with copies of the files."""
    found = CommandLine.below(tmp_path, monkeypatch, capsys)
    shutil.copytree(OLDER, found.here, dirs_exist_ok=True)
    return found


def summary_of(command: CommandLine, *arguments: str) -> dict[str, Any]:
    code, out, err = command(*arguments)
    assert code == 0, err
    found: dict[str, Any] = json.loads(out.splitlines()[-1])
    return found


def figures(found: dict[str, Any]) -> dict[str, Any]:
    """Those of a summary that do not depend on limits or on the fit of tones, which takes no drift for them since."""
    names = ("ticks", "transient_s", "windows", "windows_skipped", "samples_lost", "camera_dropped", "missed_ticks")
    single = {name: found[name] for name in names}
    tables = ("ape_arcsec", "rpe_mas", "knowledge")
    return single | {f"{table} {name}": value for table in tables for name, value in found[table].items()}


def limits(file: Path) -> list[float]:
    return [requirement.limit for requirement in load_telescope(file).requirements]


def test_controllers_run_as_they_did(command: CommandLine) -> None:
    """The same loop again: all figures of the run of 0.1."""
    given = ["--duration=0.1", "--k-fsm=k_fsm.json", "--k-pma=k_pma.json", "--parameters=telescope.toml", "--seed=3"]
    assert figures(summary_of(command, "run", *RUN, *given)) == pytest.approx(figures(TOLD), rel=1e-5)
    older, run = Run.open(OLDER / "bag"), Run.open("new")
    assert np.all(np.isfinite(run["truth/los"].values)) and len(run["truth/los"].values) == 100
    np.testing.assert_allclose(run["truth/los"].values, older["truth/los"].values, rtol=1e-6, atol=1e-15)


def test_a_bag_has_the_figures_that_were_told(command: CommandLine) -> None:
    found = summary_of(command, "analyse", "bag", "--json")
    assert figures(found) == pytest.approx(figures(TOLD), rel=1e-5)
    assert [r["text"] for r in found["requirements"]] == [r["text"] for r in TOLD["requirements"]]
    assert [r["quantile"] for r in found["requirements"]] == [r["quantile"] for r in TOLD["requirements"]]
    assert found["contradictions"] == [] and found["problems"] == []
    unproven, requirements = found["remarks"]
    assert unproven.startswith("no proof of this run: ") and requirements.startswith("the bag holds no requirements")


def test_a_bag_is_whole_and_is_replayed(command: CommandLine) -> None:
    """The estimates are those recorded but for the order of additions."""
    assert command("bag", "verify", "bag")[0] == 0
    _, out, _ = command("replay", "bag", "--json")
    found = json.loads(out.splitlines()[-1])
    assert found["recorded"] == found["replayed"] and found["incomplete_ticks"] == 0
    assert [row["compared"] for row in found["differences"]] == [100, 100, 100]
    assert max(row["largest"] for row in found["differences"]) < 1e-14


def test_a_copy_of_the_whole_reference_is_the_reference(tmp_path: Path) -> None:
    """That of 0.1 and today's: the file of a user may hold every key, with the value of the reference."""
    reference = load_telescope()
    today = tmp_path / "telescope.toml"
    today.write_bytes((Path(load_telescope.__code__.co_filename).parent / "reference.toml").read_bytes())
    for file in (OLDER / "whole_telescope.toml", today):
        found = load_telescope(file)
        assert (found.parameters_hash, found.requirements) == (reference.parameters_hash, reference.requirements)


def test_a_folder_of_designs_is_read_and_runs(command: CommandLine) -> None:
    telescope, k_fsm, k_pma = designs_in(Path("designs"))
    assert telescope.parameters_hash == OWN_HASH
    assert [port.name for law in (k_fsm, k_pma) for port in law.outputs] == ["los_estimate", "pma_force"]
    points = load_worst_points(Path("designs"))
    assert sorted(points) == ["fsm", "fsm+pma", "isolator", "none"]
    assert RunParts(RunConfig.from_mapping(of_designs("designs"))).check() == (), "no warning"
    told = summary_of(command, "run", *RUN, "--duration=0.1", "--designs=designs")
    assert np.all(np.isfinite(Run.open("new")["truth/los"].values))
    assert [row["limit"] for row in told["requirements"][:3]] == [5.0, 200.0, 80.0]


def test_a_campaign_goes_on(command: CommandLine) -> None:
    """Its members are computed again, as a column has come; their figures are those of 0.1."""
    pyarrow = pytest.importorskip("pyarrow.parquet")
    names = ["index", "seed", "ape_p997_arcsec", "rpe_rms_mas", "rpe_window_p997_mas", "rke_rms_mas"]
    older = pyarrow.read_table(OLDER / "campaign/rows/part-0000000.parquet", columns=names).to_pylist()
    results, told = ResultFolder(Path("campaign")), read_manifest(Path("campaign"))
    base = RunConfig.from_mapping(told["run"])
    asked = Campaign.of(base, told["sampling"], told["samples"], told["seed"], told["depth"], told["identity"])
    assert asked.points_hash == told["points_hash"]
    done, evaluator = results.open(asked, True), MemberEvaluator.of(base)
    assert done == frozenset()
    for number, chunk in asked.chunks(done):
        results.write(number, evaluator.rows(chunk, told["depth"]))
    assert results.table(["status"]).column("status").to_pylist() == ["ok", "ok"]
    for row, before in zip(results.table(names).to_pylist(), older, strict=True):
        assert row == pytest.approx(before, rel=1e-6)


def options_of_today() -> Iterator[tuple[str, set[str]]]:
    """Commands with the options that each one takes."""
    waiting = [(name, loaded(name)) for name in ENTRIES]
    while waiting:
        name, found = waiting.pop()
        if hasattr(found, "commands"):
            waiting += [(f"{name} {below}", one) for below, one in found.commands.items()]
        else:
            shown = [p for p in found.params if not getattr(p, "hidden", False)]
            yield name, {option for p in shown for option in (*p.opts, *p.secondary_opts)}


def test_options_are_there_or_name_their_successor(command: CommandLine) -> None:
    older, today = json.loads((OLDER / "options.json").read_text("utf-8")), dict(options_of_today())
    gone = {(name, option) for name, options in older.items() for option in set(options) - today[name]}
    assert gone == set(SUCCESSORS) and len(older) > 20
    for (name, option), successor in SUCCESSORS.items():
        given = (option, "2") if option.startswith("--") else ("designs",)
        code, _, err = command(*name.split(), *given, "--output=x.json")
        assert code == 2 and f"{option} is {successor}" in err
