"""The ROS package: what colcon and ros2 need, and the same version everywhere."""

import importlib
import runpy
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import setuptools

PACKAGE = Path(__file__).parents[3] / "ros_ws" / "src" / "los_testbed"


@pytest.fixture
def described(monkeypatch):
    kept = {}
    monkeypatch.setattr(setuptools, "setup", lambda **values: kept.update(values))
    monkeypatch.chdir(PACKAGE)
    runpy.run_path(str(PACKAGE / "setup.py"))
    return kept


def test_package_xml_is_that_of_an_ament_python_package(described):
    root = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert root.get("format") == "3"
    assert root.findtext("name") == "los_testbed"
    assert root.findtext("export/build_type") == "ament_python"
    assert root.find("maintainer").get("email")
    assert root.findtext("version") == described["version"]
    depends = {e.text for e in root.findall("exec_depend")}
    assert {"rclpy", "geometry_msgs", "sensor_msgs", "diagnostic_msgs", "rosgraph_msgs"} <= depends


def test_every_node_has_a_program_that_can_be_imported(described):
    programs = dict(entry.split(" = ") for entry in described["entry_points"]["console_scripts"])
    assert {"plant", "estimator", "controller", "estimator_controller", "recorder"} <= set(programs)
    pytest.importorskip("rclpy")
    for target in programs.values():
        module, function = target.split(":")
        assert callable(getattr(importlib.import_module(module), function))
