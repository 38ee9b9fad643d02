"""The examples in the docstrings of los_testbed."""

import doctest
import importlib

import pytest

MODULES = (
    "bag", "bag_repair", "codecs", "command_gate", "config", "cores", "health", "inprocess", "join", "mcap_writer",
    "plant_members", "real_time", "runner", "schemas", "statistics", "topics",
)  # fmt: skip


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    assert doctest.testmod(importlib.import_module(f"los_testbed.{name}")).failed == 0


def test_there_are_examples():
    found = [doctest.DocTestFinder().find(importlib.import_module(f"los_testbed.{name}")) for name in MODULES]
    assert sum(bool(test.examples) for tests in found for test in tests) >= 6
