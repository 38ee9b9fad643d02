"""What a bag says to be proven of its loop: of the loop that proofs are about, and of no other."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.metadata import final_metadata, run_metadata
from los_testbed.run.proven_loop import ADMITTED, JUDGED, PROOF_BOUNDS, PROOF_KEYS, proof_of
from los_testbed.run.summary.local_proofs import confirmed, with_confirmed
from los_testbed.run.summary.summary import judged, remarks_of
from simple_telescope import SimpleTelescope
from support.forged_bags import with_metadata

from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise

SOURCE = '[[disturbance]]\nname = "cooler"\nkind = "cooler"\nplace = "bus"\nfrequency = 40.0\n'
SOURCE += "harmonics = [{ order = 1.0, force = [0.0, 0.0, 0.2] }]\n"
OTHER: list[tuple[dict[str, Any], str]] = [
    ({"camera_dropout": 0.95}, "camera_dropout is 0.95, proofs have 0"),
    ({"camera_rate": 25.0}, "camera_rate is 25, proofs have 50"),
    ({"nonlinear": True}, "nonlinear is on, proofs have off"),
    ({"fsm_authority": 0.001}, "fsm_authority is 0.001, proofs have the telescope's 0.0053"),
    ({"scenario": "ramp", "theta_rate": 0.01, "ramp_duration": 2.0}, "array angle or wheel speeds vary"),
    (
        {"plant": "simple_telescope:SimpleTelescope", "start": "rest"},
        "plant is simple_telescope:SimpleTelescope, proofs have none",
    ),
    ({"k_fsm": "my.laws:Observer", "start": "rest"}, "k_fsm is code: my.laws:Observer"),
    ({"disturbance_source": "my.code:Shaker"}, "other disturbances than the tones of the scenario act"),
]
SAME: list[dict[str, Any]] = [
    {},
    {"scenario": "unit_norm", "seed": 9, "theta": 0.7, "omega_1": 0.71},
    {"noise": False, "start": "rest", "mode": "lockstep", "loop": "fsm"},
    {"fsm_authority": 0.0053, "old_frames": "drop", "lost_samples": "hold", "hold_ticks": 3},
    {"disturbance_source": "my.code:Shaker", "disturbance": False},
    {"theta_rate": 0.01, "profile": "trapezoidal"},  # for no time
]


@pytest.mark.parametrize(("settings", "reason"), OTHER)
def test_another_loop_has_no_proof(settings: dict[str, Any], reason: str) -> None:
    """Neither a line nor a bound: the reason in their place."""
    base = {"mode": "inprocess", **settings}
    for loop in ("fsm", "fsm+pma"):
        parts = RunParts(RunConfig(**base, loop=loop))
        assert proof_of(parts) == {"proof": f"no proof of this run: {reason}"}


@pytest.mark.parametrize("settings", SAME)
def test_the_proven_loop_has_one(settings: dict[str, Any]) -> None:
    """Other members, tones, seeds and machines are those of the proof."""
    found = proof_of(RunParts(RunConfig(**settings)))
    others = settings.get("scenario", "worst_case") != "worst_case" and settings.get("disturbance", True)
    assert set(found) == set(PROOF_KEYS) - ({PROOF_BOUNDS} if others else set()), "bounds are for its tone of norm 1"
    assert found["proof"].startswith("proven for every telescope of the family")


def test_every_setting_is_admitted_judged_or_fixed() -> None:
    """A new setting is none that a proof admits, before somebody says so."""
    assert not ADMITTED & JUDGED and set(RunConfig.SETTINGS) > ADMITTED | JUDGED
    fixed = set(RunConfig.SETTINGS) - ADMITTED - JUDGED
    assert fixed == {"nonlinear", "plant", "device", "camera_rate", "camera_dropout"}


def test_disturbances_of_the_telescope_have_none(tmp_path: Path) -> None:
    """The hash of the parameters, which names the telescope of a proof, has no sources."""
    own = tmp_path / "own.toml"
    own.write_text(SOURCE, "utf-8")
    with_source, without = (proof_of(RunParts(RunConfig(parameters=str(own), disturbance=on))) for on in (True, False))
    assert with_source == {"proof": "no proof of this run: other disturbances than the tones of the scenario act"}
    assert without["proof"].startswith("proven")


CHANGED = '[{{"tick": 5, "name": "{}", "value": {}}}]'


@pytest.mark.parametrize(
    ("node", "values", "reason"),
    [
        ("plant", {"changes": CHANGED.format("camera_dropout", 0.5)}, "camera_dropout changed"),
        ("controller", {"changes": CHANGED.format("loop", '"fsm"')}, "loop changed"),
        ("estimator", {"changes": CHANGED.format("active", "false")}, "what was active changed"),
        ("plant", {"missed_ticks": "0", "ticks": "9"}, ""),
        ("plant", {"changes": CHANGED.format("noise", "false")}, ""),
        ("plant", {"changes": CHANGED.format("stop", "true")}, ""),
        ("plant", {"changes": "[1, 2"}, ""),
        ("plant", {"changes": "null"}, ""),
    ],
)
def test_what_happened_in_the_run_counts_at_its_end(node: str, values: dict[str, str], reason: str) -> None:
    """The head of the bag says what is proven of the run as it was asked for, the end of the run as it was."""
    parts = RunParts(RunConfig(mode="lockstep", start="rest"))
    assert run_metadata(parts)["proof"].startswith("proven")
    found = final_metadata(parts, {node: values})
    if reason:
        assert [found[key] for key in PROOF_KEYS] == [f"no proof of this run: {reason}", "", "", ""]
    else:
        assert found["proof"].startswith("proven")


def test_ticks_with_an_older_command_leave_the_bound_of_the_loop() -> None:
    """It says without what it is proven; there is no proof of the run."""
    parts = RunParts(RunConfig(mode="lockstep", start="rest"))
    found = final_metadata(parts, {"plant": {"missed_ticks": "3"}})
    assert found["proof"] == "no proof of this run: 3 ticks had an older command"
    assert not found["proof_noise"] and not found["proof_rpe"]
    bounds = json.loads(found[PROOF_BOUNDS])
    assert bounds["condition"] == "3 missed ticks" and bounds["window_s"] == 0.02
    assert json.loads(run_metadata(parts)[PROOF_BOUNDS]) == {**bounds, "condition": ""}


def test_bag_and_summary_say_the_reason(tmp_path: Path) -> None:
    """The line of the command, of the report and of its JSON is that of the bag."""
    run_in_process(RunConfig(duration=1.0, mode="inprocess", loop="fsm", camera_dropout=0.95), tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    remarks = remarks_of(run, summarise(run))
    assert "no proof of this run: camera_dropout is 0.95, proofs have 0" in remarks
    assert "proven" not in json.dumps(remarks)


@pytest.fixture(scope="module")
def proven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bag of a run of the loop that the shipped certificates are about."""
    path = tmp_path_factory.mktemp("proven") / "bag"
    run_in_process(RunConfig(duration=1.0, mode="inprocess"), path)
    return path


def shown(bag: Path) -> tuple[list[str], list[str]]:
    """Bounds in the table, and remarks on proofs."""
    found = judged([Run.open(bag)], None, None)
    words = ("proven", "proof", "stated in the bag")
    remarks = [text for text in found.remarks[0] if any(word in text for word in words)]
    return [row.bound_text for row in found.summaries[0].rows], remarks


def test_what_the_certificates_say_of_the_loop_in_the_bag_is_proven(proven: Path) -> None:
    assert confirmed(Run.open(proven)) == set(PROOF_KEYS)
    bounds, remarks = shown(proven)
    assert all("proven" in text and "stated in the bag" not in text for text in bounds)
    assert len(remarks) == 3 and all("proven" in text and "stated in the bag" not in text for text in remarks)


def test_forged_words_of_proof_are_not_shown_as_proven(proven: Path, tmp_path: Path) -> None:
    """Bounds of no size, with hash and chain made anew: nothing in the bag contradicts them."""
    bag = Path(shutil.copytree(proven, tmp_path / "bag"))
    bounds = {**Run.open(bag).parameters[PROOF_BOUNDS], "APE": [1e-9, 0.9999], "fast": [1e-9, 0.9999]}
    forged = {
        "proof": "proven for every telescope of the family: APE 0.001 of 10 arcsec",
        "proof_noise": "with noise, proven: APE 0.001 of 10 arcsec",
        "proof_rpe": json.dumps({"rms_rad": 1e-12, "exposure_s": 0.02}),
        PROOF_BOUNDS: json.dumps(bounds),
    }
    with_metadata(bag, **forged)
    assert not Run.open(bag).contradictions and confirmed(Run.open(bag)) == set()
    texts, remarks = shown(bag)
    assert all("proven" not in text and text.endswith("stated in the bag, not checked") for text in texts)
    assert len(remarks) == 3 and all(text.startswith("stated in the bag, not checked: ") for text in remarks)


def test_a_bound_that_the_record_is_far_above_is_not_of_its_loop(proven: Path) -> None:
    """Everything agrees but the line of sight, which is that of another run."""
    run = Run.open(proven)
    summary = summarise(run)
    assert all(one.proven is None or one.proven.checked for one in with_confirmed(run, summary).beside)
    above = [
        replace(v, quantile=replace(v.quantile, value=2.0 * one.proven.value)) if one.proven else v
        for v, one in zip(summary.verdicts, summary.beside)
    ]
    found = with_confirmed(run, replace(summary, verdicts=tuple(above)))
    assert any(one.proven for one in found.beside)
    assert not any(one.proven.checked for one in found.beside if one.proven)


@pytest.mark.parametrize(
    "change",
    [
        {"parameters_hash": "0123456789ab"},
        {"statistics": {"plant": {"ticks": "1000", "missed_ticks": "7"}}},
        {"statistics": {"controller": {"changes": '[{"name": "loop", "value": "fsm"}]'}}},
        {"loop": "isolator"},
        {"k_fsm": "my:Observer"},
    ],
    ids=str,
)
def test_words_of_proof_beside_another_run_are_not_confirmed(proven: Path, change: dict[str, Any]) -> None:
    """Another telescope, ticks with an older command, another stage, another plant."""
    run = Run.open(proven)
    assert confirmed(run.changed({**run.parameters, **change}, {})) == set()


def test_words_of_proof_are_not_confirmed_of_other_or_no_controllers_or_without_settings(
    proven: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Run.open(proven)
    law = json.loads(run.attachments["k_fsm.json"])
    law["D"] = (2.0 * np.array(law["D"])).tolist()
    assert confirmed(run.changed(run.parameters, {"k_fsm.json": json.dumps(law).encode()})) == set()
    for name in ("k_fsm.json", "run.yaml"):
        left = {key: data for key, data in run.attachments.items() if key != name}
        with monkeypatch.context() as patch:
            patch.setattr(Run, "attachments", property(lambda self, left=left: left))
            assert confirmed(run) == set()


def test_a_plant_of_a_program_has_none(tmp_path: Path) -> None:
    """`run_in_process` takes an object that no setting names."""
    run_in_process(RunConfig(duration=0.2, mode="inprocess"), tmp_path / "bag", plant=SimpleTelescope())
    found = Run.open(tmp_path / "bag").parameters
    assert found["proof"] == "no proof of this run: plant is an object of a program"
    assert not found["proof_rpe"] and not found["proof_noise"]
