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
    if "nodes" not in path.relative_to(PACKAGE).parts and ">>> " in path.read_text("utf-8")
)


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    result = doctest.testmod(importlib.import_module(f"los_testbed.{name}"))
    assert result.attempted > 0 and result.failed == 0


def test_there_are_examples():
    assert len(MODULES) >= 6
