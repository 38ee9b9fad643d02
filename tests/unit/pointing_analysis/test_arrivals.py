"""Lost messages, gaps, stalls and clock steps of a topic, put there one by one and found again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from los_testbed.cli.app import main

from pointing_analysis.read.arrivals import Arrivals, arrivals

MS = 1_000_000
START = 1_700_000_000_123_456_789
PERIODS = [1, 10, 100]


def times(n: int, period_ms: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Even stamps, recorded 0.2 to 3 ms later, in their order."""
    stamps = START + np.arange(n, dtype=np.int64) * period_ms * MS
    late = np.random.default_rng(seed).uniform(0.2, 3.0, n) * MS
    return np.maximum.accumulate(stamps + late.astype(np.int64)), stamps


def kinds(found: Arrivals) -> list[str]:
    return [event.kind for event in found.events]


@pytest.mark.parametrize("period", PERIODS)
def test_even_times_with_jitter_and_drifting_clocks_have_no_finding(period: int) -> None:
    for seed in range(5):
        logged, stamps = times(3000, period, seed)
        drift = (50e-6 * (stamps - stamps[0])).astype(np.int64)  # 50 ppm
        for slower in (logged, logged + drift, logged - drift):
            found = arrivals(slower, stamps)
            assert found.events == ()
            assert found.period == pytest.approx(period * 1e-3)
            assert found.lost == 0


@pytest.mark.parametrize("period", PERIODS)
def test_lost_messages_are_counted(period: int) -> None:
    """Any number, anywhere but at the ends."""
    rng = np.random.default_rng(period)
    for _ in range(20):
        logged, stamps = times(1000, period)
        gone = rng.choice(np.arange(1, 999), size=int(rng.integers(1, 60)), replace=False)
        found = arrivals(np.delete(logged, gone), np.delete(stamps, gone))
        assert found.lost == gone.size
        assert set(kinds(found)) == {"gap"}


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("lost", [0, 3])
def test_a_stall_is_no_loss_unless_messages_are_lost_in_it(period: int, lost: int) -> None:
    logged, stamps = times(3000, period)
    length = max(1000 * MS, 20 * period * MS)
    after = int(np.searchsorted(stamps, stamps[400] + length))
    late = logged.copy()
    late[400:after] = logged[after]
    gone = np.arange(405, 405 + lost)
    found = arrivals(np.delete(late, gone), np.delete(stamps, gone))
    assert found.lost == lost
    (stall,) = found.of("stall")
    assert stall.size == pytest.approx(length * 1e-9, rel=0.02)
    assert stall.at == pytest.approx(399 * period * 1e-3, abs=0.005)
    assert found.of("clock step") == ()


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("seconds", [-7.5, -0.5, 0.5, 7.5, 3600.0])
def test_a_step_of_either_clock_is_one_finding(period: int, seconds: float) -> None:
    """Forwards and backwards, of the sender and of the recorder; no message is lost and none stalls."""
    logged, stamps = times(2000, period)
    step = np.where(np.arange(2000) >= 1000, round(seconds * 1e9), 0)
    for found, sign in ((arrivals(logged, stamps + step), -1.0), (arrivals(logged + step, stamps), 1.0)):
        assert kinds(found) == ["clock step"]
        assert found.events[0].size == pytest.approx(sign * seconds, abs=0.005)
        assert found.lost == 0


def test_a_loss_at_a_clock_step_is_counted_by_the_other_clock() -> None:
    logged, stamps = times(2000, 10)
    step = np.where(np.arange(2000) >= 1000, 5_000 * MS, 0)
    gone = np.arange(1000, 1007)
    found = arrivals(np.delete(logged, gone), np.delete(stamps + step, gone))
    assert sorted(kinds(found)) == ["clock step", "gap"]
    assert found.lost == 7


def test_messages_of_a_slow_link_are_no_clock_steps() -> None:
    """Delays that scatter over four periods: alone, and with a step of the stamps that is seen through them."""
    rng = np.random.default_rng(3)
    logged, stamps = times(2000, 5)
    late = logged + rng.integers(0, 20 * MS, 2000)
    assert kinds(arrivals(late, stamps)) == []
    (step,) = arrivals(late, stamps + np.where(np.arange(2000) >= 1000, 500 * MS, 0)).events
    assert step.kind == "clock step" and step.size == pytest.approx(-0.5, abs=0.005)


def test_without_stamps_a_gap_is_only_a_gap() -> None:
    logged, _ = times(1000, 10)
    found = arrivals(np.delete(logged, np.arange(500, 560)))
    assert kinds(found) == ["gap"]
    assert found.lost is None
    assert found.events[0].size == pytest.approx(0.61, abs=0.005)
    back = np.where(np.arange(1000) >= 300, -2_000 * MS, 0)
    assert kinds(arrivals(logged + back)) == ["clock step"]


def test_verify_lists_the_times_of_a_foreign_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A bag of another program: lost messages of a stamped topic, a gap of one without, and a whole topic."""
    external_bags = pytest.importorskip("support.external_bags", reason="could not import 'rosbags'")
    n, rate = 600, 100.0
    stamps = external_bags.START + np.arange(n) * round(1e9 / rate)
    logged = stamps + 2 * MS
    logged[300:330] = logged[330]  # the recorder stalled
    topics: dict[str, Any] = {
        "/imu": ("sensor_msgs/msg/Imu", np.zeros((n, 2))),
        "/plain": ("geometry_msgs/msg/Vector3", np.zeros((n, 2))),
    }
    bag = external_bags.write_external(tmp_path / "bag", topics, rate, logged)
    assert main(["bag", "verify", str(bag), "--json"]) == 0
    shown = capsys.readouterr()
    content = json.loads(shown.out.splitlines()[-1])
    (event,) = content["times"]["/imu"]["events"]
    assert event["kind"] == "stall" and event["size"] == pytest.approx(0.3, abs=0.01)
    (event,) = content["times"]["/plain"]["events"]
    assert event["kind"] == "gap" and event["size"] == pytest.approx(0.31, abs=0.01)
    row = next(row for row in content["checks"] if row["name"] == "times of the messages")
    assert row["state"] == "none" and row["found"] == "1 gap, 1 stall"
    assert "clock steps" in shown.err
