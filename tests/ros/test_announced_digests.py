"""What is said of a run rests on what its nodes announce and send, and not on the settings of the recorder."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.identity import DIGEST, announced
from los_testbed.run.processes.node_launch import environment, node_command, parameter_file, ros_arguments
from los_testbed.run.runner import Runner
from los_testbed.run.summary.ran_loop import RanLoop
from los_testbed.run.summary.summary import judged
from ros_runs import PLANT, live_nodes, private_domain

from lftkit.systems.sampled.sampled_system import SampledSystem
from pointing_analysis.read.run import Run

ZEROS = [sys.executable, str(Path(__file__).parents[1] / "support/zero_estimator.py")]
UNPROVEN = "no proof of this run"


def config_of(folder: Path, **values: Any) -> RunConfig:
    """The telescope in lockstep, with the shipped controllers."""
    base = {"duration": 0.6, "mode": "lockstep", "domain": private_domain(), "output": str(folder / "bag")}
    return RunConfig(**{**base, "wait_for_recorder": True, **values})


def said_of(run: Run) -> tuple[set[str], list[str]]:
    """Bounds in the table and remarks on proofs."""
    found = judged([run], None, None)
    remarks = [text for text in found.remarks[0] if "proof" in text or "proven" in text]
    return {row.bound_text for row in found.summaries[0].rows}, remarks


@pytest.mark.parametrize("processes", ["composed", "separate"])
def test_nodes_announce_what_the_bag_holds(tmp_path: Path, processes: str) -> None:
    config = config_of(tmp_path, processes=processes)
    run = Run.open(Runner(config).run().bag)
    own = announced(RunParts(config))
    assert {node: run.parameters["statistics"][node][DIGEST] for node in own} == own
    assert run.parameters["plant_hash"] == own["plant"] and run.parameters["member"]
    bounds, remarks = said_of(run)
    assert all(text.endswith(", proven (99.7 %)") for text in bounds) and len(remarks) == 3


def test_a_plain_node_in_the_place_of_an_observer_leaves_nothing_proven(tmp_path: Path) -> None:
    run = Run.open(Runner(config_of(tmp_path), commands={"estimator": ZEROS}).run().bag)
    assert not run["los_estimate"].values[:, :2].any() and "k_fsm.json" in run.attachments
    bounds, remarks = said_of(run)
    assert bounds == {UNPROVEN}
    assert remarks == [f"{UNPROVEN}: the node estimator announced no digest of what it ran"]


def test_a_plant_of_a_program_leaves_no_word_of_the_telescope(tmp_path: Path) -> None:
    """Neither its member nor its noise, though the recorder has the settings of one."""
    run = Run.open(Runner(config_of(tmp_path), commands={"plant": PLANT}).run().bag)
    assert not {"acting", "member", "plant_hash"} & set(run.parameters)
    assert not any(sensor["noise"] for sensor in run.parameters["sensors"])
    assert RanLoop.of(run).unknown == "the node plant announced no digest of what it ran"


@pytest.mark.parametrize(("name", "value"), [("stage", "fsm"), ("pma_authority", 0.01)])
def test_changes_of_the_laws_during_a_run_are_replayed(tmp_path: Path, name: str, value: Any) -> None:
    fault = {"name": name, "value": value, "at": 0.2}
    parameters = tmp_path / "fault.yaml"
    parameters.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"fault": json.dumps(fault)}}}))
    command = [*node_command("controller"), "--ros-args", "--params-file", str(parameters)]
    run = Run.open(Runner(config_of(tmp_path), commands={"controller": command}).run().bag)
    changed = json.loads(run.parameters["statistics"]["controller"]["changes"])
    assert [(row["tick"], row["value"]) for row in changed] == [(200, value)]
    loop = RanLoop.of(run)
    assert not loop.unknown and not loop.differs
    assert loop.against_proof() == [f"{changed[0]['name']} changed"]
    unchanged = {
        **run.parameters["statistics"],
        "controller": {DIGEST: loop.run.parameters["statistics"]["controller"][DIGEST]},
    }
    other = RanLoop.of(run.changed({**run.parameters, "statistics": unchanged}, {}))
    assert "is not that of the controllers in the bag on" in other.differs


def recording(folder: Path, config: RunConfig) -> subprocess.CompletedProcess[str]:
    """A recorder of its own, as `run --only recorder` starts it, until it ends."""
    parameter_file(config, folder / "recorder.yaml")
    command = [*node_command("recorder"), *ros_arguments(config.namespace, folder / "recorder.yaml")]
    return subprocess.run(command, env=environment(config.domain), capture_output=True, text=True, timeout=300)


def test_a_recorder_with_other_controllers_than_the_nodes_is_refused(tmp_path: Path) -> None:
    """As on several hosts, where an option is forgotten: it would write its own controllers into the bag."""
    law = RunParts(RunConfig()).models["k_fsm"]
    assert isinstance(law, SampledSystem)
    replace(law, D=1.5 * np.array(law.D)).to_file(tmp_path / "mine.json")
    config = config_of(tmp_path, start="rest", scenario="imbalance")
    mine = replace(config, k_fsm=str(tmp_path / "mine.json"))
    digests = [announced(RunParts(one))["estimator"] for one in (mine, config)]
    with live_nodes(mine, tmp_path, "estimator"):
        done = recording(tmp_path, config)
    assert done.returncode == 2 and not (tmp_path / "bag").exists()
    assert done.stderr.strip() == (
        f"los_testbed recorder: the settings of the recorder must be those of the node estimator, whose digest is "
        f"{digests[0]}, got {digests[1]}: give both the same options"
    )
