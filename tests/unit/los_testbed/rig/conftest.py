"""A clock for the supervisor and the rigs of its tests."""

from __future__ import annotations

import sys
import time
from types import SimpleNamespace

import plain_rig
import pytest
from los_testbed.rig import supervisor


@pytest.fixture
def still_clock(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """It goes on by sleeping alone: nothing depends on how long a machine takes for a test."""
    now = [time.monotonic_ns()]

    def sleep(seconds: float) -> None:
        now[0] += round(1e9 * seconds)

    still = SimpleNamespace(monotonic_ns=lambda: now[0], sleep=sleep)
    for module in (supervisor, plain_rig, sys.modules[request.module.__name__]):
        monkeypatch.setattr(module, "time", still)
