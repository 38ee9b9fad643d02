"""What is said to be proven of a run: of the loop that its record shows to have run, and of no other."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from los_testbed.bags.writer import BagWriter
from los_testbed.cli import app
from los_testbed.config.run_config import RunConfig
from los_testbed.parts.run_parts import RunParts
from los_testbed.run.loop.simulate import run_in_process
from los_testbed.run.proven_loop import ADMITTED, JUDGED, bounds_of, proof_of, reasons_against
from los_testbed.run.replay import write_signals
from los_testbed.run.summary.loop_proof import NONE_AT_HAND, with_proof
from los_testbed.run.summary.ran_loop import RanLoop
from los_testbed.run.summary.summary import judged
from mcap.reader import make_reader
from mcap.writer import Writer
from simple_telescope import SimpleTelescope

from los_design.verification.subject import BUNDLE
from los_estimator.runtime import LosEstimator
from pointing_analysis.read.run import Run
from pointing_analysis.requirements.summary import summarise
from pointing_analysis.units import RAD_PER_MAS

SOURCE = '[[disturbance]]\nname = "cooler"\nkind = "cooler"\nplace = "bus"\nfrequency = 40.0\n'
SOURCE += "harmonics = [{ order = 1.0, force = [0.0, 0.0, 0.2] }]\n"
SOURCES_ACT = "other disturbances than the tones of the scenario act"
OTHER: list[tuple[dict[str, Any], str]] = [
    ({"camera_dropout": 0.95}, "camera_dropout is 0.95, proofs have 0"),
    ({"camera_rate": 25.0}, "camera_rate is 25, proofs have the telescope's 50"),
    ({"nonlinear": True}, "nonlinear is on, proofs have off"),
    ({"fsm_authority": 0.001}, "fsm_authority is 0.001, proofs have the telescope's 0.0053"),
    ({"scenario": "ramp", "theta_rate": 0.01, "ramp_duration": 2.0}, "array angle or wheel speeds vary"),
    (
        {"plant": "simple_telescope:SimpleTelescope", "start": "rest"},
        "plant is simple_telescope:SimpleTelescope, proofs have none",
    ),
    ({"disturbance_source": "my.code:Shaker"}, SOURCES_ACT),
    ({"start": "rest"}, "the run starts at rest, proofs are of the steady state"),
]
SAME: list[dict[str, Any]] = [
    {},
    {"scenario": "unit_norm", "seed": 9, "theta": 0.7, "omega_1": 0.71},
    {"noise": False, "mode": "lockstep", "loop": "fsm"},
    {"fsm_authority": 0.0053, "old_frames": "drop", "lost_samples": "hold", "hold_ticks": 3},
    {"disturbance_source": "my.code:Shaker", "disturbance": False},
    {"theta_rate": 0.01, "profile": "trapezoidal"},  # for no time
]


@pytest.mark.parametrize(("settings", "reason"), OTHER)
def test_another_loop_has_no_proof(settings: dict[str, Any], reason: str) -> None:
    base = {"mode": "inprocess", **settings}
    for loop in ("fsm", "fsm+pma"):
        assert reasons_against(RunParts(RunConfig(**base, loop=loop))) == [reason]


@pytest.mark.parametrize("settings", SAME)
def test_the_proven_loop_has_one(settings: dict[str, Any]) -> None:
    """Other members, tones, seeds and machines are those of the proof; bounds are for its tone of norm 1."""
    parts = RunParts(RunConfig(**settings))
    assert not reasons_against(parts)
    found = proof_of(parts)
    assert found is not None and found.text.startswith("proven for every telescope of the family")
    others = settings.get("scenario", "worst_case") != "worst_case" and settings.get("disturbance", True)
    assert (bounds_of(parts, found) is None) == others


@pytest.mark.parametrize(
    ("settings", "tone"),
    [({"worst_of": "fast"}, "fast tone"), ({"worst_of": "slow"}, "slow tone"), ({"disturbance": False}, "both")],
)
def test_the_bound_is_that_of_the_tone_that_acts(settings: dict[str, Any], tone: str) -> None:
    parts = RunParts(RunConfig(**settings))
    found = proof_of(parts)
    assert found is not None
    bounds = bounds_of(parts, found)
    assert bounds is not None and bounds.relative is not None
    (stated,) = (re.findall(r"[\d.]+", text)[0] for text in found.with_noise if text.startswith(tone))
    assert bounds.relative.value == pytest.approx(float(stated) * RAD_PER_MAS, rel=1e-4)


def test_every_setting_is_admitted_judged_or_fixed() -> None:
    """A new setting is none that a proof admits, before somebody says so."""
    assert not ADMITTED & JUDGED and set(RunConfig.SETTINGS) > ADMITTED | JUDGED
    fixed = set(RunConfig.SETTINGS) - ADMITTED - JUDGED
    assert fixed == {"nonlinear", "plant", "device", "camera_dropout"}


def test_disturbances_of_the_telescope_have_none(tmp_path: Path) -> None:
    """The hash of the parameters, which names the telescope of a proof, has no sources."""
    own = tmp_path / "own.toml"
    own.write_text('base = "reference"\n' + SOURCE, "utf-8")
    found = [reasons_against(RunParts(RunConfig(parameters=str(own), disturbance=on))) for on in (True, False)]
    assert found == [[SOURCES_ACT], []]


@pytest.fixture(scope="module")
def proven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bag of a run of the loop that the shipped certificates are about."""
    path = tmp_path_factory.mktemp("proven") / "bag"
    run_in_process(RunConfig(duration=1.0, mode="inprocess"), path)
    return path


def shown(run: Run) -> tuple[list[str], list[str]]:
    """Bounds in the table, and remarks on proofs."""
    found = judged([run], None, None)
    remarks = [text for text in found.remarks[0] if "proven" in text or "proof" in text]
    return [row.bound_text for row in found.summaries[0].rows], remarks


def unproven(run: Run) -> str:
    """Why nothing is proven of a run, where every row and the only remark say so."""
    bounds, remarks = shown(run)
    assert bounds and set(bounds) <= {"no proof of this run", "not demonstrated: samples are missing", "–"}
    (remark,) = remarks
    assert remark.startswith("no proof of this run: ")
    return remark.removeprefix("no proof of this run: ")


def test_a_run_of_the_proven_loop_has_a_proof_in_each_row_and_line(proven: Path) -> None:
    bounds, remarks = shown(Run.open(proven))
    assert all(text.endswith(", proven (99.7 %)") for text in bounds)
    assert len(remarks) == 3 and all("proven" in text and "no proof" not in text for text in remarks)


def rerecorded(
    proven: Path, target: Path, change: Callable[[dict[str, tuple[Any, Any]]], None], **statistics: dict[str, str]
) -> Run:
    """A bag that says what that of the proven run does, of other signals or statistics: with all hashes made anew."""
    run = Run.open(proven)
    signals = {name: (run[name].stamp.copy(), run[name].values.copy()) for name in run.topics}
    change(signals)
    kept = {node: {**run.parameters["statistics"].get(node, {}), **own} for node, own in statistics.items()}
    parameters = {**run.parameters, "statistics": {**run.parameters["statistics"], **kept}}
    text = {key: value if isinstance(value, str) else json.dumps(value) for key, value in parameters.items()}
    files = {name: ("application/json", data) for name, data in run.attachments.items()}
    with BagWriter(target, {"los_testbed": text}, files) as bag:
        write_signals(bag, signals)
    return Run.open(target)


def of_zeros(signals: dict[str, tuple[Any, Any]]) -> None:
    for name in ("los_estimate", "fsm/command"):
        signals[name][1][:] = 0.0


def scaled_by(factor: float, name: str) -> Callable[[dict[str, tuple[Any, Any]]], None]:
    def change(signals: dict[str, tuple[Any, Any]]) -> None:
        signals[name][1][500:] *= factor

    return change


def without(name: str, rows: slice) -> Callable[[dict[str, tuple[Any, Any]]], None]:
    def change(signals: dict[str, tuple[Any, Any]]) -> None:
        stamps, values = signals[name]
        kept = np.ones(len(stamps), bool)
        kept[rows] = False
        signals[name] = stamps[kept], values[kept]

    return change


def cut(rows: slice) -> Callable[[dict[str, tuple[Any, Any]]], None]:
    def change(signals: dict[str, tuple[Any, Any]]) -> None:
        every = signals["truth/los"][0]
        first, last = every[rows][0], every[rows][-1]
        for name, (stamps, values) in signals.items():
            kept = (stamps >= first) & (stamps <= last)
            signals[name] = stamps[kept], values[kept]

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (of_zeros, "los_estimate is not that of the controllers in the bag on"),
        (scaled_by(1.0 + 1e-6, "los_estimate"), "los_estimate is not that of the controllers in the bag on 500 of"),
        (scaled_by(np.nan, "los_estimate"), "los_estimate is not that of the controllers in the bag on 500 of"),
        (scaled_by(1.0 + 1e-6, "fsm/command"), "fsm/command is not that of the controllers in the bag on 500 of"),
        (scaled_by(1.0 + 1e-6, "pma/command"), "pma/command is not that of the controllers in the bag on 500 of"),
        (without("fsm/command", slice(None)), "fsm/command is not recorded on each tick"),
        (without("pma/command", slice(7, 8)), "pma/command is not recorded on each tick"),
        (without("los_estimate", slice(500, None)), "los_estimate is not recorded on each tick"),
        (cut(slice(0, 500)), "500 of the 1000 ticks of the run are recorded"),
        (cut(slice(20, None)), "980 of the 1000 ticks of the run are recorded"),
        (without("isolator/accel", slice(None)), "the sensors must have common stamps"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_signals_that_are_not_those_of_the_laws_have_no_proof(
    proven: Path, tmp_path: Path, change: Callable[[dict[str, tuple[Any, Any]]], None], words: str
) -> None:
    """Everything else in the bag says that it is the proven loop."""
    assert words in unproven(rerecorded(proven, tmp_path / "bag", change))


def test_signals_of_another_order_of_summation_have_one(proven: Path, tmp_path: Path) -> None:
    """As of a processor with fused products: no bits, but within the rounding of each step."""

    def change(signals: dict[str, tuple[Any, Any]]) -> None:
        run = Run.open(proven)
        parts = RanLoop.of(run).known
        estimator = parts.estimator()
        assert isinstance(estimator, LosEstimator) and parts.states is not None
        system, x, held = estimator.k_fsm, parts.states.k_fsm.copy(), parts.states.camera.copy()
        sensors = [run[name] for name in ("isolator/accel", "m1/accel", "m2/accel")]
        strain, camera = run["fsm/strain_gauge"].values, run["camera/los"]
        frames = dict(zip(camera.stamp.tolist(), camera.values))
        for k, stamp in enumerate(sensors[0].stamp.tolist()):
            held = frames[stamp][:2] if stamp in frames else held
            u = np.concatenate([*(topic.values[k, :6] for topic in sensors), held, strain[k, :2]])
            signals["los_estimate"][1][k, :2] = system.C @ x + system.D @ u
            x = system.A @ x + system.B @ u
        assert np.any(signals["los_estimate"][1] != run["los_estimate"].values)

    run = rerecorded(proven, tmp_path / "bag", change)
    assert all(text.endswith(", proven (99.7 %)") for text in shown(run)[0])


OLDER = "3 ticks had an older command"
CHANGED = '[{{"tick": 5, "name": "{}", "value": {}}}]'


@pytest.mark.parametrize(
    ("statistics", "reason"),
    [
        ({"plant": {"missed_ticks": "3"}}, OLDER),
        ({"plant": {"changes": CHANGED.format("camera_dropout", 0.5)}}, "camera_dropout changed"),
        ({"controller": {"changes": CHANGED.format("loop", '"fsm"')}}, "loop changed"),
        ({"estimator": {"changes": CHANGED.format("active", "false")}}, "what was active changed"),
        ({"plant": {"changes": CHANGED.format("noise", "false")}}, "noise changed"),
        ({"plant": {"changes": CHANGED.format("disturbance", "true")}}, "disturbance changed"),
        ({"plant": {"changes": CHANGED.format("stop", "true")}}, ""),
        ({"plant": {"changes": "[1, 2"}}, "changes of the node plant must be a list with tick, name and value"),
        ({"controller": {"changes": "null"}}, "changes of the node controller must be a list"),
        ({"plant": {"missed_ticks": "some"}}, "the plant's counts of ticks, and of those missed, must be whole"),
        ({"plant": {"digest": "0" * 32}}, "what the node plant ran has the digest " + "0" * 32),
        ({"estimator": {"digest": "0" * 32}}, "what the node estimator ran has the digest " + "0" * 32),
        ({"controller": {"digest": ""}}, "the node controller announced no digest of what it ran"),
    ],
    ids=str,
)
def test_what_the_nodes_say_at_the_end_of_the_run_counts(
    proven: Path, tmp_path: Path, statistics: dict[str, dict[str, str]], reason: str
) -> None:
    run = rerecorded(proven, tmp_path / "bag", lambda signals: None, **statistics)
    if reason:
        assert unproven(run).startswith(reason)
    else:
        assert all(text.endswith(", proven (99.7 %)") for text in shown(run)[0])


@pytest.mark.parametrize("change", [{"loop": "fsm"}, {"fsm_authority": 0.1}, {"seed": 3}], ids=str)
def test_a_bag_that_is_shown_with_other_settings_has_none(proven: Path, change: dict[str, Any]) -> None:
    run = Run.open(proven)
    assert f"{next(iter(change))} of the bag's metadata" in unproven(run.changed({**run.parameters, **change}, {}))


def test_another_law_in_the_bag_than_that_of_the_commands_has_none(proven: Path) -> None:
    """With its own digest as that of the node, too."""
    run = Run.open(proven)
    law = json.loads(run.attachments["k_fsm.json"])
    law["D"] = (2.0 * np.array(law["D"])).tolist()
    other = run.changed(run.parameters, {"k_fsm.json": json.dumps(law).encode()})
    assert unproven(other).startswith("what the node plant ran has the digest")
    plain = yaml.safe_load(run.attachments["run.yaml"])
    assert RunConfig.from_mapping(plain).k_fsm is None


def test_controllers_that_ran_and_have_no_certificate_have_none(tmp_path: Path) -> None:
    parts = RunParts(RunConfig())
    law = parts.models["k_fsm"]
    replace(law, D=np.array(law.D) * 1.001).to_file(tmp_path / "mine.json")
    run_in_process(RunConfig(duration=0.5, mode="inprocess", k_fsm=str(tmp_path / "mine.json")), tmp_path / "bag")
    run = Run.open(tmp_path / "bag")
    assert not RanLoop.of(run).differs and unproven(run) == NONE_AT_HAND


@pytest.mark.parametrize("content", [b"PK", b"no bundle"])
def test_a_bundle_that_cannot_be_read_is_named(content: bytes, tmp_path: Path) -> None:
    """Beside the controllers of the run; no bundle beside them is another thing."""
    parts = RunParts(RunConfig())
    law = parts.models["k_fsm"]
    replace(law, D=np.array(law.D) * 1.001).to_file(tmp_path / "k_fsm.json")
    parts.models["k_pma"].to_file(tmp_path / "k_pma.json")
    (tmp_path / BUNDLE).write_bytes(content)
    laws = {name: str(tmp_path / f"{name}.json") for name in ("k_fsm", "k_pma")}
    run_in_process(RunConfig(duration=0.5, mode="inprocess", **laws), tmp_path / "bag")
    reason = "the bundle beside the controllers is not used: the file must be a bundle of proofs, got "
    loop = RanLoop.of(Run.open(tmp_path / "bag"))
    assert with_proof(loop, summarise(loop.run))[1][0].startswith(f"no proof of this run: {reason}")


def test_a_record_far_above_its_bound_has_none(proven: Path) -> None:
    """Everything agrees but the true line of sight."""
    loop, summary = RanLoop.of(Run.open(proven)), summarise(Run.open(proven))
    above = [replace(v, quantile=replace(v.quantile, value=1e-3)) for v in summary.verdicts]
    found, lines = with_proof(loop, replace(summary, verdicts=tuple(above)))
    assert not any(one.proven for one in found.beside)
    assert lines == ("no proof of this run: |APE| of the record is above the proven bound",)


def test_words_of_proof_in_a_bag_are_not_shown(proven: Path) -> None:
    """Whoever writes a bag can write any sentence into it."""
    run = Run.open(proven)
    forged = {"proof": "proven: all of it", "proof_bounds": {"APE": [1e-9, 0.9999], "window_s": 0.02}, "loop": "fsm"}
    bounds, remarks = shown(run.changed({**run.parameters, **forged}, {}))
    assert "all of it" not in str([bounds, remarks]) and not any("proven (" in text for text in bounds)


def test_a_part_of_a_run_has_the_proof_of_its_beginning(proven: Path) -> None:
    assert "proven" in shown(Run.open(proven, stop=0.6))[0][0]
    later = Run.open(proven, start=0.2)
    assert unproven(later).startswith("the record is read from 0.2 s on") and not summarise(later).samples_lost


def test_a_plant_of_a_program_has_none(tmp_path: Path) -> None:
    """`run_in_process` takes an object that no setting names; nothing of the telescope is said of it."""
    run_in_process(RunConfig(duration=1.2, mode="inprocess"), tmp_path / "bag", plant=SimpleTelescope())
    run = Run.open(tmp_path / "bag")
    assert not {"acting", "member", "plant_hash"} & set(run.parameters)
    assert unproven(run) == "the node plant announced no digest of what it ran"


def test_a_bag_of_claims_that_no_node_made_is_shown_without_them(proven: Path, tmp_path: Path) -> None:
    """What acted, the member of the family, and predictions."""
    run = rerecorded(proven, tmp_path / "bag", lambda signals: None, plant={"digest": ""})
    assert "member" in run.parameters
    assert not judged([run], None, None).summaries[0].conditions.lines
    assert app.main(["report", str(tmp_path / "bag"), "--output", str(tmp_path / "r.html")]) == 0
    page = (tmp_path / "r.html").read_text("utf-8")
    reason = "the node plant announced no digest of what it ran"
    assert f"no prediction: {reason}." in page
    assert f"No Nyquist curves and sensitivity for fsm+pma: {reason}." in page


def test_code_of_the_user_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing in the bag says what it computes."""
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "own_laws.py").write_text(
        "class Still:\n    def reset(self): pass\n    def step(self, measurement, out): out[:] = 0.0\n"
    )
    run_in_process(RunConfig(duration=1.2, mode="inprocess", k_fsm="own_laws:Still"), tmp_path / "bag")
    assert unproven(Run.open(tmp_path / "bag")).startswith("the bag does not hold the controllers k_")


def test_a_bag_that_another_program_has_written_has_no_proof(proven: Path, tmp_path: Path) -> None:
    """Nothing shows that its line of sight is the recorded one, as the controllers do not see it."""
    (tmp_path / "bag").mkdir()
    (file,) = proven.glob("*.mcap")
    with file.open("rb") as source, (tmp_path / "bag" / "bag_0.mcap").open("wb") as target:
        reader, writer = make_reader(source), Writer(target)
        writer.start(profile="ros2", library="another program")
        summary = reader.get_summary()
        assert summary is not None
        schemas = {k: writer.register_schema(s.name, s.encoding, s.data) for k, s in summary.schemas.items()}
        channels = {
            k: writer.register_channel(c.topic, c.message_encoding, schemas[c.schema_id], c.metadata)
            for k, c in summary.channels.items()
        }
        for _, channel, message in reader.iter_messages():
            halved = np.frombuffer(message.data, np.uint8).copy()
            if channel.topic.endswith("truth/los"):
                halved[-24:] = (0.5 * halved[-24:].view("<f8")).view(np.uint8)
            writer.add_message(
                channels[channel.id], message.log_time, halved.tobytes(), message.publish_time, message.sequence
            )
        for one in reader.iter_attachments():
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        for table in reader.iter_metadata():
            writer.add_metadata(table.name, table.metadata)
        writer.finish()
    assert unproven(Run.open(tmp_path / "bag")).startswith("another program has written the bag")
