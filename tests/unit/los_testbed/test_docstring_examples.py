"""The examples in the docstrings of los_testbed."""

import doctest
import importlib
from pathlib import Path

import los_testbed
import pytest

PACKAGE = Path(str(los_testbed.__file__)).parent
MODULES = sorted(
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    for path in PACKAGE.rglob("*.py")
    if "nodes" not in path.relative_to(PACKAGE).parts and path.name != "__init__.py"
)


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    assert doctest.testmod(importlib.import_module(f"los_testbed.{name}")).failed == 0


def test_there_are_examples():
    found = [doctest.DocTestFinder().find(importlib.import_module(f"los_testbed.{name}")) for name in MODULES]
    assert sum(bool(test.examples) for tests in found for test in tests) >= 6
