"""The plant's clock as a node sees it: samples that are late, stalls, and stamps that are false."""

from __future__ import annotations

import pytest
from los_testbed.nodes.support.plant_clock import AGREED, PlantClock
from los_testbed.run.loop.stamp_synchronizer import HORIZON_NS

MS = 1_000_000
OFFSET = 1_795_000_000_000 * MS
"""Stamps are of another epoch than the steady clock."""


def after(*samples: tuple[float, float]) -> PlantClock:
    """A clock that was told of samples: when they were sent, and how late they were taken [ms]."""
    clock = PlantClock()
    for sent, late in samples:
        clock.note(OFFSET + round(sent * MS), round((sent + late) * MS))
    return clock


def error(clock: PlantClock, now: float) -> float:
    """How far the clock is ahead of the true time [ms]."""
    return (clock.now(round(now * MS)) - OFFSET) / MS - now


@pytest.mark.parametrize("stall", [20, 150, 5000])
def test_old_samples_after_a_stall_make_no_newer_ones_look_early(stall: int) -> None:
    backlog = [(float(sent), float(stall - sent)) for sent in range(1, stall)]
    assert error(after((0, 0.0), *backlog), stall) == pytest.approx(0.0)


@pytest.mark.parametrize("late", [20.0, 150.0, 5000.0])
def test_a_first_sample_that_was_late_is_made_up_for(late: float) -> None:
    """Without it a node whose first sample was late by 0.1 s would refuse everything from then on."""
    in_time = [(late + tick, 0.0) for tick in range(1, AGREED + 1)]
    now = late + AGREED
    found = error(after((0, late), *in_time), now)
    assert -late <= found <= 0.0 and found > -HORIZON_NS / MS


@pytest.mark.parametrize("false_stamps", [[3600_000.0], [100.0 + 10 * i for i in range(AGREED - 1)], [900.0] * 50])
def test_false_stamps_ahead_do_not_set_the_clock(false_stamps: list[float]) -> None:
    """A few of them, or one that is repeated; a true sample between them, and they are forgotten."""
    clock = after((0, 0.0), *((stamp, 1.0 - stamp) for stamp in false_stamps), (1, 0.0))
    clock.note(OFFSET + 950 * MS, 2 * MS)
    assert error(clock, 2) == pytest.approx(0.0)


def test_a_clock_that_is_faster_by_50_ppm_is_followed() -> None:
    clock = PlantClock()
    for tick in range(0, 3_600_000, 100):
        clock.note(OFFSET + round(tick * MS * (1 + 50e-6)), tick * MS)
    assert error(clock, 3_600_000.0) == pytest.approx(180.0, abs=0.01)
