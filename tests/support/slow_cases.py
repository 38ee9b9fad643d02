"""Cases of the longer campaign among those of a parametrised test."""

from __future__ import annotations

from typing import Any

import pytest


def slow(*values: Any) -> Any:
    """Values of a case that ``make test`` leaves to ``make test-slow``."""
    return pytest.param(*values, marks=pytest.mark.slow)
