"""Layouts for Foxglove and PlotJuggler name what the nodes send and nothing else."""

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from los_testbed.bags.schemas import DEFINITIONS
from los_testbed.config.topics import DIAGNOSTICS, DIAGNOSTICS_TOPIC, NODES, TOPICS
from los_testbed.run.loop.latency_histogram import LatencyHistogram

from pointing_analysis.read.messages.message_types import JOINT_NAMES, JOINT_STATE

FOLDER = Path(__file__).parents[4] / "ros_ws" / "src" / "los_testbed" / "layouts"
BY_PATH = {topic.path: topic for topic in TOPICS}


def fields(type_name: str) -> set[str]:
    """Paths of all numbers in a message, arrays as ``name[]``."""
    texts = DEFINITIONS[type_name].split("\n" + "=" * 80 + "\nMSG: ")
    parts = {"": texts[0], **dict(text.split("\n", 1) for text in texts[1:])}

    def walk(text: str, before: str) -> set[str]:
        found = set()
        for line in filter(None, text.splitlines()):
            kind, name = line.split()
            inner = [key for key in parts if key and key.split("/")[1] == kind.split("/")[-1].removesuffix("[]")]
            if inner:
                found |= walk(parts[inner[0]], f"{before}{name}.")
            elif "=" not in line:
                found.add(f"{before}{name}" + ("[]" if kind.endswith("[]") else ""))
        return found

    return walk(parts[""], "")


def check_message_path(value: str) -> str:
    """Topic of a Foxglove message path; it must exist and have the field."""
    topic, _, field = value.partition(".")
    assert topic in BY_PATH, f"no topic {topic}"
    index = re.search(r"\[(\d+)\]$", field)
    if index:
        assert int(index[1]) < BY_PATH[topic].size
    assert re.sub(r"\[\d+\]", "[]", field) in fields(BY_PATH[topic].type_name), f"{topic} has no field {field}"
    return topic


def leaves(node: object) -> list[str]:
    if isinstance(node, str):
        return [node]
    assert isinstance(node, dict)
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    return leaves(node["first"]) + leaves(node["second"])


def test_foxglove_layout() -> None:
    layout = json.loads((FOLDER / "foxglove.json").read_text())
    panels = layout["configById"]
    assert sorted(leaves(layout["layout"])) == sorted(panels)
    used = set()
    for name, panel in panels.items():
        if name.startswith("Plot!"):
            for path in panel["paths"] + ([panel["xAxisPath"]] if panel["xAxisVal"] == "custom" else []):
                used.add(check_message_path(path["value"]))
        else:
            assert panel["topicToRender"] == DIAGNOSTICS_TOPIC
    assert used == set(BY_PATH)


def check_series(name: str) -> str:
    """Topic of a PlotJuggler series: fields by slashes, efforts by joint name, diagnostics by node and key."""
    if name.startswith(DIAGNOSTICS_TOPIC):
        _, hardware, status, key = name.removeprefix("/").split("/")
        assert hardware == "los_testbed"
        assert status in {f"telescope: {node}" for node in NODES}
        assert key in {"missed_ticks", *LatencyHistogram().summary("latency")}
        return DIAGNOSTICS_TOPIC
    topic = next((path for path in BY_PATH if name.startswith(path + "/")), None)
    assert topic is not None, f"no topic for {name}"
    rest = name.removeprefix(topic + "/")
    if BY_PATH[topic].type_name == JOINT_STATE:
        joint, field = rest.split("/")
        assert joint in JOINT_NAMES and field == "effort"
    else:
        assert rest.replace("/", ".") in fields(BY_PATH[topic].type_name), f"{topic} has no field {rest}"
    return topic


def test_plotjuggler_layout() -> None:
    root = ElementTree.parse(FOLDER / "plotjuggler.xml").getroot()
    derived = {s.attrib["name"]: s.findtext("linked_source", "") for s in root.iter("snippet")}
    used = {check_series(source) for source in derived.values()}
    for plot in root.iter("plot"):
        for curve in plot.findall("curve"):
            if plot.attrib["mode"] == "XYPlot":
                used |= {check_series(curve.attrib["curve_x"]), check_series(curve.attrib["curve_y"])}
            elif curve.attrib["name"] not in derived:
                used.add(check_series(curve.attrib["name"]))
    assert used == {*BY_PATH, DIAGNOSTICS_TOPIC}
    assert DIAGNOSTICS in DEFINITIONS
    for splitter in root.iter("DockSplitter"):
        sizes = [float(x) for x in splitter.attrib["sizes"].split(";")]
        assert len(sizes) == len(splitter.findall("DockArea")) == int(splitter.attrib["count"])
        assert sum(sizes) == pytest.approx(1.0, abs=1e-4)
    for equation in root.iter("function"):
        assert float(equation.text.split("*")[1]) == pytest.approx(180 / 3.141592653589793 * 3600)
