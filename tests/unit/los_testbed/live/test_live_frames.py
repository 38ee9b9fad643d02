"""What a viewer gets: samples, indices as the report computes them, settings; layouts name what the nodes send."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.bags.cdr import codec_for
from los_testbed.bags.diagnostics import Status
from los_testbed.bags.schemas import DEFINITIONS
from los_testbed.config.run_config import RunConfig
from los_testbed.config.topics import FSM_COMMAND, NAMESPACE, PMA_COMMAND, TOPICS, TRUTH_LOS
from los_testbed.live.frames import ViewerFrames
from los_testbed.live.history import CAPACITY, MAX_POINTS, SPAN_TICKS, History, indices
from los_testbed.parts.run_parts import RunParts

from pointing_analysis.indices.errors import RAD_PER_MAS
from pointing_analysis.indices.metrics import rpe_rms
from pointing_analysis.read.messages.message_types import JOINT_NAMES
from titop_plant.interface import TICK_NS

START = 1_700_000_000 * 10**9


def feed(history, ticks, topic=TRUTH_LOS, value=lambda tick: tick):
    codec = codec_for(topic)
    for tick in ticks:
        values = np.full(topic.size, float(value(tick))) * (RAD_PER_MAS if topic is TRUTH_LOS else 1.0)
        history.put(topic.name, bytes(codec.encode(START + tick * TICK_NS, values)))


def frames(**values):
    return ViewerFrames(RunConfig(**values), (5.3e-3, 31.6))


def test_a_viewer_that_keeps_up_gets_every_tick_once():
    view = frames()
    seen: dict[str, Any] = {}
    got = []
    for begin in range(0, 300, 50):
        feed(view.history, range(begin, begin + 50))
        samples = view.next(seen)["samples"]
        assert samples["stride"] == 1
        got += list(zip(samples["ticks"], samples["los"][0]))
    assert got == [(tick, pytest.approx(tick, rel=1e-6)) for tick in range(300)]


@pytest.mark.parametrize("behind", [101, 40_000])
def test_a_viewer_that_is_behind_gets_samples_at_equal_distances_with_their_own_values(behind):
    view = frames()
    feed(view.history, range(behind))
    samples = view.next({})["samples"]
    assert len(samples["ticks"]) <= MAX_POINTS
    assert set(np.diff(samples["ticks"])) == {samples["stride"]}
    assert samples["ticks"][0] > behind - 1 - CAPACITY
    assert samples["los"][1] == pytest.approx(samples["ticks"], rel=1e-6)


def test_samples_that_are_missing_or_late_are_at_their_tick():
    history = History()
    feed(history, [0, 1, 5, 3])
    feed(history, range(6), FSM_COMMAND, lambda tick: 1e-6 * tick)
    samples = history.samples(-1)
    assert samples["los"][0] == [0.0, 1.0, None, 3.0, None, 5.0]
    assert samples["fsm"][0] == pytest.approx(range(6))
    assert samples["pma"] == [[None] * 6] * PMA_COMMAND.size
    history.put("m1/accel", b"")
    feed(history, [100_000])
    assert history.samples(99_999)["los"][0] == [100_000.0]


def test_indices_equal_those_of_the_analysis():
    rng = np.random.default_rng(1)
    error = 30.0 * rng.standard_normal((SPAN_TICKS, 2))
    requirements = RunParts(RunConfig()).telescope.requirements
    found = {index["name"]: index for index in indices(error, "fsm+pma", requirements)}
    assert set(found) == {"APE", "RPE, fine", "RPE, finest"}
    assert found["RPE, fine"]["rms"] == pytest.approx(np.linalg.norm(rpe_rms(error, 1e-3, 0.02)), rel=1e-5)
    assert found["APE"]["largest"] == pytest.approx(np.hypot(*error.T).max(), rel=1e-5)
    assert (found["RPE, fine"]["limit"], found["RPE, finest"]["limit"]) == (100.0, 40.0)
    assert "RPE, finest" not in {index["name"] for index in indices(error, "fsm", requirements)}


def test_settings_are_those_of_the_start_with_the_changes_that_the_nodes_report():
    view = frames(camera_dropout=0.1)
    changes = [{"tick": 5, "name": "loop", "value": "isolator"}, {"tick": 9, "name": "loop", "value": "fsm"}]
    view.note("controller", Status(0, "telescope: controller", "running", {"changes": json.dumps(changes)}))
    # a node may report only what it changes itself
    stray = [{"tick": 1, "name": "noise", "value": False}]
    view.note("estimator", Status(0, "telescope: estimator", "running", {"changes": json.dumps(stray)}))
    frame = view.next({})
    assert frame["stage"] == "fsm"
    assert frame["settings"] == {"noise": True, "disturbance": True, "camera_dropout": 0.1}
    assert set(frame["nodes"]) == {"controller", "estimator"}


FOLDER = Path(__file__).parents[4] / "ros_ws" / "src" / "los_testbed" / "layouts"


@pytest.mark.parametrize("name", ["foxglove.json", "plotjuggler.xml"])
def test_a_layout_has_every_topic_with_fields_of_its_messages(name: str) -> None:
    named = re.findall(rf'[">]({NAMESPACE}/[^"<]*)["<]', (FOLDER / name).read_text())
    seen = set()
    for path in named:
        (topic,) = [topic for topic in TOPICS if path.startswith((f"{topic.path}/", f"{topic.path}."))]
        fields = re.split(r"[./]", re.sub(r"\[\d+\]", "", path[len(topic.path) + 1 :]))
        known = {*re.findall(r"\w+", DEFINITIONS[topic.type_name]), *JOINT_NAMES}
        assert fields and set(fields) <= known, path
        seen.add(topic.path)
    assert seen == {topic.path for topic in TOPICS}


def test_a_spectrum_that_cannot_be_computed_has_a_reason():
    """At the start of a run, and after a sample of each segment is missing: an earlier curve must not stay."""
    history = History()
    feed(history, range(100))
    assert history.spectrum() == {"reason": "shown after 0.75 s"}
    feed(history, range(100, 2000), value=lambda tick: tick % 7)
    assert set(history.spectrum()) == {"frequency", "density"}
    feed(history, range(2000, 8000), value=lambda tick: np.nan if tick % 100 == 0 else 1.0)
    assert set(history.spectrum()) == {"reason"} and "without missing samples" in history.spectrum()["reason"]
