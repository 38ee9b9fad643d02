"""What runs are made of, wherever the files are; sources of a file act in campaigns and budgets, each with a row."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.campaign.dataset import Campaign, ResultFolder
from los_testbed.campaign.member import MemberEvaluator, source_columns
from los_testbed.campaign.sampling import MemberParameters, member_seeds, members
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.identity import identity, telescope_digest
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.summary.pointing_budget_sources import testbed_sources as sources_of_table
from los_testbed.run.summary.ran_loop import RanLoop
from los_testbed.run.summary.source_shares import source_shares

from los_design.copied_files import with_files_beside
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise
from titop_plant.telescope.load import load_telescope

COOLER = """
[[disturbance]]
name = "cooler"
kind = "cooler"
place = "payload"
frequency = 45.0
harmonics = [{{ order = 1, force = [{force}, 0.0, 0.1] }}]
"""
SHAKER = '[[disturbance]]\nname = "shaker"\nkind = "series"\nplace = "payload"\nfile = "shake.csv"\nrepeat = true\n'
SENSOR = '[[sensor]]\nname = "probe"\nplace = "bus"\nnoise = {noise}\n'
BROAD = "[reaction_wheel.broadband]\nfrequency = [1.0, 200.0]\nradial_force = [{noise}, 1e-9]\n"


def written(path: Path, text: str) -> str:
    """A parameter file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text('base = "reference"\n' + text, "utf-8")
    return str(path)


def shaken(folder: Path, force: float) -> str:
    """A parameter file with a source whose force is in a file beside it."""
    file = written(folder / "own.toml", SHAKER)
    t = np.arange(2000) / 1000.0
    rows = (f"{a:.3f},{b:.6f}\n" for a, b in zip(t, force * np.sin(2 * np.pi * 45.0 * t)))
    (folder / "shake.csv").write_text("time (s),Fx (N)\n" + "".join(rows), "utf-8")
    return file


@pytest.mark.parametrize(
    ("text", "values"),
    [
        (COOLER, ({"force": 0.2}, {"force": 20.0})),
        (SENSOR, ({"noise": 1e-4}, {"noise": 2e-4})),
        (BROAD, ({"noise": 1e-8}, {"noise": 2e-8})),
        ("[optics]\nwavelength = {wave}\n", ({"wave": 633e-9}, {"wave": 700e-9})),
    ],
)
def test_what_no_design_depends_on_is_in_the_digest(tmp_path: Path, text: str, values: Any) -> None:
    """The hash of the parameters does not have it."""
    one, other = (load_telescope(written(tmp_path / f"{i}.toml", text.format(**v))) for i, v in enumerate(values))
    assert one.parameters_hash == other.parameters_hash and telescope_digest(one) != telescope_digest(other)


def test_the_content_of_files_counts_and_their_place_does_not(tmp_path: Path) -> None:
    here, there, louder = (shaken(tmp_path / name, force) for name, force in (("a", 0.1), ("b", 0.1), ("c", 30.0)))
    digests = [telescope_digest(load_telescope(file)) for file in (here, there, louder)]
    assert digests[0] == digests[1] != digests[2]
    (tmp_path / "a" / "shake.csv").unlink()
    with pytest.raises(ValueError, match=r"cannot read .*shake\.csv: No such file"):
        telescope_digest(load_telescope(here))


def test_files_of_a_run_are_in_its_digests(tmp_path: Path) -> None:
    """Of sources that no telescope has, and of a profile."""
    alone = identity(RunConfig())
    assert set(alone) == {"version", "numpy", "scipy", "telescope", "k_fsm", "k_pma"}
    found = []
    for force in (0.1, 30.0):
        shaken(tmp_path, force)
        written(tmp_path / "ramp.csv", f"time,theta,w1,w2,w3,w4\n0,0,1,1,1,1\n{force},0,1,1,1,1\n")
        found.append(identity(RunConfig(disturbance_files=str(tmp_path / "shake.csv"))))
        found.append(identity(RunConfig(profile=str(tmp_path / "ramp.csv"))))
    assert [set(one) - set(alone) for one in found] == [{"disturbances"}, {"profile"}] * 2
    assert found[0] != found[2] and found[1] != found[3]


@pytest.mark.parametrize("make", [shaken, lambda folder, force: written(folder / "t.toml", COOLER.format(force=force))])
def test_a_campaign_does_not_go_on_with_another_disturbance(make: Any, tmp_path: Path) -> None:
    """A cooler of 20 N in place of one of 0.2 N, in the parameter file or in a file that it names."""

    def asked(force: float) -> Campaign:
        base = RunConfig(mode="inprocess", parameters=make(tmp_path / "t", force))
        return Campaign.of(base, "uniform", 3, 1, "time", identity(base))

    folder = ResultFolder(tmp_path / "c")
    folder.open(asked(0.2), False)
    assert folder.open(asked(0.2), True) == frozenset()
    with pytest.raises(ValueError, match=r"which holds another: telescope must be .* as there, got "):
        folder.open(asked(20.0), True)


def test_a_copy_with_its_files_is_the_same_telescope_anywhere(tmp_path: Path) -> None:
    """Two files of one name have two, one that is named twice is there once; without files the text stays."""
    file = Path(shaken(tmp_path / "t", 0.1))
    shaken(tmp_path / "t" / "below", 0.3)
    one, two = (SHAKER.replace('"shaker"', f'"{name}"') for name in ("first", "second"))
    file.write_text('base = "reference"\n' + SHAKER + one.replace("shake.csv", "below/shake.csv") + two, "utf-8")
    text, beside = with_files_beside(file)
    assert sorted(beside) == ["telescope_files/2-shake.csv", "telescope_files/shake.csv"]
    for name, content in itertools.chain([("telescope.toml", text.encode())], beside.items()):
        (tmp_path / "copy" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "copy" / name).write_bytes(content)
    copied, original = (RunParts(RunConfig(parameters=str(p))) for p in (tmp_path / "copy" / "telescope.toml", file))
    assert len(copied.sources) == len(original.sources) == 3
    assert telescope_digest(copied.telescope) == telescope_digest(original.telescope)
    plain = Path(written(tmp_path / "plain.toml", "# mine\n[isolator]\ndamping = 0.02\n"))
    assert with_files_beside(plain) == (plain.read_text("utf-8"), {})


REFERENCE = MemberParameters.of()

SOURCES = """
[[disturbance]]
name = "cooler"
kind = "cooler"
place = "payload"
frequency = 45.0
harmonics = [{order = 1, force = [2.0, 0.0, 1.0]}]

[[disturbance]]
name = "thruster pair"
kind = "pulses"
torque = [0.2, 0.0, 0.1]
period = 0.1
width = 0.05
"""

ROWS = ("cooler", "thruster pair")


@pytest.fixture
def base(tmp_path: Path) -> RunConfig:
    (tmp_path / "telescope.toml").write_text('base = "reference"\n' + SOURCES)
    parameters = str(tmp_path / "telescope.toml")
    return RunConfig(mode="inprocess", duration=1.2, loop="fsm", scenario="design", parameters=parameters)


@pytest.mark.further
def test_a_member_has_the_sources_of_its_run_and_a_row_for_each(base: RunConfig, tmp_path: Path) -> None:
    values = dict(zip(REFERENCE.columns, map(float, members("uniform", 1, 4)[0])))
    member = {**values, "seed": int(member_seeds(1, 4)[0])}
    row = MemberEvaluator.of(base).row(0, member, "time")
    assert row["status"] == "ok", row["reason"]
    run_in_process(replace(base, **REFERENCE.settings(member)), tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    summary = summarise(run)
    assert (row["ape_max_arcsec"], row["rpe_rms_mas"]) == (summary.ape_max, summary.rpe_rms)
    shares = [share for share in source_shares(RanLoop.of(run)) if share.name in ROWS]
    assert [share.name for share in shares] == list(ROWS)
    for share in shares:
        assert [row[name] for name in source_columns(share.name)] == [share.ape, share.rpe]
    quiet = MemberEvaluator.of(replace(base, parameters=None)).row(0, member, "time")
    assert row["rpe_rms_mas"] > 1.05 * quiet["rpe_rms_mas"], "they act"
    assert not any(name.startswith("source_") for name in quiet)


@pytest.mark.further
def test_a_budget_has_a_source_for_each(base: RunConfig, tmp_path: Path) -> None:
    table = {"loop": "fsm", "part": "sources", "settings": {"parameters": base.parameters, "duration": base.duration}}
    found = sources_of_table(("loop",), table, np.pi / 648e6)
    assert [source.path for source in found] == [("loop", name) for name in ROWS]
    run_in_process(replace(base, scenario="imbalance"), tmp_path / "bag")
    shares = [share for share in source_shares(RanLoop.of(Run.open(tmp_path / "bag"))) if share.name in ROWS]
    for source, share in zip(found, shares, strict=True):
        assert np.linalg.norm(source.sigma(0.02)) == pytest.approx(share.rpe, rel=1e-3)
    every = {s.name for s in sources_of_table(("loop",), {**table, "part": "all"}, 1.0)}
    assert every > {"loop / cooler"} and not any("tone" in name for name in every), "its sources alone"
    asked = {s.name for s in sources_of_table(("loop",), {**table, "part": "all", "scenario": "design"}, 1.0)}
    assert any("tone" in name for name in asked)
