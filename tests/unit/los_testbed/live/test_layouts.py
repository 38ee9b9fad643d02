"""Layouts for Foxglove and PlotJuggler name what the nodes send and nothing else."""

import re
from pathlib import Path

import pytest
from los_testbed.bags.schemas import DEFINITIONS
from los_testbed.config.topics import NAMESPACE, TOPICS

from pointing_analysis.read.messages.message_types import JOINT_NAMES

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
