"""Traces of ticks: spans and marks from the times at which messages were sent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from los_testbed.bags.trace import MISSED, events, write_trace

from pointing_analysis.read.run import Run
from titop_plant.interface import TICK_NS

REFERENCE = Path(__file__).parents[4] / "bags/reference"
FIRST = 1_000_000_000


def test_each_node_has_the_span_between_what_it_waits_for_and_what_it_sends() -> None:
    """Samples 0.1 ms after the deadline, the estimate 0.2 ms later, commands 0.3 and 0.4 ms after that."""
    late = 5_000.0  # the clock of the messages is ahead; the quickest tick says how much
    times = np.array([0.1e6, 0.3e6, 0.6e6, 0.7e6])
    sent = {FIRST + k * TICK_NS: list(FIRST + k * TICK_NS + late + times) for k in range(3)}
    spans = [event for event in events(sent, FIRST) if event["ph"] == "X" and event["name"].endswith(" 2")]
    assert [event["tid"] for event in spans] == [0, 1, 2, 3, 4]
    begin = [2000.0, 2000.0, 2000.0, 2200.0, 2200.0]
    assert [event["ts"] for event in spans] == pytest.approx(begin)
    assert [event["dur"] for event in spans] == pytest.approx([1000.0, 0.0, 200.0, 300.0, 400.0])
    assert not any(event["name"] == MISSED for event in events(sent, FIRST))


def test_ticks_without_commands_in_time_are_marked() -> None:
    on_time = [0.0, 0.2e6, 0.3e6, 0.4e6]
    rows = (on_time, [0.0, 0.2e6, 0.3e6, 1.1e6], [0.0, 0.2e6, 0.3e6, np.nan], [np.nan] * 4, on_time)
    sent = {FIRST + k * TICK_NS: [FIRST + k * TICK_NS + time for time in row] for k, row in enumerate(rows)}
    marks = [event["ts"] for event in events(sent, FIRST) if event["name"] == MISSED]
    assert marks == [2000.0, 3000.0, 4000.0]


def test_a_run_that_was_not_in_real_time_has_no_trace(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="must be of a run in real time"):
        write_trace(Run.open(REFERENCE), tmp_path / "trace.json")
    assert not list(tmp_path.iterdir())
